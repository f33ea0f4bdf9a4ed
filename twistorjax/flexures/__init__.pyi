from .actuator import piezo_stack as piezo_stack
from .beam import Beam as Beam
from .beam_solution import (
    beam_under_load as beam_under_load,
    BeamSolution as BeamSolution,
    largest_rotation as largest_rotation,
)
from .chain import Chain as Chain, chain as chain
from .exact_beam import beam_at_pose as beam_at_pose, ExactBeam as ExactBeam
from .leaf import (
    leaf as leaf,
    leaf_outline as leaf_outline,
    quartic_leaf as quartic_leaf,
)
from .notch import (
    notch as notch,
    notch_outline as notch_outline,
    notch_profile as notch_profile,
)
from .stress import (
    largest_stress as largest_stress,
    leaf_stress as leaf_stress,
    notch_stress as notch_stress,
)
from .surrogate import surrogate as surrogate
