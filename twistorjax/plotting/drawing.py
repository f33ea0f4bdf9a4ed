"""Drawings of a mechanism at given poses, on matplotlib axes."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from typing_extensions import TypeAliasType

from .._utils.types import NamedNumbers, PosesLike
from .._utils.validation import (
    index_of,
    listing,
    quote,
    require_finite,
    require_instance,
    require_names,
)
from ..assembly.assembly import HingeAssembly
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.hinge import AbstractOutline
from ..mechanism.loads import Load
from ..mechanism.mechanism import Mechanism
from ..solve.integration.solution import Motion
from ..solve.linearization import LinearResponse
from ..solve.statics.solution import Equilibrium
from ..solve.stresses import stresses
from ..solve.vibration_results import Vibrations
from .figure_style import (
    BROWN,
    FILLS,
    GRAY,
    GREEN,
    length_unit,
    new_axes,
    ORANGE,
    prefixed_unit,
    RED,
)
from .marks import (
    mark_constraints,
    mark_frames,
    mark_wrenches,
    Wrenches,
    wrenches_of_loads,
)
from .shapes import (
    center_line_point,
    hinge_frames,
    mechanism_size,
    Shape,
    shapes,
    to_world,
    with_flexure_outlines,
)


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PolyCollection


Color = tuple[float, ...]  # red, green, blue, opacity


# What can be drawn; poses in rad, m, m
Drawn = TypeAliasType("Drawn", PosesLike | Equilibrium | LinearResponse | Motion)
# The stored energy or the stress of each hinge, the rotation of each body, or a number
# for each hinge
Colors = TypeAliasType("Colors", Literal["energy", "stress", "angle"] | NamedNumbers)

Part = tuple[str, int]  # "body" or "hinge", and its index in the mechanism
_MOST_NAMES = 40  # of bodies that are labeled by default
_NARROW = 0.25  # smallest ratio of the sides of a figure
_SAME_PLACE = 0.1  # distance of the centers of leaves that cross, over their length
COLORS = {**FILLS, "line": "#7f9fba", "spring": ORANGE}


def draw(
    mechanism: Mechanism,
    poses: Drawn | None = None,
    *,
    magnify: float | int = 1.0,
    reference: bool = True,
    names: bool | Sequence[str] | None = None,
    frames: bool = False,
    loads: Sequence[Load] = (),
    reactions: bool = False,
    constraints: Sequence[AbstractConstraint] = (),
    color: Colors | None = None,
    label: str = "",
    axes: "Axes | None" = None,
) -> "Axes":
    """Draw a mechanism in its reference configuration or a deformed one.

    Bodies and hinges are drawn by their outlines. A body without an outline is drawn as
    lines from its origin to its hinges. A hinge without an outline is drawn by its
    contour, if it is a flexure that was created from dimensions, and as the beam with its
    stiffness, if this is a diagonal `Quadratic` as that of a `piezo_stack`. An
    `AxialSpring` is drawn as a zigzag line between its ends, a `Stop` by the two faces
    that meet where its gap is closed, and any other hinge as a spiral spring.

    Args:
        mechanism: The mechanism.
        poses: Poses of its bodies (rad, m, m), an equilibrium, or a motion, of which the
            last pose is drawn. By default the reference configuration is drawn.
        magnify: Factor on all displacements, including angles, and on the gaps of stops.
            It is stated in the title.
        reference: Whether the reference configuration is shown by dotted lines.
        names: Whether bodies and hinges are labeled with their names, or the names of
            those that are, for example not of all segments of a chain; by default only if
            there are few of them.
        frames: Whether the frames of bodies and hinges are shown. Axis 1 is thicker.
        loads: Loads to show as arrows with their values. A force or moment is left out if
            its effect is below a thousandth of the largest one. The effect of a force is
            the force times the size of the mechanism.
        reactions: Whether the reactions of the equilibrium or motion given as `poses` are
            shown in the same way.
        constraints: Pins and sliders to show.
        color: "energy" colors the hinges by their stored energies, and "stress" by their
            largest stresses; see `stresses`. A mapping colors them by one number for each
            hinge name. "angle" colors the bodies by their rotations.
        label: Label of the color bar, with the unit of the numbers in `color`.
        axes: Axes to draw on. By default new ones are created.

    Returns:
        The axes. Their unit is the millimeter, unless the mechanism is larger than 10 m
        or smaller than 1 mm.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: Reactions are requested, but `poses` is not a result that has them;
            the stress is not known in any hinge; the poses are a batch or not finite; or
            a name is unknown.

    Example:
        >>> from twistorjax.examples import stage
        >>> axes = draw(stage.microstage())
        >>> axes.get_xlabel()
        'x (mm)'
    """
    from matplotlib.colors import to_rgba

    require_instance("mechanism", mechanism, Mechanism)
    magnify = float(require_finite("`magnify`", magnify))
    mechanism = with_flexure_outlines(mechanism)
    undeformed = np.asarray(mechanism.reference)
    displacements = _displacements(mechanism, poses)
    drawn_poses = undeformed + magnify * displacements
    size = mechanism_size(mechanism)
    unit, unit_name = length_unit(size)
    values, label = part_values(mechanism, displacements[None], color, label)
    drawn = shapes(mechanism, drawn_poses, magnify)
    if axes is None:
        corners = np.concatenate([shape.corners for shape in drawn])
        axes = new_axes(figure_size(corners, bool(values)))
    reference = reference and bool(np.any(displacements))
    if reference:
        draw_reference(mechanism, axes)
    (fills,) = color_bar(axes, values, label) if values else [{}]
    if color == "stress":  # of other hinges, it is not known
        hinges = [("hinge", row) for row in range(len(mechanism.hinge_names))]
        fills = {**dict.fromkeys(hinges, to_rgba(GRAY)), **fills}
    draw_shapes(axes, drawn, unit, fills)
    labeled = _labeled(mechanism, names)
    if frames:
        mark_frames(axes, mechanism, drawn_poses, unit)
    mark_constraints(axes, mechanism, drawn_poses, constraints, unit)
    wrenches, hinge_forces = [wrenches_of_loads(mechanism, drawn_poses, loads, RED)], None
    if reactions:
        wrenches.append(Wrenches(drawn_poses[:, 1:], _reactions(poses), GREEN))
        hinge_forces = np.asarray(
            mechanism.hinge_assembly.forces(jnp.asarray(displacements))
        )
    mark_wrenches(axes, wrenches, size, unit, hinge_forces=hinge_forces)
    _label_parts(axes, mechanism, drawn_poses, unit, labeled)
    axes.set_aspect("equal")
    axes.autoscale_view()
    _widen(axes)
    axes.set_xlabel(f"x ({unit_name})")
    axes.set_ylabel(f"y ({unit_name})")
    if magnify != 1:
        title = f"displacements magnified {magnify:g} times"
        if reference:
            title += "; dotted: reference"
        axes.set_title(title, fontsize="medium")
    return axes


def figure_size(corners: np.ndarray, color_bar: bool = False) -> tuple[float, float]:
    """Return the size (inches) of a figure that a drawing with these corners fills."""
    width, height = np.ptp(corners, axis=0)
    ratio = np.clip(height / width if width else 1 / _NARROW, _NARROW, 1 / _NARROW)
    scale = min(6.0, 5.5 / ratio)
    return float(scale + 1.0 + 0.8 * color_bar), float(scale * ratio + 1.0)


def _widen(axes: "Axes") -> None:
    """Widen axes of equal scale that have no room for the numbers on one of them."""
    limits = {"x": np.array(axes.get_xlim()), "y": np.array(axes.get_ylim())}
    least = _NARROW * max(np.ptp(both) for both in limits.values())
    for name, both in limits.items():
        if (missing := least - np.ptp(both)) > 0:
            axes.set(**{f"{name}lim": both + missing * np.array([-0.5, 0.5])})


def draw_reference(mechanism: Mechanism, axes: "Axes") -> None:
    """Draw the bodies in the reference configuration by dotted lines."""
    drawn = shapes(mechanism, np.asarray(mechanism.reference))
    bodies = [shape for shape in drawn if shape.part[0] == "body"]
    draw_dotted(axes, bodies, length_unit(mechanism_size(mechanism))[0], zorder=3.0)


def draw_dotted(
    axes: "Axes", drawn: Sequence[Shape], unit: float, **style: float
) -> None:
    """Draw parts of a mechanism by dotted lines."""
    from matplotlib.collections import PolyCollection

    groups = grouped_corners(drawn)
    for closed in (True, False):
        corners = [
            unit * part
            for group, is_closed in zip(groups, ARE_CLOSED, strict=True)
            for part in group
            if is_closed == closed
        ]
        axes.add_collection(
            PolyCollection(
                corners, closed=closed, facecolors="none", edgecolors=GRAY,
                linestyles=":", **style,
            )
        )  # fmt: skip


# Kinds of shapes that are drawn together, and their style
_STYLES: dict[tuple[str, ...], dict[str, Any]] = {
    ("body", "fixed"): {"edgecolors": "#404040", "linewidths": 0.8, "zorder": 1},
    ("line",): {"linewidths": 3.0, "zorder": 1},
    ("hinge",): {"linewidths": 0.8, "zorder": 2},
    ("spring",): {"linewidths": 1.4, "zorder": 2.5},
}
ARE_CLOSED = True, False, True, False  # Whether the shapes of each kind are closed


def draw_shapes(
    axes: "Axes", drawn: Sequence[Shape], unit: float, fills: Mapping[Part, Color]
) -> "list[PolyCollection]":
    """Draw the parts of a mechanism, by default in the color of their kind.

    The collections have the shapes in the order of `grouped_corners`.
    """
    from matplotlib.collections import PolyCollection

    collections = []
    for style, corners, closed in zip(
        _STYLES.values(), grouped_corners(drawn), ARE_CLOSED, strict=True
    ):
        ends = {} if closed else {"capstyle": "round"}
        scaled, settings = [unit * part for part in corners], {**style, **ends}
        settings["facecolors"] = "none"
        collections.append(PolyCollection(scaled, closed=closed, **settings))
        axes.add_collection(collections[-1])
    paint(collections, drawn, fills)
    return collections


def paint(
    collections: "Sequence[PolyCollection]",
    drawn: Sequence[Shape],
    fills: Mapping[Part, Color],
) -> None:
    """Change the colors of the collections of `draw_shapes`."""
    for collection, (kinds, style), closed in zip(
        collections, _STYLES.items(), ARE_CLOSED, strict=True
    ):
        group = [shape for shape in drawn if shape.kind in kinds]
        colors: Any = [fills.get(shape.part) or COLORS[shape.kind] for shape in group]
        if closed:
            collection.set_facecolor(colors)
        if "edgecolors" not in style:
            collection.set_edgecolor(colors)


def grouped_corners(drawn: Sequence[Shape]) -> list[list[np.ndarray]]:
    """Return the corners (m) of the shapes in each collection of `draw_shapes`."""
    return [
        [shape.corners for shape in drawn if shape.kind in kinds] for kinds in _STYLES
    ]


def _displacements(mechanism: Mechanism, poses: Drawn | None) -> np.ndarray:
    """Return the displacements of the bodies that are drawn; rad, m, m."""
    if poses is None:
        return np.zeros(mechanism.reference.shape)
    if isinstance(poses, Equilibrium | LinearResponse | Motion):
        rows = poses.poses
        if (batch := rows.ndim - 2 - isinstance(poses, Motion)) > 0:
            raise ValueError(
                f"`poses` is a batch of results, of shape {rows.shape[:batch]}. Draw one "
                "of them, for example `jax.tree.map(lambda leaf: leaf[0], results)`."
            )
        poses = rows[-1] if isinstance(poses, Motion) else rows
    if isinstance(poses, Vibrations):
        raise ValueError(
            "`poses` are vibrations. Use `animate(mechanism, vibrations, mode=0)`, or "
            "draw the poses `mechanism.reference + amplitude * vibrations.shapes[0]`."
        )
    displacements = np.asarray(mechanism.displacements(poses, single=True))
    if not np.all(np.isfinite(displacements)):
        raise ValueError(
            "`poses` are not finite. The solve that computed them did not succeed; its "
            "`result` holds the reason."
        )
    return displacements


def _reactions(poses: Drawn | None) -> np.ndarray:
    """Return the reactions on the bodies that are drawn; N m, N, N."""
    if isinstance(poses, Motion):
        return np.asarray(poses.reactions[-1])
    if isinstance(poses, Equilibrium | LinearResponse):
        return np.asarray(poses.reactions)
    raise ValueError(
        "`reactions` is True, but `poses` has no reactions. Give an equilibrium or a "
        "motion as `poses`."
    )


def part_values(
    mechanism: Mechanism,
    displacements: np.ndarray,
    color: Colors | None,
    label: str = "",
) -> tuple[dict[Part, np.ndarray], str]:
    """Return the numbers of each part that is colored, and the label of the color bar.

    There is a number for each frame, in which the bodies have given displacements (rad,
    m, m).
    """
    if color is None:
        return {}, ""
    if not isinstance(color, str):
        values = {}
        for name, value in color.items():
            row = index_of("`color`", "hinge", name, mechanism.hinge_names)
            values["hinge", row] = np.full(len(displacements), float(np.asarray(value)))
        return values, label
    if color == "angle":
        angles = np.degrees(displacements[:, :, 0]).T
        return {("body", row): angle for row, angle in enumerate(angles)}, "angle (°)"
    if color == "energy":
        assembly, names = mechanism.hinge_assembly, mechanism.hinge_names
        of_hinges, unit = _energies(assembly, jnp.asarray(displacements)), "J"
    elif color == "stress":
        poses = np.asarray(mechanism.reference) + displacements
        frames = [stresses(mechanism, of_frame) for of_frame in poses]
        of_hinges = [frame.largest for frame in frames]
        unit, names = "Pa", frames[0].names
    else:
        raise ValueError(
            f"`color` is {quote(color)}, but must be 'energy', 'stress', 'angle', or a "
            "mapping from hinge names to numbers."
        )
    numbers = np.asarray(of_hinges)
    factor, unit = prefixed_unit(unit, np.max(np.abs(numbers)))
    rows = [mechanism.hinge_names.index(name) for name in names]
    scaled = zip(rows, factor * numbers.T, strict=True)
    return {("hinge", row): values for row, values in scaled}, f"{color} ({unit})"


_energies = jax.jit(jax.vmap(HingeAssembly.energies, in_axes=(None, 0)))


def color_bar(
    axes: "Axes", values: Mapping[Part, np.ndarray], label: str
) -> list[dict[Part, Color]]:
    """Draw a color bar beside the axes, and return the colors of parts in each frame."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    numbers = np.stack(list(values.values()), axis=1)
    low = min(0.0, numbers.min())
    # The lightest colors are left out, because they are hard to see on white.
    dark = ListedColormap(colormaps["plasma"](np.linspace(0, 0.88, 256)))
    scale = ScalarMappable(Normalize(low, numbers.max()), dark)
    ticks = None if numbers.max() > low else [low]
    axes.figure.colorbar(scale, ax=axes, label=label, shrink=0.8, ticks=ticks)
    return [
        {part: tuple(map(float, rgba)) for part, rgba in zip(values, colors, strict=True)}
        for colors in (scale.to_rgba(row) for row in numbers)
    ]


