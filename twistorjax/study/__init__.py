"""Identification: what was measured, and the unknowns that explain it."""

from .advice import Advice as Advice, advise as advise
from .at_rest import StaticTest as StaticTest
from .identification import fit as fit
from .identified import Identification as Identification
from .in_motion import MotionTest as MotionTest
from .measured import AbstractTest as AbstractTest, Measured as Measured
from .one_hinge import HingeTest as HingeTest
from .records import read_measured as read_measured
from .sampling import posterior as posterior
from .sensors import (
    AbstractSensor as AbstractSensor,
    Gauge as Gauge,
    Reading as Reading,
    Sensor as Sensor,
)
from .unknowns import Unknown as Unknown
from .vibrating import VibrationTest as VibrationTest
