"""The energy of a hinge and its wrench, as landscapes over its displacement."""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Scalar
from .._utils.validation import require_kind
from ..energies.base import AbstractEnergy
from ..energies.validity import WithValidityRange
from ..geometry.twistors import Displacement
from ..mechanism.hinge import Hinge
from .canvas import readable, subplots


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_TURN = 0.5  # rad
_NEWTON = 30  # steps along the axis


def draw_energy(
    energy: AbstractEnergy | Hinge,
    *,
    turn: float | int | None = None,
    across: float | int | None = None,
    along: float | int | None = None,
    points: int = 61,
) -> "Figure":
    """Draws what a hinge stores and bears, by its turn and its translation across.

    Frame b is seen from frame a: turned, and moved along the axes of a. What lies beyond
    the range of the energy is left white.

    Args:
        energy: of a hinge, or the hinge.
        turn: the largest drawn, either way, by default that of the range; rad.
        across: the largest translation along axis 2, either way, by default as much as
            stores what the largest turn does; m.
        along: the translation along axis 1; by default the hinge is free along it, and
            takes the one that stores least; m.
        points: of the grid, each way.

    Returns:
        A figure: energy, moment and transverse force, and the travel along the axis, or,
        where that is given, the axial force.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: `energy` is none; it has no stiffness at rest from which `across`
            could follow.

    Example:
        >>> from twistorjax import Material
        >>> from twistorjax.flexures import leaf
        >>> blade = leaf(Material(69e9, 0.33), length=0.01, thickness=1e-3, width=5e-3)
        >>> figure = draw_energy(blade)
        >>> [panel.get_title() for panel in figure.axes[:4]]
        ['energy (mJ)', 'moment (N m)', 'transverse force (N)', 'travel along (µm)']
    """
    energy = energy.energy if isinstance(energy, Hinge) else energy
    require_kind("energy", [energy], AbstractEnergy)
    if turn is None:
        turn = float(energy.turn) if isinstance(energy, WithValidityRange) else _TURN
    if across is None:
        rotation, _, transverse = np.diagonal(np.asarray(energy.tangent_stiffness()))
        if not (rotation > 0 and transverse > 0):
            raise ValueError(
                "The energy has no stiffness at rest, from which the range of its "
                "translation could follow: give `across`, in metres."
            )
        across = turn * float(np.sqrt(rotation / transverse))
    turns = jnp.linspace(-turn, turn, points)
    shifts = jnp.linspace(-across, across, points)
    grid = jnp.stack(jnp.meshgrid(turns, shifts, indexing="ij"), -1).reshape(-1, 2)
    told = _told(energy, grid, jnp.zeros(0) if along is None else jnp.array([along]))
    told = np.where(np.isfinite(told).all(axis=1, keepdims=True), told, np.nan)
    told = told.reshape(points, points, -1)

    figure, panels = subplots(2, 2, size=(8.4, 6.8), sharex=True, sharey=True)
    last = ("travel along", "m") if along is None else ("axial force", "N")
    wanted = {
        ("energy", "J"): 0,
        ("moment", "N m"): 1,
        ("transverse force", "N"): 3,
        last: 4 if along is None else 2,
    }
    factor, unit = readable("m", across)
    for axes, ((name, kind), column) in zip(panels.flat, wanted.items(), strict=True):
        _panel(axes, turns, factor * shifts, told[..., column], name, kind)
        axes.label_outer()
    for axes in panels[-1]:
        axes.set_xlabel("turn (rad)")
    for axes in panels[:, 0]:
        axes.set_ylabel(f"translation across ({unit})")
    if isinstance(energy, WithValidityRange):
        figure.suptitle(
            f"known up to {float(energy.turn):.3g} rad and {float(energy.force):.3g} N",
            fontsize="medium",
        )
    return figure


def _panel(
    axes: "Axes", turns: Array, shifts: Array, values: np.ndarray, name: str, unit: str
) -> None:
    from matplotlib.ticker import MaxNLocator

    largest = float(np.nanmax(np.abs(values))) if np.any(np.isfinite(values)) else 1.0
    factor, unit = readable(unit, largest)
    values = factor * values.T
    signed = bool(np.nanmin(values, initial=0) < -1e-9 * factor * largest)
    low, high = (-factor * largest if signed else 0.0), factor * largest or 1.0
    levels = MaxNLocator(20, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
    colors = axes.contourf(
        np.asarray(turns), np.asarray(shifts), values, levels,
        cmap="RdBu_r" if signed else "cividis",
    )  # fmt: skip
    axes.contour(
        np.asarray(turns), np.asarray(shifts), values, levels[::2], colors="#202020",
        linewidths=0.4,
    )  # fmt: skip
    axes.set_title(f"{name} ({unit})", fontsize="medium")
    axes.figure.colorbar(colors, ax=axes)


@jax.jit
def _told(
    energy: AbstractEnergy, grid: Float[Array, "poses 2"], along: Float[Array, " given"]
) -> Float[Array, "poses 5"]:
    """Energy, wrench, and translation along axis 1; NaN beyond the range."""

    def one(place: Float[Array, "2"]) -> Float[Array, "5"]:
        turned, across = place

        def stored_energy(x: Scalar) -> Scalar:
            pose = jnp.stack([turned, x, across])
            return energy.stored_energy(Displacement.of(pose))

        def nearer(_, x: Scalar) -> Scalar:
            slope, bend = jax.jvp(jax.grad(stored_energy), (x,), (jnp.ones(()),))
            return x - jnp.where(bend > 0, slope / jnp.where(bend > 0, bend, 1.0), 0.0)

        x = jnp.zeros(())
        x = along[0] if along.size else jax.lax.fori_loop(0, _NEWTON, nearer, x)
        pose = jnp.stack([turned, x, across])
        return jnp.concatenate([energy(pose)[None], energy.wrench(pose), x[None]])

    return jax.vmap(one)(grid)