def _labeled(mechanism: Mechanism, names: bool | Sequence[str] | None) -> Collection[str]:
    """Return the names of the parts that are labeled."""
    parts = [*mechanism.names, *mechanism.hinge_names]
    if names is None:
        names = len(mechanism.names) <= _MOST_NAMES
    if isinstance(names, bool | np.bool_):
        return parts if names else []
    require_names("`names`", names)
    for name in names:
        if name not in parts:
            raise ValueError(
                f"`names` has {quote(name)}, but the parts are {listing(parts)}."
            )
    return names


def _label_parts(
    axes: "Axes",
    mechanism: Mechanism,
    poses: np.ndarray,
    unit: float,
    labeled: Collection[str],
) -> None:
    """Label hinges beside their centers, and bodies inside their outlines."""
    if not labeled:
        return
    from .labels import Labels

    labels = Labels.of(axes)
    middle = np.mean(axes.dataLim.intervalx) / unit
    pairs = [
        hinge_frames(mechanism, poses, row) for row in range(len(mechanism.hinge_names))
    ]
    centers = np.mean(pairs, axis=1)[:, 1:]
    for hinge, name in enumerate(mechanism.hinge_names):
        if name not in labeled:
            continue
        angle, x, y = np.mean(pairs[hinge], axis=0)
        outline = mechanism.hinge_outlines[hinge]
        if outline is not None and not isinstance(outline, AbstractOutline):
            corners = np.asarray(outline)
            gaps = np.linalg.norm(centers - [x, y], axis=1)
            if np.sum(gaps < _SAME_PLACE * np.ptp(corners[:, 0])) > 1:
                # The names of leaves that cross each other are beside their ends.
                x, y = center_line_point(*pairs[hinge], corners, 0.8)
        upright = abs(np.sin(angle)) > abs(np.cos(angle))
        inward = -1.0 if x > middle else 1.0
        direction = np.array([inward, 0.0] if upright else [0.0, 1.0])
        center = unit * np.array([x, y])
        labels.add(name, center, direction, color=BROWN, fontstyle="italic", zorder=5)
    for name, pose, outline in zip(
        mechanism.names, poses, mechanism.outlines, strict=True
    ):
        if name not in labeled:
            continue
        if outline is None:
            labels.add(name, unit * pose[1:], np.array([0.0, -1.0]), zorder=5)
        else:
            point = unit * _inner_point(to_world(pose, outline))
            labels.add(name, point, np.zeros(2), zorder=5)


def _inner_point(corners: np.ndarray) -> np.ndarray:
    """Find a point of a grid that is far from the edges of a polygon.

    The polygon need not be convex. The distance from the mean corner is subtracted with a
    small weight. Of points with the same distance from the edges, the most central one is
    found.
    """
    from matplotlib.path import Path

    columns, rows = np.linspace(corners.min(axis=0), corners.max(axis=0), 30).T
    grid = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    grid = grid[Path(corners).contains_points(grid)]
    start, end = corners, np.roll(corners, -1, axis=0)
    edges = end - start
    # Position of the closest point on each edge, from 0 at its start to 1 at its end.
    share = np.einsum("gck,ck->gc", grid[:, None] - start, edges)
    share = np.clip(share / np.sum(edges**2, axis=1), 0, 1)[..., None]
    gaps = np.linalg.norm(grid[:, None] - start - share * edges, axis=2).min(axis=1)
    from_mean = np.linalg.norm(grid - corners.mean(axis=0), axis=1)
    return grid[np.argmax(gaps - 0.05 * from_mean)]
