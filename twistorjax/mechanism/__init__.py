"""Rigid bodies, hinges, loads, and constraints, assembled into one mechanism.

Start reading in `mechanism`. `body`, `hinge`, `loads`, and `constraints` contain the
classes that a user creates. `hinge_assembly` computes the energy, forces, and stiffness
of all hinges together, from those of one hinge: `hinge_kinematics`, `hinge_forces`, and,
in motion, `hinge_motion`. `hinge_groups` stacks hinges of the same kind.
"""

from .body import Body as Body, plate as plate
from .constraints import Constraint as Constraint, Pin as Pin, Slider as Slider
from .hinge import Hinge as Hinge
from .loads import Drive as Drive, Load as Load
from .mechanism import Mechanism as Mechanism
