"""The truss of von Mises: two bars that snap through, with closed-form loads.

Two equal bars connect two supports with an apex above the line between them. Under a
force on the apex the bars are compressed, until the truss snaps to the other side of the
line (von Mises, Ueber die Stabilitaetsprobleme der Elastizitaetstheorie, ZAMM 3, 1923).
"""

from typing import NamedTuple, TYPE_CHECKING

import jax.numpy as jnp

from .._utils.host import on_host
from .._utils.progress import announced
from .._utils.types import NumberLike, Scalar
from .._utils.validation import require_interval, require_positive
from ..energies.axial_spring import AxialSpring
from ..mechanism.body import Body
from ..mechanism.hinge import Hinge
from ..mechanism.loads import Load
from ..mechanism.mechanism import Mechanism
from ..plotting.path_plots import draw_path
from ..solve.bistability import Bistability, bistability
from ..solve.continuation.solution import Path
from ..solve.path import path


if TYPE_CHECKING:
    from matplotlib.figure import Figure


_RATIOS = 0.02, 1000.0  # of the rise and half of the span, for `study`


def von_mises_truss(
    rise: NumberLike = 0.3, half_span: NumberLike = 1.0, stiffness: NumberLike = 1000.0
) -> Mechanism:
    """Build the truss. Its apex can move, but not rotate.

    Args:
        rise: Height of the apex above the supports; m.
        half_span: Half of the distance of the supports; m.
        stiffness: Axial stiffness of each bar; N/m.

    Returns:
        The truss, with the bodies "wall" and "apex" and the hinges "left" and "right".

    Raises:
        ValueError: An argument is not positive.

    Example:
        >>> von_mises_truss().hinge_names
        ('left', 'right')
    """
    rise = require_positive("`rise`", rise)
    half_span = require_positive("`half_span`", half_span)
    xp, (rise, half_span) = on_host(rise, half_span)
    bar = AxialSpring(stiffness, length=xp.hypot(rise, half_span))
    angle, middle = xp.arctan2(rise, half_span), half_span / 2
    return Mechanism(
        bodies=[Body("wall"), Body("apex", pose=(0.0, 0.0, rise))],
        hinges=[
            Hinge("left", "wall", "apex", bar, at=(angle, -middle, rise / 2)),
            Hinge("right", "apex", "wall", bar, at=(-angle, middle, rise / 2)),
        ],
        fixed={"wall": ["angle", "x", "y"], "apex": ["angle"]},
    )


def limit_load(
    rise: NumberLike = 0.3, half_span: NumberLike = 1.0, stiffness: NumberLike = 1000.0
) -> Scalar:
    """Compute the force on the apex at the limit point, in closed form.

    A truss whose apex does not move to a side snaps there.

    With the length L of the bars, half of the span a, and the stiffness k, the force at
    the height h is `2 k h (L / sqrt(a^2 + h^2) - 1)`. It is largest at
    `h = sqrt((a^2 L)^(2/3) - a^2) = a sqrt(e)`, where it is `2 k a e^(3/2)`, with
    `e = (L / a)^(2/3) - 1`.

    Args:
        rise: Height of the apex above the supports; m.
        half_span: Half of the distance of the supports; m.
        stiffness: Axial stiffness of each bar; N/m.

    Returns:
        The force; N.

    Example:
        >>> limit_load()
        Array(9.94991696, dtype=float64)
    """
    rise, half_span = jnp.asarray(rise, float), jnp.asarray(half_span, float)
    stretch = jnp.expm1(jnp.log1p((rise / half_span) ** 2) / 3)
    return 2 * jnp.asarray(stiffness, float) * half_span * stretch**1.5


class TrussStudy(NamedTuple):
    """Path and stable states of a truss.

    Args:
        path: The path under a downward force on the apex.
        states: Its stable states.
        force: Force at the load factor 1; N.
        closed_form: Force at the limit point, in closed form; N.
    """

    path: Path
    states: Bistability
    force: Scalar
    closed_form: Scalar

    def record(self) -> dict[str, float | bool | str]:
        """Return the results as numbers: snap forces (N), barrier (J), and travel (m).

        A high truss becomes unstable at a branch point, before the limit point.
        """
        forth, back = (float(self.force * factor) for factor in self.states.snap_factors)
        return {
            "snap_force_N": forth,
            "becomes_unstable_at": "branch" if self.states.at_branch[0] else "limit",
            "limit_force_in_closed_form_N": float(self.closed_form),
            "snap_back_force_N": back,
            "bistable": bool(self.states.is_bistable),
            "energy_barrier_J": float(self.states.barriers[0]),
            "travel_m": float(self.states.travel("apex")[2]),
            "points": len(self.path.load_factors),
        }

    def __str__(self) -> str:
        record = self.record()
        branch = record["becomes_unstable_at"] == "branch"
        side = ", where the apex moves to a side" if branch else ""
        bound = ", at most" if branch else ""
        return "\n".join(
            [
                f"snap force          {record['snap_force_N']:.9g} N{side}",
                f"limit force         {record['limit_force_in_closed_form_N']:.9g} N "
                "in closed form",
                f"force to snap back  {record['snap_back_force_N']:.9g} N",
                f"energy barrier      {record['energy_barrier_J']:.6g} J{bound}",
                f"travel of the apex  {record['travel_m']:.6g} m",
                f"equilibria          {record['points']}",
            ]
        )


@announced("paths of the truss")
def study(
    rise: NumberLike = 0.3, half_span: NumberLike = 1.0, stiffness: NumberLike = 1000.0
) -> TrussStudy:
    """Follow the path of a truss from one stable state to the other one and beyond.

    Args:
        rise: Height of the apex above the supports; m.
        half_span: Half of the distance of the supports; m.
        stiffness: Axial stiffness of each bar; N/m.

    Returns:
        The path, and the stable states.

    Raises:
        ValueError: An argument is not positive, or the rise is not between 0.02 and 1000
            times half of the span. For other trusses, rounding errors are larger than
            the forces at which they snap through or move to a side.
        RuntimeError: The path or a stable state is not found.

    Example:
        >>> print(study())
        snap force          9.94991696 N
        limit force         9.94991696 N in closed form
        force to snap back  -9.94991696 N
        energy barrier      1.9387 J
        travel of the apex  -0.6 m
        equilibria          63
    """
    truss = von_mises_truss(rise, half_span, stiffness)
    _, (rise, half_span) = on_host(rise, half_span)
    low, high = _RATIOS
    requirement = f"must be between {low:g} and {high:g}"
    tolerance = 1e-12  # The quotient of rounded numbers may exceed a limit.
    require_interval(
        "`rise / half_span`",
        rise / half_span,
        low * (1 - tolerance),
        high * (1 + tolerance),
        requirement,
    )
    snap_force = limit_load(rise, half_span, stiffness)
    loads = [Load("apex", force=(0.0, -2 * snap_force))]
    return TrussStudy(
        path=path(truss, loads=loads),
        states=bistability(truss, loads=loads),
        force=2 * snap_force,
        closed_form=snap_force,
    )


def plot(found: TrussStudy) -> "Figure":
    """Draw the force over the displacement of the apex.

    Args:
        found: Result of `study`.

    Returns:
        The figure.

    Raises:
        ImportError: Matplotlib is not installed.

    Example:
        >>> figure = plot(study())
    """
    label = "downward force on the apex (N)"
    return draw_path(found.path, "apex", "y", load=float(found.force), load_label=label)
