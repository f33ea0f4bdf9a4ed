"""Mechanisms and studies of the dissertation, as functions that build and run them.

Start reading in `stage`, where `microstage` builds the micropositioning stage and
`amplification` computes its gain, and in `four_bar`. `stage_motion` simulates the stage,
`water` and `random_data` fit energies to data, `identification` holds identification
problems, and `sweep_studies` holds the studies of the command `twistorjax sweep`.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
