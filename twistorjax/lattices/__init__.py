"""Lattices of many bodies: unit cells, and cells that are ready to use.

Start reading in `squares`. `repeat` and `UnitCell` are in `mechanism.unit_cell`.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
