"""Rigid bodies, hinges, loads, and constraints, which form a mechanism.

Start reading in `mechanism`. `body`, `hinge`, `loads`, `constraints`, and `material`
contain the classes that a user creates, and `sub_mechanism` a mechanism that acts as one
hinge. `misfits` adds strokes and temperatures to the states in which hinges are not
loaded, and `changes` has those that are functions of time.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
