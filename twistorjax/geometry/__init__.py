"""Planar displacements: poses, twists, twistors, lines, and wrenches.

Start reading in `se2`, which has poses and twists. `twistors` has the Clifford parameters
of a displacement, in which most energies are written. `lines` represents forces as line
vectors.
"""

from . import lines as lines, se2 as se2, twistors as twistors
