from .body import Body as Body, plate as plate
from .constraints import Constraint as Constraint, Pin as Pin, Slider as Slider
from .hinge import Hinge as Hinge
from .loads import Drive as Drive, Load as Load, weights as weights
from .material import Expansion as Expansion, Material as Material
from .mechanism import Mechanism as Mechanism
from .misfits import Temperature as Temperature
from .sub_mechanism import SubMechanism as SubMechanism
