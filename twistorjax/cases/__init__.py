"""The dissertation's studies, as functions that build them and run them."""

from . import four_bar as four_bar, stage as stage, transient as transient
