from .experiment_design import (
    Candidate as Candidate,
    ExperimentRanking as ExperimentRanking,
    rank_experiments as rank_experiments,
)
from .experiments.hinge import HingeTest as HingeTest
from .experiments.measurement import (
    AbstractTest as AbstractTest,
    Measurement as Measurement,
)
from .experiments.motion import MotionTest as MotionTest
from .experiments.readers import read_measurements as read_measurements
from .experiments.sensors import (
    AbstractSensor as AbstractSensor,
    BodySensor as BodySensor,
    FunctionSensor as FunctionSensor,
    HingeSensor as HingeSensor,
)
from .experiments.statics import StaticTest as StaticTest
from .experiments.vibrations import VibrationTest as VibrationTest
from .identify import identify as identify, Parameter as Parameter
from .posterior import posterior as posterior
from .report import Identification as Identification
