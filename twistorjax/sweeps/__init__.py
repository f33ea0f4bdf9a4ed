"""Sweeps of a study over many designs, and tolerance analysis.

Start reading in `sweep`. `designs`, `distributions` and `sampling` hold what is varied,
`outputs` what a study returns for one design, `executor` the compiled program that
evaluates chunks of designs on one or several devices, and `dataset` the result in memory.
`store` writes the result to a zarr folder on disk, from which an interrupted sweep is
resumed. A design that fails returns NaN and a result code. `tolerances` computes how
tolerances of the parameters propagate to an output.
"""

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
