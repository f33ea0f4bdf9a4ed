"""What is cut from a plate, as energies."""

from .leaf import leaf as leaf, leaf_outline as leaf_outline
from .material import Material as Material
from .notch import notch as notch, notch_outline as notch_outline
