"""Figures and animations of mechanisms, energies, sweeps, and fits, with matplotlib.

Start reading in `drawing`. `shapes` computes the outlines of all parts in world
coordinates, `marks` draws loads, reactions and constraints, `labels` places names and
numbers so that they do not overlap, and `figure_style` holds colors and units.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
