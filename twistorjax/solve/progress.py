"""How far a motion has come, on the terminal."""

import diffrax as dfx
from tqdm import tqdm


class ProgressBar(dfx.TqdmProgressMeter):
    """A bar for `simulate(progress_meter=...)`, shown where a run exceeds a second.

    Args:
        refresh_steps: how many steps of the solver it waits before it looks again.

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
