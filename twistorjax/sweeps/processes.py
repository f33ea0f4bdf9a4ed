"""Communication between the processes of a sweep, which `jax.distributed` connects."""

from collections.abc import Mapping

import jax
import numpy as np


def synchronize(step: str) -> None:
    """Wait until all processes have reached a step.

    Args:
        step: Name of the step, which must be the same in all processes.
    """
    if jax.process_count() > 1:
        from jax.experimental import multihost_utils

        multihost_utils.sync_global_devices(step)


def gather(
    values: Mapping[str, np.ndarray], owners: np.ndarray
) -> Mapping[str, np.ndarray]:
    """Combine the values that several processes have computed.

    Args:
        values: Arrays with one entry for each design along the first axis, by name. In
            each process, only the entries of its own designs are valid.
        owners: Index of the process that has computed each design.

    Returns:
        The arrays with all entries, in each process.
    """
    if jax.process_count() == 1:
        return values
    from jax.experimental import multihost_utils

    rows = np.arange(len(owners))
    return {
        name: np.asarray(multihost_utils.process_allgather(array))[owners, rows]
        for name, array in values.items()
    }
