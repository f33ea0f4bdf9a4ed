"""Optimization of designs within bounds and limits, by exact derivatives.

Start reading in `optimize`, which checks the arguments and compiles the study. The
variables and constants of a design are the vector of `designs.design_space`. `problem`
evaluates designs, and holds the objective and the margins of the `limits` in normalized
form. `searches` runs the searches of `local_search` side by side and saves their ends.
`conditions` has the multipliers of a design, and `optimum` the result.
"""

from ..._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
