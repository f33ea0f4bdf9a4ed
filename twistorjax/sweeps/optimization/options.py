"""Options of an optimization, and the designs at which its searches begin."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..._utils.types import NumbersLike
from ..._utils.validation import quote
from ...designs.design_space import DesignSpace
from ...designs.designs import Designs
from .limits import Limit


class Options(NamedTuple):
    """Keyword arguments of `optimize`, with the same meaning and defaults."""

    minimize: str | None = None
    maximize: str | None = None
    limits: Mapping[str, Limit] | None = None
    starts: Any = 1
    seed: int = 0
    standard_deviations: Mapping[str, NumbersLike] | None = None
    coverage_factor: float = 3.0
    units: Mapping[str, str] | None = None
    tolerance: float = 1e-10
    max_steps: int = 500
    store: str | Path | None = None
    resume: bool = False
    progress: bool = False
    throw: bool = True

    def check(self) -> None:
        """Check the options that do not depend on the study.

        Raises:
            ValueError: An option is not valid.
        """
        if (self.minimize is None) == (self.maximize is None):
            raise ValueError(
                f"`minimize` is {quote(self.minimize)} and `maximize` is "
                f"{quote(self.maximize)}. Give one of them: the name of an output."
            )
        for name in ("limits", "standard_deviations", "units"):
            given = getattr(self, name)
            if given is not None and not isinstance(given, Mapping):
                raise ValueError(
                    f"`{name}` is {quote(given)}, but must be a mapping from names to "
                    "values."
                )
        for name, limit in (self.limits or {}).items():
            if not isinstance(limit, Limit):
                raise ValueError(
                    f"`limits[{quote(name)}]` is {quote(limit)}, but must be a `Limit`: "
                    "`tj.Limit(upper=...)`."
                )
        if not self.coverage_factor > 0:
            raise ValueError(
                f"`coverage_factor` is {self.coverage_factor}, but must be positive."
            )
        if not 0 < self.tolerance < 1:
            raise ValueError(
                f"`tolerance` is {self.tolerance}, but must be between 0 and 1."
            )
        if self.max_steps < 1:
            raise ValueError(f"`max_steps` is {self.max_steps}, but must be at least 1.")
        if self.resume and self.store is None:
            raise ValueError(
                "`resume` is True, but there is no `store`. Specify its path."
            )
        is_number = isinstance(self.starts, int | float | np.number)
        if is_number and (int(self.starts) != self.starts or self.starts < 1):
            raise ValueError(
                f"`starts` is {quote(self.starts)}, but must be an integer of at least "
                "1, or designs."
            )
        is_list_of_designs = isinstance(self.starts, list | tuple) and any(
            isinstance(start, Mapping) for start in self.starts
        )
        if isinstance(self.starts, str) or is_list_of_designs:
            raise ValueError(
                f"`starts` is {quote(self.starts)}, but must be a number, or a mapping "
                "from names of parameters to arrays with one value for each start."
            )

    @property
    def start_count(self) -> int:
        """Number of searches."""
        if isinstance(self.starts, int | float | np.number):
            return int(self.starts)
        return len(Designs(self.starts))

    def start_vectors(self, space: DesignSpace) -> Float[np.ndarray, "starts numbers"]:
        """Return the numbers of the design at each start.

        Args:
            space: Numbers of the design.

        Returns:
            The numbers of each start.

        Raises:
            ValueError: A variable lacks a bound for random starts, or the designs do not
                fit.
        """
        if not isinstance(self.starts, int | float | np.number):
            return space.vectors(self.starts)
        first, others = space.start[None], self.start_count - 1
        if not others:
            return first
        return np.concatenate([first, space.sampled(others, self.seed)])
