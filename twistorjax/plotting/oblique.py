"""Displacements out of the plane in an oblique view."""

from typing import TYPE_CHECKING

import numpy as np
from typing_extensions import TypeAliasType

from .._utils.validation import quote
from ..mechanism.mechanism import Mechanism
from ..solve.out_of_plane_model import OutOfPlaneResponse
from ..solve.vibration_results import OutOfPlaneVibrations
from .drawing import color_bar, draw_dotted, draw_shapes, figure_size, Part
from .figure_style import length_unit, new_axes, prefixed_unit
from .shapes import (
    cubic,
    hinge_frames,
    mechanism_size,
    Shape,
    shapes,
    with_flexure_outlines,
)


if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Displacements in the picture for those along y, x being to the right and z upwards
_ALONG_Y = np.array([0.45, 0.55])
OBLIQUE_AXES = "x, and y to the back", "z, and y to the back"
FLAT = {"linewidths": 0.8, "zorder": 0.5}  # style of the outlines at rest
_AMPLITUDE = 0.15  # of the largest displacement, relative to the size of the mechanism

# What can be drawn in an oblique view
OutOfPlaneDrawn = TypeAliasType(
    "OutOfPlaneDrawn", OutOfPlaneResponse | OutOfPlaneVibrations
)


def draw_out_of_plane(
    mechanism: Mechanism,
    found: OutOfPlaneDrawn,
    *,
    mode: int = 0,
    magnify: float | int | None = None,
    axes: "Axes | None" = None,
) -> "Axes":
    """Draw displacements or a mode out of the plane in an oblique view, colored by z.

    The view is an oblique projection: x is to the right, y to the back, and z upwards.
    Hinges are drawn as in `draw`.

    Args:
        mechanism: The mechanism.
        found: The response to constant loads, or vibrations, of `out_of_plane`.
        mode: Index of the mode of vibrations. Mode 0 has the lowest frequency.
        magnify: Factor on the displacements; by default it is chosen, so that they can be
            seen.
        axes: Axes to draw on. By default new ones are created.

    Returns:
        The axes.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: `found` is a batch or a frequency response, or there is no such mode.

    Example:
        >>> import twistorjax as tj
        >>> stage = tj.examples.stage.microstage()
        >>> modes = tj.out_of_plane(stage).vibrations()
        >>> axes = tj.plotting.draw_out_of_plane(stage, modes)
    """
    mechanism = with_flexure_outlines(mechanism)
    poses, displacements, title = drawn_displacements(mechanism, found, mode)
    size = mechanism_size(mechanism)
    flat, heights = shapes_and_heights(mechanism, poses, displacements)
    largest = max(np.max(np.abs(values)) for values in heights)
    factor = magnify
    if factor is None:
        factor = float(f"{_AMPLITUDE * size / (largest or 1.0):.1g}")
    drawn = oblique(flat, heights, factor)
    unit, unit_name = length_unit(size)
    if axes is None:
        corners = np.concatenate([shape.corners for shape in drawn])
        axes = new_axes(figure_size(corners, color_bar=True))
    draw_dotted(axes, oblique(flat, heights, 0.0), unit, **FLAT)
    is_mode = isinstance(found, OutOfPlaneVibrations)
    scale, label = 1 / (largest or 1.0), "z, relative to the largest"
    if not is_mode:
        scale, shown = prefixed_unit("m", largest)
        label = f"z ({shown})"
    (fills,) = color_bar(axes, part_heights(drawn, heights, scale), label)
    draw_shapes(axes, drawn, unit, fills)
    axes.set_aspect("equal")
    axes.autoscale_view()
    for axis, name in zip("xy", OBLIQUE_AXES, strict=True):
        axes.set(**{f"{axis}label": f"{name} ({unit_name})"})
    if not is_mode:
        title = f"displacements out of the plane, magnified {factor:.3g} times"
    axes.set_title(title, fontsize="medium")
    return axes


