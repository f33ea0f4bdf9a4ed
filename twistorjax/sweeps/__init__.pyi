from .optimization import (
    ActiveLimit as ActiveLimit,
    Limit as Limit,
    LocalOptimum as LocalOptimum,
    optimize as optimize,
    optimize_cases as optimize_cases,
    Optimum as Optimum,
    Searches as Searches,
    Sensitivity as Sensitivity,
    Violations as Violations,
)
from .sweep import (
    Grid as Grid,
    open_sweep as open_sweep,
    sample_designs as sample_designs,
    sweep as sweep,
)
from .tolerances import (
    AbstractDistribution as AbstractDistribution,
    Normal as Normal,
    Tolerances as Tolerances,
    tolerances as tolerances,
    Uniform as Uniform,
    VarianceShare as VarianceShare,
)
