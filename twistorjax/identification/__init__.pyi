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
