"""Contour plots of the energy and the wrench of a hinge over its displacement."""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Scalar
from .._utils.validation import require_instance
from ..energies.base import AbstractEnergy
from ..energies.validity import WithValidityRange
from ..geometry.twistors import Displacement
from ..mechanism.hinge import Hinge
from .figure_style import BLACK, prefixed_unit, subplots


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_ROTATION = 0.5  # largest rotation by default; rad
_NEWTON_STEPS = 30  # of the minimization over the axial displacement


def draw_energy(
    energy: AbstractEnergy | Hinge,
    *,
    rotation: float | int | None = None,
    transverse: float | int | None = None,
    axial: float | int | None = None,
    points: int = 61,
) -> "Figure":
    """Draw the energy and the wrench of a hinge over its displacement.

    The coordinates of the plots are the rotation and the transverse displacement of frame
    b relative to frame a, in the axes of frame a. The plots are blank outside the
    validity range of the energy.

    Args:
        energy: The energy of a hinge, or the hinge.
        rotation: Largest rotation in both directions; rad. By default the limit of the
            validity range, or 0.5 rad if the energy has none.
        transverse: Largest displacement along axis 2 in both directions; m. By default
            the displacement at which the linearized hinge stores the same energy as at
            the largest rotation.
        axial: Displacement along axis 1; m. By default the hinge is free along axis 1,
            and the displacement minimizes the energy.
        points: Number of grid points in each direction.

    Returns:
        A figure with the energy, the moment, the transverse force, and the axial
        displacement. If `axial` is given, the axial force replaces the last of them.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: `energy` is not an energy; or `transverse` is missing and the energy
            has no stiffness in the reference configuration.

    Example:
        >>> from twistorjax import Material
        >>> from twistorjax.flexures import leaf
        >>> aluminum = Material(modulus=69e9, poisson=0.33)
        >>> spring = leaf(aluminum, length=0.01, thickness=1e-3, width=5e-3)
        >>> figure = draw_energy(spring)
        >>> for axes in figure.axes[:4]:
        ...     print(axes.get_title())
        energy (mJ)
        moment (N m)
        transverse force (N)
        axial displacement (µm)
    """
    energy = energy.energy if isinstance(energy, Hinge) else energy
    require_instance("energy", energy, AbstractEnergy)
    if rotation is None:
        limited = isinstance(energy, WithValidityRange)
        rotation = float(energy.rotation) if limited else _ROTATION
    if transverse is None:
        rotational, _, translational = np.diagonal(np.asarray(energy.tangent_stiffness()))
        if not (rotational > 0 and translational > 0):
            raise ValueError(
                "The range of transverse displacements cannot be chosen, because the "
                "energy has no stiffness in the reference configuration. Give "
                "`transverse`, in meters."
            )
        transverse = rotation * float(np.sqrt(rotational / translational))
    rotations = jnp.linspace(-rotation, rotation, points)
    shifts = jnp.linspace(-transverse, transverse, points)
    grid = jnp.stack(jnp.meshgrid(rotations, shifts, indexing="ij"), -1).reshape(-1, 2)
    given = jnp.zeros(0) if axial is None else jnp.array([axial])
    values = _evaluate(energy, grid, given)
    values = np.where(np.isfinite(values).all(axis=1, keepdims=True), values, np.nan)
    # Rounding errors are not drawn.
    force = np.nanmax(np.abs(values[:, 2:4]), initial=0.0)
    sizes = np.array([0.0, 0.0, force, force, transverse])
    values = np.where(np.abs(values) < 1e-12 * sizes, 0.0, values)
    values = values.reshape(points, points, -1)

    figure, panels = subplots(2, 2, size=(8.4, 6.8), sharex=True, sharey=True)
    # Name, unit, and column in `values` of each plot.
    plots = [("energy", "J", 0), ("moment", "N m", 1), ("transverse force", "N", 3)]
    if axial is None:
        plots.append(("axial displacement", "m", 4))
    else:
        plots.append(("axial force", "N", 2))
    factor, unit = prefixed_unit("m", transverse)
    for axes, (name, si_unit, column) in zip(panels.flat, plots, strict=True):
        _draw_contours(
            axes, rotations, factor * shifts, values[..., column], name, si_unit
        )
        axes.label_outer()
    for axes in panels[-1]:
        axes.set_xlabel("rotation (rad)")
    for axes in panels[:, 0]:
        axes.set_ylabel(f"transverse displacement ({unit})")
    if isinstance(energy, WithValidityRange):
        figure.suptitle(
            f"valid up to {float(energy.rotation):.3g} rad and "
            f"{float(energy.force):.3g} N",
            fontsize="medium",
        )
    return figure


def _draw_contours(
    axes: "Axes",
    rotations: Array,
    shifts: Array,
    values: np.ndarray,
    name: str,
    unit: str,
) -> None:
    """Draw contours of a quantity.

    The values are in SI units, the rotations in rad, and the transverse displacements
    `shifts` in units of the axes.
    """
    from matplotlib.ticker import MaxNLocator

    largest = float(np.nanmax(np.abs(values))) if np.any(np.isfinite(values)) else 1.0
    factor, unit = prefixed_unit(unit, largest)
    values = factor * values.T
    signed = bool(np.nanmin(values, initial=0) < -1e-9 * factor * largest)
    low, high = (-factor * largest if signed else 0.0), factor * largest or 1.0
    levels = MaxNLocator(20, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
    x, y = np.asarray(rotations), np.asarray(shifts)
    color_map = "RdBu_r" if signed else "cividis"
    colors = axes.contourf(x, y, values, levels, cmap=color_map)
    axes.contour(x, y, values, levels[::2], colors=BLACK, linewidths=0.4)
    axes.set_title(f"{name} ({unit})", fontsize="medium")
    axes.figure.colorbar(colors, ax=axes)


@jax.jit
def _evaluate(
    energy: AbstractEnergy, grid: Float[Array, "poses 2"], axial: Float[Array, " given"]
) -> Float[Array, "poses 5"]:
    """Compute energy, wrench, and axial displacement at the points of a grid.

    A point is a rotation (rad) and a transverse displacement (m). If the array `axial` is
    empty, the axial displacement minimizes the energy. A row of the result holds energy
    (J), moment (N m), axial and transverse force (N), and axial displacement (m). It is
    NaN outside the validity range.
    """

    def at_point(point: Float[Array, "2"]) -> Float[Array, "5"]:
        rotation, transverse = point

        def stored_energy(x: Scalar) -> Scalar:
            pose = jnp.stack([rotation, x, transverse])
            return energy.stored_energy(Displacement.from_pose(pose))

        def newton_step(_, x: Scalar) -> Scalar:
            slope, stiffness = jax.jvp(jax.grad(stored_energy), (x,), (jnp.ones(()),))
            convex = stiffness > 0
            step = jnp.where(convex, slope / jnp.where(convex, stiffness, 1.0), 0.0)
            return x - step

        if axial.size:
            x = axial[0]
        else:
            x = jax.lax.fori_loop(0, _NEWTON_STEPS, newton_step, jnp.zeros(()))
        pose = jnp.stack([rotation, x, transverse])
        return jnp.concatenate([energy(pose)[None], energy.wrench(pose), x[None]])

    return jax.vmap(at_point)(grid)
