from .cases import optimize_cases as optimize_cases
from .limits import Limit as Limit
from .optimize import optimize as optimize
from .optimum import (
    ActiveLimit as ActiveLimit,
    LocalOptimum as LocalOptimum,
    Optimum as Optimum,
    Searches as Searches,
    Sensitivity as Sensitivity,
)
from .violations import Violations as Violations
