"""A mechanism at given poses, drawn on matplotlib axes."""

from collections.abc import Mapping, Sequence
from typing import Literal, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from .._utils.types import PosesLike
from .._utils.validation import index_of
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Load
from ..mechanism.mechanism import Mechanism
from ..solve.motion import Motion
from ..solve.statics import Equilibrium
from .canvas import FILLS, GRAY, lengths, new_axes, ORANGE, readable
from .marks import mark_constraints, mark_frames, mark_loads, mark_reactions
from .shapes import placed, ports, Shape, shapes, size_of


if TYPE_CHECKING:
    from matplotlib.axes import Axes


Color = tuple[float, ...]  # red, green, blue, opacity


def draw(
    mechanism: Mechanism,
    poses: PosesLike | Equilibrium | Motion | None = None,
    *,
    magnify: float | int = 1.0,
    ghost: bool = True,
    names: bool = True,
    frames: bool = False,
    loads: Sequence[Load] = (),
    reactions: bool = False,
    constraints: Sequence[AbstractConstraint] = (),
    color: Literal["energy"] | Mapping[str, ArrayLike] | None = None,
    label: str = "",
    axes: "Axes | None" = None,
) -> "Axes":
    """Draws a mechanism: bodies by their outlines, hinges between them, as they bend.

    A body without an outline is drawn as arms from its origin to its hinges; a hinge
    without one as a spiral spring. Outlines of leaves and notches: `leaf_outline` and
    `notch_outline`, handed to `Hinge`.

    Args:
        mechanism: what to draw.
        poses: of its bodies, by default at rest, or an equilibrium, or a motion for its
            end; rad, m, m.
        magnify: a factor on displacements, angles included; stated on the axes.
        ghost: whether the shape at rest is shown too, where it differs.
        names: whether bodies and hinges are labelled.
        frames: whether the frames of bodies and hinges are shown; axis 1 is the thicker.
        loads: to be shown as arrows with their sizes, but for those below a thousandth
            of the largest.
        reactions: whether those of the answer handed as `poses` are shown likewise.
        constraints: pins and sliders to be shown.
        color: of the hinges: by the "energy" that each stores, or by a number for each,
            by its name, as the stress that `leaf_stress` gives.
        label: what the numbers are, with their unit, for the bar of colours.
        axes: on which to draw, by default new ones.

    Returns:
        The axes, in millimetres, unless the mechanism is very large or small.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: reactions are asked for without an answer that has them; the poses
            are a batch, or not finite; a name is unknown.

    Example:
        >>> from twistorjax.examples import stage
        >>> axes = draw(stage.microstage())
        >>> axes.get_xlabel()
        'x (mm)'
    """
    reference = np.asarray(mechanism.reference)
    displacements = _displacements(mechanism, poses)
    moved = reference + magnify * displacements
    unit, word = lengths(size_of(mechanism))
    values, label = _coloured(mechanism, reference + displacements, color, label)
    if axes is None:
        axes = new_axes(figure_size(mechanism, moved, bool(values)))
    if ghost and np.any(displacements):
        draw_ghost(mechanism, axes)
    fills = _bar(axes, values, label) if values else {}
    for shape in shapes(mechanism, moved):
        hinge = shape.kind in ("neck", "spring")
        _draw_part(axes, shape, unit, fills.get(shape.row) if hinge else None)
    if frames:
        mark_frames(axes, mechanism, moved, unit)
    mark_constraints(axes, mechanism, moved, constraints, unit)
    mark_loads(axes, mechanism, moved, loads, unit)
    if reactions:
        mark_reactions(axes, mechanism, moved, _reactions(poses), unit)
    if names:
        marked = bool(frames or reactions or len(loads))
        _label(axes, mechanism, moved, unit, marked)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel(f"x ({word})")
    axes.set_ylabel(f"y ({word})")
    if magnify != 1:
        title = f"displacements magnified {magnify:g} times"
        if ghost and np.any(displacements):
            title += "; dotted: at rest"
        axes.set_title(title, fontsize="medium")
    return axes


def figure_size(
    mechanism: Mechanism, poses: np.ndarray, bar: bool = False
) -> tuple[float, float]:
    """Of a figure that a mechanism fills, with room for a bar of colours; inches."""
    corners = np.concatenate([part.corners for part in shapes(mechanism, poses)])
    wide, high = np.ptp(corners, axis=0)
    part = np.clip(high / wide if wide else 2.0, 0.25, 1.2)
    return 7.0 + 0.8 * bar, float(6.0 * part + 1.0)


def draw_ghost(mechanism: Mechanism, axes: "Axes") -> None:
    """Dots the bodies at rest."""
    from matplotlib.patches import Polygon

    unit, _ = lengths(size_of(mechanism))
    for shape in shapes(mechanism, np.asarray(mechanism.reference)):
        if shape.kind in ("body", "held", "arm"):
            axes.add_patch(
                Polygon(
                    unit * shape.corners, closed=shape.kind != "arm", fill=False,
                    edgecolor=GRAY, linestyle=":", zorder=3,
                )
            )  # fmt: skip


def _draw_part(
    axes: "Axes", shape: Shape, unit: float, fill: Color | None = None
) -> None:
    """Draws one part of a mechanism."""
    from matplotlib.patches import Polygon

    if shape.kind in ("arm", "spring"):
        spring = shape.kind == "spring"
        style = {
            "closed": False, "fill": False, "linewidth": 1.4 if spring else 3.0,
            "edgecolor": fill or ORANGE if spring else "#7f9fba",
            "zorder": 2.5 if spring else 1, "capstyle": "round",
        }  # fmt: skip
    else:
        neck = shape.kind == "neck"
        color = fill or FILLS[shape.kind]
        style = {
            "closed": True, "facecolor": color, "linewidth": 0.8,
            "edgecolor": color if neck else "#404040",
            "zorder": 2 if neck else 1,
        }  # fmt: skip
    axes.add_patch(Polygon(unit * shape.corners, **style))


