"""The four-bar linkages with several models of their hinges: pins, quadratics, and beams.

Section 5.4 of the dissertation discusses pseudo-rigid-body models, in which pins with
torsional springs replace the hinges, as an alternative to its quadratic energies. Here
both linkages of `four_bar` are computed with both of them, with surrogates of beams, and
exact beams, the reference, under the same rotation of link 2. A notch is too short for
the uniform stress that a beam assumes. Finite elements are more accurate: the axial
stiffness of the formula that was fitted to them, which the quadratic energies use, is a
third smaller than that of the beam; see `flexures.notch`.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._utils.progress import announced
from .._utils.types import NumberLike, Pose, Scalar
from .._utils.validation import require_choice
from ..energies.base import AbstractEnergy
from ..energies.quadratic import Quadratic
from ..flexures import Beam, ExactBeam, notch_profile, surrogate
from ..mechanism.body import Body
from ..mechanism.constraints import Pin
from ..mechanism.hinge import Hinge
from ..mechanism.loads import Drive
from ..mechanism.material import Material
from ..mechanism.mechanism import Mechanism
from ..plotting.figure_style import BLACK, BLUE, GRAY, GREEN, RED, subplots
from ..results.codes import result_names
from ..solve.equilibrium import equilibrium
from .four_bar import four_bar, Hinges


if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Rotations of link 2 up to the largest one of equation 5.26; rad
ROTATIONS = tuple(0.1 * np.pi * k / 9 for k in range(1, 10))

_EXACT, _MATCHED = "exact beam", "pseudo-rigid-body, matched"
_WIDTH, _LENGTH, _THICKNESS = 5e-3, 10e-3, 1e-3  # of the plate and short leaves; m
_HOLE, _WEB = 8e-3, 0.5e-3  # of the notches; m
_RADIUS, _SPRING = 0.8517, 2.65  # of a fixed-guided segment; Howell (2001)

# The line of the exact beams is wide, so that it is visible below other lines.
_STYLES = {
    "pseudo-rigid-body": {"color": RED, "linestyle": "--"},
    _MATCHED: {"color": GREEN, "linestyle": "-."},
    "quadratic": {"color": BLUE, "linestyle": ":", "linewidth": 2},
    "surrogate": {"color": BLACK, "linestyle": (0, (6, 4)), "zorder": 3},
    _EXACT: {"color": GRAY, "linewidth": 3.5, "alpha": 0.6},
}


class LinkageModel(NamedTuple):
    """A linkage, and the pins between its bodies.

    Args:
        mechanism: The linkage. If hinge A has two pins, the body "A" is between them.
        pins: The pins of a pseudo-rigid-body model; empty for other models.
    """

    mechanism: Mechanism
    pins: tuple[Pin, ...] = ()


def four_bar_models(
    hinges: Hinges = "identical", models: Sequence[str] | None = None
) -> dict[str, LinkageModel]:
    """Build a four-bar linkage with several models of its hinges.

    * "pseudo-rigid-body": A short leaf is a pin in its middle with a torsional spring of
      the stiffness EI/L, and a notch is a pin with the fitted rotational stiffness. The
      long leaf of the second linkage is two pins at the distance `0.8517 L` with springs
      of the stiffness `2 * 0.8517 * 2.65 EI/L`. These are the constants of a leaf whose
      ends remain parallel. This leaf rotates with link 2 instead, and in a rotation both
      springs together are 2.26 times as stiff as the leaf.
    * "pseudo-rigid-body, matched": The two pins have the distance `L / sqrt(3)` and
      springs of the stiffness `2 EI/L`. For small displacements, their compliance in
      rotation and in the transverse direction is that of the leaf without shear.
    * "quadratic": The energies of `four_bar`, in the coordinates of the twistor.
    * "surrogate": Surrogates of the exact beams, for rotations up to 0.4 rad.
    * "exact beam": Geometrically exact beams with shear.

    Args:
        hinges: "identical" for four identical leaves (section 5.2), "leaves-and-notches"
            for two leaves and two notches (section 5.3).
        models: Names of the models; by default all, for identical leaves without
            "pseudo-rigid-body, matched", which is the same as "pseudo-rigid-body".

    Returns:
        The linkages by the names of the models.

    Raises:
        ValueError: `hinges` or the name of a model is unknown.

    Source:
        Section 5.4 and figures 5.7 to 5.9 of the dissertation. Howell, Compliant
        Mechanisms, Wiley 2001, chapter 5: small-length flexural pivots, and the
        fixed-guided segment.

    Example:
        >>> models = four_bar_models("leaves-and-notches", ["pseudo-rigid-body"])
        >>> [pin.name for pin in models["pseudo-rigid-body"].pins]
        ['lower A', 'upper A', 'B', 'C', 'D']
    """
    build = {
        "pseudo-rigid-body": lambda: _on_pins(hinges, _RADIUS, 2 * _RADIUS * _SPRING),
        _MATCHED: lambda: _on_pins(hinges, 1 / np.sqrt(3), 2.0),
        "quadratic": lambda: LinkageModel(four_bar(hinges, damping=None)),
        "surrogate": lambda: _of_beams(hinges, partial(surrogate, rotation=0.4, order=6)),
        _EXACT: lambda: _of_beams(hinges, ExactBeam),
    }
    if models is None:
        models = [m for m in build if m != _MATCHED or hinges != "identical"]
    for name in models:
        require_choice("`models`", name, tuple(build))
    return {name: build[name]() for name in models}


def _of_beams(hinges: Hinges, energy: Callable[[Beam], AbstractEnergy]) -> LinkageModel:
    """Build a linkage whose hinges have energies of beams."""
    short, long, neck = (_LENGTH, _THICKNESS), (2 * _LENGTH, _THICKNESS), (_HOLE, _WEB)
    sizes = {"A": short, "B": short, "C": short, "D": short}
    if hinges != "identical":
        sizes = {"A": long, "B": neck, "C": neck, "D": short}
    made = {size: energy(_beam(*size, size == neck)) for size in {*sizes.values()}}
    # Each hinge has its own arrays, and the functions and orders of all are the same, so
    # that both linkages share a compiled program.
    energies = {name: jax.tree.map(jnp.copy, made[size]) for name, size in sizes.items()}
    return LinkageModel(four_bar(hinges, damping=None, energies=energies))


def _beam(length: float, thickness: float, notched: bool) -> Beam:
    """Create a leaf or a notch (m). The integration has an error of at most 4e-6."""
    neck = notch_profile(hole=length, web=thickness)
    profile = jax.tree_util.Partial(_thickness, neck, jnp.array(float(notched)))
    soft = Material(modulus=69e9 / 20, poisson=0.3)  # as in `four_bar`
    return Beam(soft, length=length, thickness=profile, width=_WIDTH, steps=24)


def _thickness(neck: jax.tree_util.Partial, share: Scalar, position: Scalar) -> Scalar:
    """Compute the thickness (m) of a notch, share 1, or of a leaf, share 0."""
    middle = neck(jnp.zeros(()))
    return middle + share * (neck(position) - middle)


def _on_pins(hinges: Hinges, distance: float, factor: float) -> LinkageModel:
    """Build a linkage of pins with torsional springs.

    The long leaf has two pins at a distance over L, and with a stiffness over EI/L.
    """
    linkage = four_bar(hinges, damping=None)
    bodies = [
        Body(name, linkage.reference[k], outline=linkage.outlines[k])
        for k, name in enumerate(linkage.names)
    ]
    springs, pins = [], []

    def add(name: str, first: str, second: str, stiffness: NumberLike, at: Pose) -> None:
        energy = Quadratic(np.diag([1.0, 0.0, 0.0]) * stiffness, "twist")
        springs.append(Hinge(name, first, second, energy, at))
        pins.append(Pin(name, first, second, at[1:]))

    for k, name in enumerate(linkage.hinge_names):
        first, second = (linkage.names[n] for n in linkage.hinge_assembly.ends[k])
        energy, at = linkage.hinge_assembly.energy_of(k), linkage.at[k]
        assert isinstance(energy, Quadratic)
        stiffness = energy.stiffness[0, 0]  # EI/L of a leaf, or fitted for a notch
        if name == "A" and hinges != "identical":
            half = np.array([0.0, 0.0, distance * _LENGTH])  # the leaf is vertical
            bodies.append(Body("A", at))
            add("lower A", first, "A", factor * stiffness, at - half)
            add("upper A", "A", second, factor * stiffness, at + half)
        else:
            add(name, first, second, stiffness, at)
    return LinkageModel(Mechanism(bodies, springs, fixed=["1"]), tuple(pins))


class Comparison(eqx.Module):
    """Static responses of models of a linkage to the same rotations of link 2.

    Args:
        rotations: Rotations of link 2; rad.
        models: Names of the models.
        displacements: Displacements (angle, x, y) of link 3; rad, m, m.
        torques: Moments that rotate link 2; N m.
        energies: Energies stored in the hinges; J.
        results: "successful" or the name of the reason of a failure.
    """

    rotations: Float[np.ndarray, " rotations"]
    models: tuple[str, ...] = eqx.field(static=True)
    displacements: Float[np.ndarray, "models rotations 3"]
    torques: Float[np.ndarray, "models rotations"]
    energies: Float[np.ndarray, "models rotations"]
    results: np.ndarray

    def differences(self) -> Float[np.ndarray, "models rotations 4"]:
        """Compute the differences of all models from "exact beam", which must be there.

        Returns:
            Difference of the rotation of link 3, magnitude of the difference of its
            displacement, and relative differences of torque and energy; rad, m, -, -.
        """
        row = self.models.index(_EXACT)
        motion = self.displacements - self.displacements[row]
        distance = np.linalg.norm(motion[..., 1:], axis=-1)
        torque = self.torques / self.torques[row] - 1
        energy = self.energies / self.energies[row] - 1
        return np.stack([motion[..., 0], distance, torque, energy], axis=-1)


@announced("equilibria of the models")
def compare(
    models: Mapping[str, LinkageModel], rotations: Sequence[float] = ROTATIONS
) -> Comparison:
    """Compute the static responses of several models to the same rotations of link 2.

    Link 2 can translate. Each solve starts at the equilibrium of the previous rotation.

    Args:
        models: The models by name, such as `four_bar_models` returns them.
        rotations: Rotations of link 2, positive and increasing; rad.

    Returns:
        The responses. A model that fails at a rotation is NaN from there on.

    Raises:
        ValueError: The rotations are not positive and increasing.

    Source:
        Section 5.4 of the dissertation, with the rotations of equation 5.26.

    Example:
        >>> models = four_bar_models("identical", ["pseudo-rigid-body"])
        >>> compare(models, [0.1, 0.2]).torques  # of four springs of 0.14375 N m/rad
        array([[0.0575, 0.115 ]])
    """
    if not (len(rotations) and np.all(np.diff([0.0, *rotations]) > 0)):
        raise ValueError(
            f"`rotations` is {rotations!r}, but must be positive and increasing; rad."
        )
    rows = []
    for mechanism, pins in models.values():
        solution = None
        for rotation in rotations:
            solution = equilibrium(
                mechanism,
                drives=[Drive("2", angle=rotation)],
                constraints=pins,
                start=solution,
                throw=False,
            )
            values = solution.displacement("3"), solution.reaction("2")[0]
            rows.append((*values, solution.energy, result_names(solution.result)))
    columns = (
        np.stack(column).reshape(len(models), len(rotations), *np.shape(column[0]))
        for column in zip(*rows, strict=True)
    )
    return Comparison(np.asarray(rotations), tuple(models), *columns)


def plot(comparisons: Mapping[str, Comparison]) -> "Figure":
    """Draw torques on link 2 and motions of link 3 over the rotation of link 2.

    Args:
        comparisons: Comparisons of models, by the titles of their panels.

    Returns:
        A figure with a row of panels for each comparison.
    """
    rows = len(comparisons)
    figure, panels = subplots(rows, 4, size=(15, 3 * rows + 0.5), squeeze=False)
    for (title, comparison), row in zip(comparisons.items(), panels, strict=True):
        degrees, differences = np.degrees(comparison.rotations), comparison.differences()
        for k, name in enumerate(comparison.models):
            style = _STYLES.get(name, {})
            angle = np.degrees(comparison.displacements[k, :, 0])
            row[0].plot(degrees, 1e3 * comparison.torques[k], label=name, **style)
            row[2].plot(degrees, angle, **style)
            if name != _EXACT:
                row[1].plot(degrees, 100 * differences[k, :, 2], **style)
                row[3].semilogy(degrees, 1e3 * differences[k, :, 1], **style)
        row[0].set(ylabel="torque on link 2 (N mm)")
        row[1].set(ylabel="difference of torque (%)")
        row[2].set(ylabel="rotation of link 3 (degrees)")
        row[3].set(ylabel="difference of displacement (mm)")
        row[0].set_title(title, loc="left")
    for axes in panels.flat:
        axes.grid(alpha=0.3)
    figure.supxlabel("rotation of link 2 (degrees)", fontsize="medium")
    lines = max((axes.lines for axes in panels[:, 0]), key=len)
    figure.legend(handles=lines, loc="outside upper center", ncols=5)
    return figure
