"""Energies and stresses of flexures that are cut from a plate.

Start reading in `leaf` and `notch`, which return the energy of a hinge for small
rotations, from its dimensions and its material. `contours` has notches and leaves of
other shapes, and `actuator` a piezo stack. `beams` are geometrically exact, and
`surrogates` approximate them by polynomials, which are as fast as any other hinge.
`compound` has chains of beams, pivots, and guides.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
