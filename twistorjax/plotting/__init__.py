"""Figures and animations of mechanisms, energies, sweeps, and fits, with matplotlib.

Start reading in `drawing`. `shapes` computes the outlines of all parts in world
coordinates, `marks` draws loads, reactions and constraints, `labels` places names and
numbers so that they do not overlap, and `figure_style` holds colors and units.
"""

from .animation import animate as animate
from .drawing import draw as draw
from .hinge_plots import draw_energy as draw_energy