def drawn_displacements(
    mechanism: Mechanism, found: OutOfPlaneDrawn, mode: int
) -> tuple[np.ndarray, np.ndarray, str]:
    """Return poses (rad, m, m), displacements out of the plane, and a title."""
    if found.names != mechanism.names:
        raise ValueError(
            f"`found` is of a mechanism with the bodies {', '.join(found.names)}, but "
            f"this one has {', '.join(mechanism.names)}."
        )
    poses = np.asarray(found.poses)
    if poses.ndim != 2:
        raise ValueError(
            f"`found` is a batch of shape {poses.shape[:-2]}, but one result can be "
            "drawn: `jax.tree.map(lambda values: values[0], found)` is the first."
        )
    if isinstance(found, OutOfPlaneResponse):
        if found.frequencies is not None:
            raise ValueError(
                "`found` is a frequency response, whose amplitudes are complex. Draw the "
                "response to constant loads, or a mode of vibrations."
            )
        return poses, np.asarray(found.displacements), ""
    frequencies = np.asarray(found.frequencies)
    if not -len(frequencies) <= mode < len(frequencies):
        raise ValueError(
            f"`mode` is {quote(mode)}, but there are {len(frequencies)} vibrations: give "
            f"an index from 0 to {len(frequencies) - 1}."
        )
    title = f"vibration out of the plane at {frequencies[mode]:.5g} Hz"
    return poses, np.asarray(found.shapes)[mode], f"{title}, arbitrary amplitude"


def vibration_shapes(
    mechanism: Mechanism,
    found: OutOfPlaneVibrations,
    mode: int,
    magnify: float | int,
    frames: int,
) -> tuple[list[list[Shape]], list[Shape], dict[Part, np.ndarray], str]:
    """Return the shapes in the frames of one period, and what else is drawn of them.

    These are the flat shapes, the relative heights in each frame, and the title.
    """
    poses, displacements, title = drawn_displacements(mechanism, found, mode)
    flat, heights = shapes_and_heights(mechanism, poses, displacements)
    largest = max(np.max(np.abs(values)) for values in heights) or 1.0
    amplitude = magnify * _AMPLITUDE * mechanism_size(mechanism) / largest
    phases = np.sin(2 * np.pi * np.arange(frames) / frames)
    moved = [oblique(flat, heights, amplitude * phase) for phase in phases]
    relative = part_heights(flat, heights, 1 / largest)
    colored = {part: values * phases for part, values in relative.items()}
    return moved, oblique(flat, heights, 0.0), colored, title


def shapes_and_heights(
    mechanism: Mechanism, poses: np.ndarray, displacements: np.ndarray
) -> tuple[list[Shape], list[np.ndarray]]:
    """Return outlines in the plane, and z at each of their corners; m.

    The displacements of each body are z and the rotations about x and y; m, rad, rad.
    """
    drawn, heights = shapes(mechanism, poses), []
    for shape in drawn:
        kind, row = shape.part
        if kind == "body":
            heights.append(_height(poses[row], displacements[row], shape.corners))
            continue
        # A cubic polynomial along the hinge, between the two bodies
        first, second = mechanism.hinge_assembly.ends[row]
        frames = hinge_frames(mechanism, poses, row)
        middle = np.mean(frames, axis=0)
        axis = np.array([np.cos(middle[0]), np.sin(middle[0])])
        along = (shape.corners - middle[1:]) @ axis
        low, length = along.min(), np.ptp(along) or 1.0
        u = (along - low) / length
        ends = middle[1:] + np.stack([low, low + length])[:, None] * axis
        (z_a,), (z_b,) = (
            _height(poses[body], displacements[body], end[None])
            for body, end in zip((first, second), ends, strict=True)
        )
        slope_a, slope_b = (
            length * (displacements[body, 1] * axis[1] - displacements[body, 2] * axis[0])
            for body in (first, second)
        )
        heights.append(cubic(u, z_a, slope_a, z_b, slope_b))
    return drawn, heights


def oblique(drawn: list[Shape], heights: list[np.ndarray], factor: float) -> list[Shape]:
    """Return outlines in an oblique view, with z multiplied by a factor."""
    return [
        shape._replace(corners=_projected(shape.corners, factor * z))
        for shape, z in zip(drawn, heights, strict=True)
    ]


def part_heights(
    drawn: list[Shape], heights: list[np.ndarray], scale: float
) -> dict[Part, np.ndarray]:
    """Return the mean of z of each part, times a scale, in the form of `color_bar`."""
    return {
        shape.part: np.array([scale * float(np.mean(z))])
        for shape, z in zip(drawn, heights, strict=True)
    }


def _height(pose: np.ndarray, displacement: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Compute z of points of a body; m."""
    z, about_x, about_y = displacement
    x, y = (points - pose[1:]).T
    return z + about_x * y - about_y * x


def _projected(corners: np.ndarray, heights: np.ndarray) -> np.ndarray:
    x, y = corners.T
    return np.stack([x + _ALONG_Y[0] * y, _ALONG_Y[1] * y + heights], axis=1)
