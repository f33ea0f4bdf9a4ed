"""What the commands share: how they refuse, prepare, and draw."""

import json
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from .._utils.validation import shorten


class UsageError(Exception):
    """Input that cannot be used, told in one line."""


class SolveError(Exception):
    """A solve that found no answer, told in one line."""


def prepare_jax(devices: int = 1) -> None:
    """Double precision, and compiled programs kept for the next call.

    Args:
        devices: as how many the processor is to count.
    """
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    import jax
    import platformdirs

    jax.config.update("jax_enable_x64", True)
    if devices > 1:
        jax.config.update("jax_num_cpu_devices", devices)
    cache = platformdirs.user_cache_path("twistorjax")
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def need(option: str, value: float, unit: str) -> None:
    """Refuses what is not positive and finite."""
    if not (math.isfinite(value) and value > 0):
        raise UsageError(
            f"{option} is {value:g}, but must be positive and finite; {unit}."
        )


def need_choice(option: str, value: str, choices: Sequence[str]) -> Any:
    """The value, if it is one of the choices."""
    if value not in choices:
        *most, last = map(repr, choices)
        raise UsageError(
            f"{option} is {value!r}, but must be {', '.join(most)} or {last}."
        )
    return value


def need_energy(energy: str) -> Literal["twistor", "twist"]:
    """The coordinates of that name."""
    return need_choice("--energy", energy, ("twistor", "twist"))


def need_folder(option: str, path: Path | None) -> None:
    """Refuses a file in a folder that is not there."""
    # unlike those of pathlib, this is no error for a name that is too long or a loop
    if path is not None and not os.path.isdir(os.path.dirname(os.path.abspath(path))):
        raise UsageError(
            f"{option} is {shorten(str(path), 200)}, but there is no folder "
            f"{shorten(str(path.parent), 200)}."
        )


def need_seed(option: str, seed: int, lowest: int = 0) -> None:
    """Refuses a seed of random numbers that is negative or has more than 63 bits."""
    highest = 2**63 - 1
    if not lowest <= seed <= highest:
        raise UsageError(
            f"{option} is {seed}, but must be a whole number from {lowest} to {highest}."
        )


def in_json(record: Any) -> str:
    """A record as JSON; numbers that are not finite, which JSON lacks, are null."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(part) for key, part in value.items()}
        if isinstance(value, list | tuple):
            return [plain(part) for part in value]
        if isinstance(value, float) and not math.isfinite(value):
            return None
        return value

    return json.dumps(plain(record), allow_nan=False)


def meter():
    """A progress bar, where somebody looks."""
    from ..solve.progress import ProgressBar

    return ProgressBar() if sys.stderr.isatty() else None


def finished(motion):
    """The motion, if it reached its end."""
    from ..solve.results import result_names, RESULTS

    ended = str(result_names(motion.result))
    if ended != "successful":
        text = RESULTS[motion.result]
        raise SolveError(f"{text} It went to t = {float(motion.reached):.6g} s.")
    return motion


def need_picture(option: str, path: Path | None, *, film: bool = False) -> None:
    """Refuses, before anything is solved, a picture that could not be written.

    Args:
        option: that asks for it.
        path: of its file.
        film: whether it moves.
    """
    if path is None:
        return
    need_folder(option, path)
    try:
        import matplotlib
    except ImportError:
        raise UsageError(
            f'{option} needs matplotlib: pip install "twistorjax[show]".'
        ) from None
    matplotlib.use("agg")
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    kinds = list(_FILMS if film else FigureCanvasAgg.get_supported_filetypes())
    kind = path.suffix[1:].lower()
    if kind not in kinds:
        raise UsageError(
            f"{option} is {path}, but its name must end with one of "
            f"{', '.join(f'.{name}' for name in kinds)}."
        )
    if kind == "mp4":
        from matplotlib.animation import writers

        if not writers.is_available("ffmpeg"):
            raise UsageError(
                f"{option} {path} needs ffmpeg: install it, or write a .gif."
            )


_FILMS = ("gif", "mp4", "html")


def save(path: Path, picture) -> None:
    """Draws a picture, axes or a figure, into a file."""
    drawn = picture()
    try:
        getattr(drawn, "figure", drawn).savefig(path, dpi=160)
    except (OSError, ValueError) as error:
        raise UsageError(f"--plot cannot be written: {error}") from None
