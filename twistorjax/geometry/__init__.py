"""Planar displacements: poses, twists, twistors, lines, and wrenches.

Start reading in `se2`, which has poses and twists. `twistors` has the Clifford parameters
of a displacement, in which most energies are written. `lines` represents forces as line
vectors.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