def _displacements(
    mechanism: Mechanism, poses: PosesLike | Equilibrium | Motion | None
) -> np.ndarray:
    if poses is None:
        return np.zeros(mechanism.reference.shape)
    if isinstance(poses, Equilibrium | Motion):
        rows = poses.poses
        if (batch := rows.ndim - 2 - isinstance(poses, Motion)) > 0:
            raise ValueError(
                f"`poses` is a batch of answers, of shape {rows.shape[:batch]}: draw one,"
                " as by `jax.tree.map(lambda leaf: leaf[0], answers)`."
            )
        poses = rows if isinstance(poses, Equilibrium) else rows[-1]
    found = np.asarray(mechanism.displacements(poses))
    if not np.all(np.isfinite(found)):
        raise ValueError(
            "`poses` are not finite: the solve that gave them did not succeed, as its "
            "`result` tells."
        )
    return found


def _reactions(poses: PosesLike | Equilibrium | Motion | None) -> np.ndarray:
    if isinstance(poses, Equilibrium):
        return np.asarray(poses.reactions)
    if isinstance(poses, Motion):
        return np.asarray(poses.reactions[-1])
    raise ValueError(
        "`reactions` are told by an equilibrium or a motion: hand that as `poses`."
    )


def _coloured(
    mechanism: Mechanism,
    poses: np.ndarray,
    color: Literal["energy"] | Mapping[str, ArrayLike] | None,
    label: str,
) -> tuple[dict[int, float], str]:
    """The number by which each hinge is coloured, and what it is."""
    if color is None:
        return {}, ""
    if isinstance(color, str):
        if color != "energy":
            raise ValueError(
                f"`color` is {color!r}, but must be 'energy', or a number for each "
                "hinge by its name."
            )
        there, stored = jnp.asarray(poses), {}
        for row, name in enumerate(mechanism.hinge_names):
            displaced = mechanism.displacement_of(name, there)
            stored[row] = float(mechanism.hinge_assembly.energy_of(row)(displaced))
        factor, unit = readable("J", max(map(abs, stored.values())))
        return {row: factor * value for row, value in stored.items()}, f"energy ({unit})"
    told = {
        index_of("`color`", "hinge", name, mechanism.hinge_names): float(
            np.asarray(value)
        )
        for name, value in color.items()
    }
    return told, label


def _bar(axes: "Axes", values: Mapping[int, float], label: str) -> dict[int, Color]:
    """A bar of colours beside the axes, and the colour of each hinge."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    low = min(0.0, *values.values())
    # without its lightest, which would be lost on white
    dark = ListedColormap(colormaps["plasma"](np.linspace(0, 0.88, 256)))
    scale = ScalarMappable(Normalize(low, max(values.values())), dark)
    axes.figure.colorbar(scale, ax=axes, label=label, shrink=0.8)
    rows, colors = list(values), scale.to_rgba(np.array(list(values.values())))
    return {row: tuple(map(float, rgba)) for row, rgba in zip(rows, colors, strict=True)}


def _label(
    axes: "Axes", mechanism: Mechanism, poses: np.ndarray, unit: float, marked: bool
) -> None:
    """Names of bodies, below what is marked at their origins; of hinges beside them."""
    for name, pose, outline in zip(
        mechanism.names, poses, mechanism.outlines, strict=True
    ):
        place = pose[1:] if outline is None else _inside(placed(pose, outline))
        axes.annotate(
            name, tuple(unit * place), xytext=(0, -10 if marked else 0), ha="center",
            textcoords="offset points", va="center", zorder=5,
        )  # fmt: skip
    middle = np.mean(axes.dataLim.intervalx) / unit
    for hinge, name in enumerate(mechanism.hinge_names):
        angle, x, y = np.mean(ports(mechanism, poses, hinge), axis=0)
        upright = abs(np.sin(angle)) > abs(np.cos(angle))
        inwards = -1 if x > middle else 1
        axes.annotate(
            name, (unit * x, unit * y), xytext=(11 * inwards, 0) if upright else (0, 11),
            ha="center" if not upright else "left" if inwards > 0 else "right",
            va="center", zorder=5, textcoords="offset points",
            color="#8c3b00", fontstyle="italic",
        )  # fmt: skip


def _inside(corners: np.ndarray) -> np.ndarray:
    """A point well inside a polygon, whatever its shape: the best of a grid.

    Of points as far from the edges, that nearest the mean corner.
    """
    from matplotlib.path import Path

    columns, rows = np.linspace(corners.min(axis=0), corners.max(axis=0), 30).T
    grid = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    grid = grid[Path(corners).contains_points(grid)]
    start, end = corners, np.roll(corners, -1, axis=0)
    along = end - start
    share = np.einsum("gck,ck->gc", grid[:, None] - start, along)
    share = np.clip(share / np.sum(along**2, axis=1), 0, 1)[..., None]
    gaps = np.linalg.norm(grid[:, None] - start - share * along, axis=2).min(axis=1)
    strayed = np.linalg.norm(grid - corners.mean(axis=0), axis=1)
    return grid[np.argmax(gaps - 0.05 * strayed)]
