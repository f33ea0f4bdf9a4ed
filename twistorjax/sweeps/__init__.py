"""Sweeps: what a study says of many designs, in chunks, on one device or on many."""

from .lanes import Grid as Grid
from .spreads import (
    AbstractSpread as AbstractSpread,
    Normal as Normal,
    sampled as sampled,
    Uniform as Uniform,
)
from .sweep import open_sweep as open_sweep, sweep as sweep
from .tolerances import Share as Share, Tolerances as Tolerances, tolerances as tolerances
