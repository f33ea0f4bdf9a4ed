"""Optimization of designs within bounds and limits, by exact derivatives.

Start reading in `optimize`. `designs.design_space` collects the variables and constants
of a design, `setup` creates the compiled program that evaluates it, `problem` holds the
objective and the limits in normalized form, and `deviations` differentiates standard
deviations. `searches` runs the searches of `local_search` side by side, and
`search_store` saves them. `summary` collects their ends in an `Optimum`.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
