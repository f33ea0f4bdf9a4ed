"""Optimization of designs within bounds and limits, by exact derivatives.

Start reading in `optimize`, which checks the arguments and compiles the study. The
variables and constants of a design are the vector of `designs.design_space`. `problem`
evaluates designs, and holds the objective and the margins of the `limits` in normalized
form. `searches` runs the searches of `local_search` side by side and saves their ends.
`conditions` has the multipliers of a design, and `optimum` the result.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
