"""Pictures, on matplotlib's axes."""

from .animation import animate as animate
from .drawing import draw as draw
from .landscapes import draw_energy as draw_energy
from .progress import ProgressBar as ProgressBar
