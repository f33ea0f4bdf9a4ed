from .designs import Grid as Grid
from .distributions import (
    AbstractDistribution as AbstractDistribution,
    Normal as Normal,
    Uniform as Uniform,
)
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
from .sampling import sample_designs as sample_designs
from .sweep import open_sweep as open_sweep, sweep as sweep
from .tolerances import (
    Tolerances as Tolerances,
    tolerances as tolerances,
    VarianceShare as VarianceShare,
)
