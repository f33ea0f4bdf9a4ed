"""The dissertation's studies, as functions that build them and run them."""

from . import stage as stage
