"""Pictures, on matplotlib's axes."""

from .animation import animate as animate
from .drawing import draw as draw
from .progress import ProgressBar as ProgressBar
