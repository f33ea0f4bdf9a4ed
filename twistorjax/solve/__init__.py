"""What a mechanism does: where it rests."""

from . import results as results, statics as statics
