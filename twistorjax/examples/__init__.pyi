from . import (
    four_bar as four_bar,
    four_bar_models as four_bar_models,
    identification as identification,
    parallelogram as parallelogram,
    random_data as random_data,
    stage as stage,
    stage_motion as stage_motion,
    sweep_studies as sweep_studies,
    truss as truss,
    warm_stage as warm_stage,
    water as water,
)
