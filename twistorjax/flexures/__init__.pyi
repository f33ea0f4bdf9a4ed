from .actuator import piezo_stack as piezo_stack
from .beams.at_pose import beam_at_pose as beam_at_pose, ExactBeam as ExactBeam
from .beams.beam import Beam as Beam
from .beams.out_of_plane import out_of_plane_stiffness as out_of_plane_stiffness
from .beams.stress import (
    largest_stress as largest_stress,
    leaf_stress as leaf_stress,
    notch_stress as notch_stress,
)
from .beams.under_load import (
    beam_under_load as beam_under_load,
    BeamSolution as BeamSolution,
    largest_rotation as largest_rotation,
)
from .compound.chain import (
    beam_expansion as beam_expansion,
    Chain as Chain,
    chain as chain,
)
from .compound.guides import (
    double_parallelogram as double_parallelogram,
    folded_beam as folded_beam,
    parallelogram as parallelogram,
)
from .compound.pivots import (
    butterfly_pivot as butterfly_pivot,
    cartwheel_pivot as cartwheel_pivot,
    cross_spring_pivot as cross_spring_pivot,
)
from .condensed import Condensed as Condensed
from .contours.leaves import (
    filleted_leaf as filleted_leaf,
    filleted_leaf_profile as filleted_leaf_profile,
    reinforced_leaf as reinforced_leaf,
    reinforced_leaf_profile as reinforced_leaf_profile,
)
from .contours.notches import (
    elliptical_notch as elliptical_notch,
    elliptical_notch_profile as elliptical_notch_profile,
    parabolic_notch as parabolic_notch,
    power_law_notch_profile as power_law_notch_profile,
    v_notch as v_notch,
    v_notch_profile as v_notch_profile,
)
from .leaf import (
    leaf as leaf,
    leaf_outline as leaf_outline,
    linear_leaf as linear_leaf,
    quartic_leaf as quartic_leaf,
)
from .notch import (
    notch as notch,
    notch_outline as notch_outline,
    notch_profile as notch_profile,
)
from .plates import bending_factor as bending_factor
from .surrogates.surrogate import surrogate as surrogate
