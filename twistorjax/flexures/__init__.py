"""Energies and stresses of flexures that are cut from a plate.

Start reading in `leaf` and `notch`, which return the energy of a hinge for small
rotations, from its dimensions and its material. `contours` has notches and leaves of
other shapes, and `actuator` a piezo stack. `beams` are geometrically exact, and
`surrogates` approximate them by polynomials, which are as fast as any other hinge.
`compound` has chains of beams, pivots, and guides.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
