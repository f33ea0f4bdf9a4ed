"""What is cut from a plate, as energies."""

from .beam import (
    Beam as Beam,
    bend as bend,
    Bent as Bent,
    largest_turn as largest_turn,
)
from .distillation import distilled as distilled
from .exact import bend_to as bend_to, Exact as Exact
from .leaf import (
    leaf as leaf,
    leaf_outline as leaf_outline,
    quartic_leaf as quartic_leaf,
)
from .material import Material as Material
from .notch import (
    notch as notch,
    notch_outline as notch_outline,
    notch_profile as notch_profile,
)
from .stress import leaf_stress as leaf_stress, notch_stress as notch_stress
