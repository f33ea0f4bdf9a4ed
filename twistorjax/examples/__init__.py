"""Mechanisms and studies of the dissertation, as functions that build and run them.

Start reading in `stage`, where `microstage` builds the micropositioning stage and
`amplification` computes its gain, and in `four_bar`. `stage_motion` simulates the stage,
`water` and `random_data` fit energies to data, `identification` holds identification
problems, and `sweep_studies` holds the studies of the command `twistorjax sweep`.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
