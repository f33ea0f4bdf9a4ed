"""Progress of a motion on the terminal."""

import diffrax as dfx
from tqdm import tqdm

from .._utils.progress import progress_bar


class ProgressBar(dfx.TqdmProgressMeter):
    """Progress bar for `simulate(progress_meter=...)`, which appears after one second.

    Args:
        refresh_steps: Number of steps of the solver between two updates of the bar.

    Example:
        >>> ProgressBar().refresh_steps
        20
    """

    @staticmethod
    def _init_bar() -> tqdm:
        return progress_bar(
            100,
            "%",
            True,
            delay=1.0,
            leave=False,
            bar_format="{percentage:.0f}% of the motion |{bar}| {elapsed}<{remaining}",
        )
