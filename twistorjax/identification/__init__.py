"""Identification of the parameters of a mechanism from measurements.

Start reading in `identify`. A test defines what is done to the mechanism and which
sensors are read: `static_test`, `motion_test`, `vibration_test` and `hinge_test` contain
one kind of test each. The main path is: `parameters` maps the unknown numbers of a design
to normalized parameters, `objective` computes the residuals and their derivatives,
`search` runs an optimizer, and `report` holds the estimates and their uncertainties.
`experiment_design` ranks further experiments, and `posterior` draws samples of the
posterior distribution.
"""

from .experiment_design import (
    Candidate as Candidate,
    ExperimentRanking as ExperimentRanking,
    rank_experiments as rank_experiments,
)
from .hinge_test import HingeTest as HingeTest
from .identify import identify as identify
from .measurement import AbstractTest as AbstractTest, Measurement as Measurement
from .motion_test import MotionTest as MotionTest
from .parameters import Parameter as Parameter
from .posterior import posterior as posterior
from .readers import read_measurements as read_measurements
from .report import Identification as Identification
from .sensors import (
    AbstractSensor as AbstractSensor,
    BodySensor as BodySensor,
    FunctionSensor as FunctionSensor,
    HingeSensor as HingeSensor,
)
from .static_test import StaticTest as StaticTest
from .vibration_test import VibrationTest as VibrationTest
