"""Names that a parameter or an output may have."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from .._utils.validation import quote, require_text


# variables that every dataset has besides the parameters and outputs
RESERVED = ("succeeded", "result")


def check_parameter_names(names: Sequence[Any]) -> None:
    """Check that a dataset can hold parameters of these names."""
    for name, count in Counter(names).items():
        if not isinstance(name, str) or not name:
            raise ValueError(
                f"`designs` has a parameter {quote(name)}, but a name must be a string "
                "that is not empty."
            )
        require_text("The name of a parameter", name)
        if count > 1:
            raise ValueError(
                f"`designs` has {count} parameters {quote(name)}. Give them different "
                "names."
            )
        if name in RESERVED:
            raise ValueError(
                f"`designs` has a parameter {quote(name)}, but this name is reserved. "
                f"Use another name; only {' and '.join(map(repr, RESERVED))} are "
                "reserved."
            )
