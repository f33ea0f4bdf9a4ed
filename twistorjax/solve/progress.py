"""Progress of a motion on the terminal."""

import diffrax as dfx
from tqdm import tqdm


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
        return tqdm(
            total=100,
            unit="%",
            delay=1.0,
            leave=False,
            bar_format="{percentage:.0f}% of the motion |{bar}| {elapsed}<{remaining}",
        )
