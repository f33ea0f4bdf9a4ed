"""Figures and animations of mechanisms, energies, sweeps, and fits, with matplotlib.

Start reading in `drawing`. `shapes` computes the outlines of all parts in the world frame,
`marks` draws loads and constraints, and `canvas` holds figures, colors, and units.
"""

from .animation import animate as animate
from .drawing import draw as draw
from .landscapes import draw_energy as draw_energy
