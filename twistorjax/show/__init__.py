"""Pictures, on matplotlib's axes."""

from .drawing import draw as draw
