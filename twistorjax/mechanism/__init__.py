"""Rigid bodies, hinges, loads, and constraints, assembled into one mechanism.

Start reading in `mechanism`. `body`, `hinge`, `loads`, and `constraints` contain the
classes that a user creates. `hinge_assembly` computes the energy, forces, and stiffness
of all hinges together, from those of one hinge: `hinge_kinematics`, `hinge_forces`, and,
in motion, `hinge_motion`. `hinge_groups` stacks hinges of the same kind.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
