"""The dissertation's studies, as functions that build them and run them."""

from . import (
    four_bar as four_bar,
    identification as identification,
    random_data as random_data,
    stage as stage,
    transient as transient,
    water as water,
)
