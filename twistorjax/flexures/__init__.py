"""Energies and stresses of flexures that are cut from a plate.

Start reading in `leaf` and `notch`, which return the energy of a hinge for small
rotations, from its dimensions and its material. `beam` and `beam_solution` model a
geometrically exact beam of any thickness profile. `exact_beam` makes an energy of it, and
`surrogate` approximates this energy by a polynomial, which is as fast as any other hinge.
`chain` divides a beam into several surrogates, and `condensed` makes one energy of a
sub-mechanism such as those of `pivots` and `guides`. `contours` are thickness profiles.
`stress` computes the largest stress in a flexure.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
