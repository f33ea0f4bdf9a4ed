"""Rigid bodies, hinges, loads, and constraints, assembled into one mechanism.

Start reading in `mechanism`. `body`, `hinge`, `loads`, and `constraints` hold what a user
writes. `hinge_kinematics`, `hinge_forces`, `hinge_groups`, and `hinge_assembly` compute
the energy, forces, and stiffness of all hinges at once.
"""

from .body import Body as Body, plate as plate
from .constraints import Constraint as Constraint, Pin as Pin, Slider as Slider
from .hinge import Hinge as Hinge
from .loads import Drive as Drive, Load as Load
from .mechanism import Mechanism as Mechanism
