"""Planar displacements: poses, twists, twistors, lines, and wrenches.

Start reading in `se2`, which has poses and twists. `twistors` has the Clifford parameters
of a displacement, in which most energies are written. `lines` represents forces as line
vectors.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
