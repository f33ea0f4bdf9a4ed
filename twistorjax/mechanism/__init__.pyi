from .body import Body as Body, plate as plate
from .changes import Temperature as Temperature
from .constraints import Constraint as Constraint, Pin as Pin, Slider as Slider
from .expansion import Expansion as Expansion
from .hinge import Hinge as Hinge
from .loads import Drive as Drive, Load as Load, weights as weights
from .material import Material as Material
from .mechanism import Mechanism as Mechanism
from .sub_mechanism import SubMechanism as SubMechanism
