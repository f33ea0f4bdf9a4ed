from .designs import Grid as Grid
from .distributions import (
    AbstractDistribution as AbstractDistribution,
    Normal as Normal,
    Uniform as Uniform,
)
from .sampling import sample_designs as sample_designs
from .sweep import open_sweep as open_sweep, sweep as sweep
from .tolerances import (
    Tolerances as Tolerances,
    tolerances as tolerances,
    VarianceShare as VarianceShare,
)
