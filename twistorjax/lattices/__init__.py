"""Lattices of many bodies: unit cells, and cells that are ready to use.

Start reading in `squares`. `repeat` and `UnitCell` are in `mechanism.unit_cell`.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
