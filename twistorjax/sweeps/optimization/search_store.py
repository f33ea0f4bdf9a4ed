"""Store of the ends of searches, which is also a store of a sweep over their starts."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ...designs.designs import Designs
from ...results.tables import Column
from ..dataset import Layout
from ..outputs import StudyOutput
from ..stores.identity import open_store, sweep_identity
from ..sweep import require_packages
from .local_search import SearchEnd
from .setup import Setup


class SearchStore:
    """Folder in which the end of each search is saved as soon as it is known.

    Args:
        path: Folder of the store.
        resume: Whether an existing store is continued.
        setup: Setup of the optimization.
        starts: Numbers of the design at each start.
        settings: Entries by which optimizations are distinguished; JSON can represent
            them.

    Raises:
        ImportError: xarray or zarr is not installed.
        ValueError: The store exists and `resume` is False, it belongs to another
            optimization, or it cannot hold a name.
        OSError: The store cannot be read or written.
    """

    def __init__(
        self,
        path: str | Path,
        resume: bool,
        setup: Setup,
        starts: Float[np.ndarray, "starts numbers"],
        settings: Mapping[str, Any],
    ):
        require_packages(path)
        if Path(path).exists() and not resume:
            raise ValueError(
                f"`store` is {str(path)!r}, which already exists. Continue it with "
                "`resume=True`, or use another path."
            )
        names = setup.space.structure.names
        inputs = setup.space.program_input(starts)
        designs = Designs(dict(zip(names, inputs, strict=True)))
        output = _study_output(SearchEnd(starts[0], 0, 0))
        self._layout = Layout(designs, output, {})
        self._layout.check_storable()
        identity = sweep_identity(setup.study, designs, setup.program, None, settings)
        identity["chunk_size"] = 1  # Each search is saved alone.
        self._store = open_store(Path(path), self._layout, identity, resume)

    def finished(self) -> dict[int, SearchEnd]:
        """Return the ends of the finished searches, by the index of their start."""
        available = self._store.intact_chunks()
        ends, results, counts = (
            self._store.read(name, available) for name in ("end", "result", "evaluations")
        )
        return {
            int(row): SearchEnd(ends[row], int(results[row]), int(counts[row]))
            for row in np.flatnonzero(available)
        }

    def write(self, row: int, end: SearchEnd) -> None:
        """Save the end of a search.

        Args:
            row: Index of its start.
            end: The end.
        """
        self._store.write(row, self._layout.values(_study_output(end)))


def _study_output(end: SearchEnd) -> StudyOutput:
    """Return the end of a search in the form of the outputs of one design."""
    result, succeeded = jax.device_put(
        (np.array([end.result], np.int32), np.array([end.result == 0]))
    )
    columns = {
        "end": Column(end.vector[None], ("number",)),
        "evaluations": Column(np.array([end.evaluations], np.int32)),
    }
    return StudyOutput(columns, result=result, succeeded=succeeded)
