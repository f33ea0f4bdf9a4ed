"""Figures and animations of mechanisms, energies, sweeps, and fits, with matplotlib.

Start reading in `drawing`. `shapes` computes the outlines of all parts in world
coordinates, `marks` draws loads, reactions and constraints, `labels` places names and
numbers so that they do not overlap, and `figure_style` holds colors and units.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
