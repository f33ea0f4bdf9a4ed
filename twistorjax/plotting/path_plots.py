"""Plots of equilibrium paths."""

from typing import Literal, TYPE_CHECKING

import numpy as np

from .._utils.validation import require_choice
from ..mechanism.mechanism import COORDINATES
from ..solve.continuation.solution import Path
from .figure_style import DARK_BLUE, GRAY, ORANGE, prefixed_unit, subplots


if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_path(
    path: Path,
    body: str,
    coordinate: Literal["angle", "x", "y"],
    *,
    load: float = 1.0,
    load_label: str = "load factor",
) -> "Figure":
    """Draw the load factor of a path over a displacement of a body.

    Stable equilibria are drawn as a solid line, unstable ones as a dashed line. Limit
    points are circles, and branch points are squares.

    Args:
        path: Result of `path`, not a batch.
        body: Name of the body.
        coordinate: Its coordinate.
        load: Factor of the load factors, such as the force at the load factor 1.
        load_label: Label of the vertical axis.

    Returns:
        The figure.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: This is a batch, there is no such body, or the coordinate is unknown.

    Example:
        >>> import twistorjax as tj
        >>> truss = tj.examples.truss.von_mises_truss()
        >>> snap = tj.path(truss, loads=[tj.Load("apex", force=(0.0, -20.0))])
        >>> figure = tj.plotting.draw_path(snap, "apex", "y")
    """
    if path.load_factors.ndim != 1:
        raise ValueError(
            f"`path` is a batch of shape {path.load_factors.shape[:-1]}, but one path "
            "can be drawn: `jax.tree.map(lambda values: values[0], path)` is the first."
        )
    column = COORDINATES.index(require_choice("`coordinate`", coordinate, COORDINATES))
    unit = "rad" if coordinate == "angle" else "m"
    displacement = np.asarray(path.displacement(body))[:, column]
    loads, stable = load * np.asarray(path.load_factors), np.asarray(path.stable)
    scale, shown = prefixed_unit(unit, np.nanmax(np.abs(displacement)))
    figure, axes = subplots(size=(6.0, 4.2))
    points = np.asarray(path.critical_points.displacements)[:, path.names.index(body)]
    at = load * np.asarray(path.critical_points.load_factors)
    # The lines of stable and unstable equilibria meet at the critical points.
    rows = np.asarray(path.critical_points.rows) + 0.5
    order = np.argsort(np.concatenate([np.arange(len(loads)), rows]), kind="stable")
    x = np.concatenate([displacement, points[:, column]])[order]
    y = np.concatenate([loads, at])[order]
    known = np.concatenate([stable, np.ones(len(at), bool)])[order]
    unstable = np.concatenate([~stable, np.ones(len(at), bool)])[order]
    for shown_points, style, label in (
        (known, "-", "stable"),
        (unstable, "--", "unstable"),
    ):
        if label == "unstable" and stable.all():
            continue
        axes.plot(
            np.where(shown_points, scale * x, np.nan),
            np.where(shown_points, y, np.nan),
            style,
            color=DARK_BLUE if label == "stable" else GRAY,
            label=label,
        )
    branch = np.asarray(path.critical_points.is_branch)
    for chosen, marker, label in ((~branch, "o", "limit point"), (branch, "s", "branch")):
        if chosen.any():
            axes.plot(
                scale * points[chosen, column],
                at[chosen],
                marker,
                color=ORANGE,
                label=label,
            )
    what = "rotation" if coordinate == "angle" else f"displacement {coordinate}"
    axes.set_xlabel(f"{what} of {body} ({shown})")
    axes.set_ylabel(load_label)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    return figure
