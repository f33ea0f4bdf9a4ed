"""Mechanisms and studies of the dissertation, as functions that build and run them.

Start reading in `stage`, where `microstage` builds the micropositioning stage and
`amplification` computes its gain, and in `four_bar`. `stage_motion` simulates the stage,
`water` and `random_data` fit energies to data, `identification` holds identification
problems, and `sweep_studies` holds the studies of the command `twistorjax sweep`.
"""

from . import (
    four_bar as four_bar,
    identification as identification,
    random_data as random_data,
    stage as stage,
    stage_motion as stage_motion,
    sweep_studies as sweep_studies,
    water as water,
)
