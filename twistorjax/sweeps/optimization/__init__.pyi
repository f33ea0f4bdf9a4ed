from .conditions import ActiveLimit as ActiveLimit, Sensitivity as Sensitivity
from .limits import Limit as Limit
from .optimize import optimize as optimize, optimize_cases as optimize_cases
from .optimum import (
    LocalOptimum as LocalOptimum,
    Optimum as Optimum,
    Searches as Searches,
    Violations as Violations,
)
