"""State-space model of a mechanism about an equilibrium, for control design."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float
from typing_extensions import TypeAliasType

from .._compile.compilation import fast_compile
from .._utils.progress import announced
from .._utils.types import FrequenciesLike, NumberLike, PoseLike, Poses
from .._utils.validation import index_of, require_package
from ..linalg.elimination import inverse
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ..mechanism.mechanism import COORDINATES, Mechanism
from ..mechanism.misfits import stroke_rows
from ..results.codes import RESULTS, Solution
from .equations.consistency import consistent
from .equations.dofs import DofPartition
from .equations.modes import natural_modes, static_rest, subspace_layout
from .equations.problem import Problem
from .equations.system import System
from .frequency_response import Excitation
from .statics.solution import StateLike


if TYPE_CHECKING:
    import scipy.signal


# A load, a prescribed displacement, or strokes of actuators by the names of their hinges
InputLike = TypeAliasType("InputLike", Load | Drive | Mapping[str, PoseLike])
# A body and one of its coordinates: "angle", "x", or "y"
OutputLike = TypeAliasType("OutputLike", Sequence[str])


class StateSpace(Solution):
    """Linear model `x' = A x + B u`, `y = C x + D u` of small motions of a mechanism.

    The states are the coordinates of the modes, and their rates. If an input prescribes
    displacements or has a viscous force, multiples of the input are subtracted from the
    states, so that its time derivatives do not enter. The outputs are changes of
    displacements from the equilibrium.

    Args:
        a: The matrix A; 1/s.
        b: The matrix B.
        c: The matrix C.
        d: The matrix D. It contains the static response of the modes that were left out.
        result: `RESULTS.successful` or the reason of the failure.
        inputs: Names of the inputs.
        outputs: Names of the outputs.
    """

    a: Float[Array, "*batch states states"]
    b: Float[Array, "*batch states inputs"]
    c: Float[Array, "*batch outputs states"]
    d: Float[Array, "*batch outputs inputs"]
    result: RESULTS
    inputs: tuple[str, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    _plural: ClassVar[str] = "state-space models"

    @property
    def static_gain(self) -> Float[Array, "outputs inputs"]:
        """Ratios of outputs and inputs in equilibrium."""
        return self.d - self.c @ jnp.linalg.solve(self.a, self.b)

    def frequency_response(
        self, frequencies: FrequenciesLike
    ) -> Complex[Array, "frequencies outputs inputs"]:
        """Compute the complex ratios of outputs and inputs.

        Args:
            frequencies: Frequencies, or one; Hz.

        Returns:
            A matrix for each frequency.
        """
        omega = 2 * jnp.pi * jnp.atleast_1d(jnp.asarray(frequencies, float))
        omega = omega[:, None, None]
        count = len(self.a) // 2
        # The first half of the states are coordinates, with A = [0, I; -W, -D], and the
        # outputs depend on coordinates only.
        stiffness, damping = -self.a[count:, :count], -self.a[count:, count:]
        by_rate, by_value = self.b[:count], self.b[count:]
        squares = stiffness[None] - omega**2 * jnp.eye(count)[None]
        matrices = jax.lax.complex(squares, omega * damping[None])
        real = jnp.broadcast_to(
            by_value + damping @ by_rate, (len(omega), *by_rate.shape)
        )
        right = jax.lax.complex(real, omega * by_rate[None])
        coordinates = jnp.sum(inverse(matrices)[..., None] * right[:, None], axis=2)
        response = self.c[:, :count].astype(complex) @ coordinates
        return response + self.d[None].astype(complex)

    def to_scipy(self) -> "scipy.signal.StateSpace":
        """Convert the model to that of SciPy.

        Returns:
            The model.
        """
        from scipy.signal import StateSpace as SciPyModel

        return SciPyModel(*map(np.asarray, (self.a, self.b, self.c, self.d)))

    def to_control(self) -> Any:
        """Convert the model to that of the package python-control.

        Returns:
            The model, with the names of inputs and outputs.

        Raises:
            ImportError: python-control is not installed.
        """
        package = require_package("control", "Models for python-control", "control")
        matrices = map(np.asarray, (self.a, self.b, self.c, self.d))
        inputs, outputs = list(self.inputs), list(self.outputs)
        return package.ss(*matrices, inputs=inputs, outputs=outputs)

    def __repr__(self) -> str:
        return (
            f"StateSpace of {self.a.shape[-1]} states, inputs "
            f"({', '.join(self.inputs)}), outputs ({', '.join(self.outputs)})"
        )


@announced("state space")
def state_space(
    mechanism: Mechanism,
    inputs: Mapping[str, InputLike],
    outputs: Mapping[str, OutputLike],
    *,
    modes: int | None = None,
    prescribed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    about: StateLike | None = None,
    loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    time: NumberLike = 0.0,
    throw: bool = True,
) -> StateSpace:
    """Create the state-space model of small motions about an equilibrium.

    The model is in modal form. If only some modes are kept, the matrix D contains the
    static response of the others, so that the static gain is exact. The damping of modes
    that are left out is neglected, an error in proportion to the frequency. The inertia
    due to prescribed displacements and the damping of strokes are included.

    Args:
        mechanism: The mechanism. Bodies that can move need mass and inertia, and the
            origin of their frame at the center of mass. Hinges may be damped.
        inputs: Inputs by name: loads, prescribed displacements, or strokes of actuators
            by the names of their hinges. The value 1 of an input is what is given here.
        outputs: Outputs by name: a body and one of its coordinates "angle", "x", and
            "y".
        modes: Number of modes that are kept, from the lowest frequency; by default all.
        prescribed: Coordinates that do not move, besides those of the inputs: names of
            bodies, or a mapping from names to some of "angle", "x", "y".
        about: The equilibrium, or its poses; by default the reference configuration;
            rad, m, m.
        loads: Constant loads that act at this equilibrium, but no follower loads.
        constraints: Pins, sliders, and other constraints between the bodies. They must be
            satisfied at the equilibrium.
        time: Time at which time-dependent constraints are evaluated; s.
        throw: Whether a failure raises an error; otherwise it is reported by `result`.

    Returns:
        The model, which is differentiable unless natural frequencies are equal.

    Raises:
        ValueError: Double precision is disabled, there are no inputs or outputs, a name
            is unknown, a body that moves has no mass, a load is a follower load, `modes`
            is invalid, the state is not an equilibrium under the loads, or the
            constraints are not independent or not satisfied.
        RuntimeError: A value is not finite.

    Source:
        Craig and Kurdila, Fundamentals of structural dynamics, 2006, chapter 11: mode
        acceleration method.

    Example:
        >>> import twistorjax as tj
        >>> spring = tj.Quadratic(jnp.diag(jnp.array([1.0, 400.0, 100.0])))
        >>> hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> block = tj.Body("block", mass=1.0, inertia=0.1)
        >>> mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
        >>> push = tj.Load("block", force=(1.0, 0.0))
        >>> model = state_space(mechanism, {"force": push}, {"x": ("block", "x")})
        >>> model
        StateSpace of 6 states, inputs (force), outputs (x)
        >>> model.static_gain  # 1 N over 400 N/m
        Array([[0.0025]], dtype=float64)
    """
    require_named("inputs", inputs)
    require_named("outputs", outputs)
    held = mechanism.dofs_of("prescribed", prescribed)
    for name, given in inputs.items():
        if isinstance(given, Load | Drive):
            index_of(f"The input {name!r}", "body", given.body, mechanism.names)
    moved = {
        name: dict(zip(*prescribed_dofs(mechanism, [given]), strict=True))
        for name, given in inputs.items()
        if isinstance(given, Drive)
    }
    held = sorted({*held, *(dof for row in moved.values() for dof in row)})
    problem = Problem.of(mechanism, loads, (), constraints, time, held=held)
    problem.loads.require_potential("`frequency_response`, or `simulate` the motion")
    dofs, count = problem.dofs, problem.mode_count(modes)
    columns = [
        _excitation(mechanism, name, given, dofs, moved.get(name, {}))
        for name, given in inputs.items()
    ]
    rows = tuple(_output_dof(mechanism, name, given) for name, given in outputs.items())
    state = problem.state(about)
    names = tuple(inputs), tuple(outputs)
    model = _state_space(mechanism, problem.system, columns, rows, count, state, names)
    return problem.finish(model, throw, state)


def require_named(name: str, given: Any) -> None:
    """Require a mapping of inputs or outputs by their names."""
    if not isinstance(given, Mapping) or not given:
        raise ValueError(
            f"`{name}` is {given!r}, but must be a mapping from names to {name}, "
            "with at least one entry."
        )


def _excitation(
    mechanism: Mechanism,
    name: str,
    given: Any,
    dofs: DofPartition,
    moved: Mapping[int, Any],
) -> Excitation:
    """Arrange an input, which is a load, a drive, or a mapping of strokes."""
    strokes = None
    if isinstance(given, Mapping):
        strokes = stroke_rows(mechanism.hinge_names, given)
    elif not isinstance(given, Load | Drive):
        raise ValueError(
            f"The input {name!r} is a {type(given).__name__}, but must be a `Load`, "
            "a `Drive`, or a mapping from names of hinges to strokes."
        )
    elif isinstance(given, Load) and given.follower:
        raise ValueError(
            f"The input {name!r} is a follower load. Give a load of constant "
            "direction; for small motions, the effect of its rotation is of second "
            "order."
        )
    loads = [given] if isinstance(given, Load) else []
    prescribed = tuple(moved.get(dof, 0.0) for dof in dofs.prescribed)
    return Excitation(LoadSet.of(mechanism, loads), prescribed, strokes)


def _output_dof(mechanism: Mechanism, name: str, given: Sequence[str]) -> int:
    if isinstance(given, str) or len(given) != 2:
        raise ValueError(
            f"The output {name!r} is {given!r}, but must be the name of a body and of a "
            'coordinate, such as ("table", "x").'
        )
    where = f"The output {name!r}"
    body = index_of(where, "body", given[0], mechanism.names)
    return 3 * body + index_of(where, "coordinate", given[1], COORDINATES)


@fast_compile
def _state_space(
    mechanism: Mechanism,
    system: System,
    columns: list[Excitation],
    rows: tuple[int, ...],
    modes: int,
    displacements: Poses,
    names: tuple[tuple[str, ...], tuple[str, ...]],
) -> StateSpace:
    """Create the model; see `state_space`.

    With the displacements `q = S y + (S g + r) u` of all degrees of freedom, where S are
    the modes, r the displacements that the inputs prescribe, and g the inertia of r, the
    coordinates y of the modes satisfy `y'' + D y' + W y = k u + h u'`.
    """
    free, size = system.free, system.dofs.total
    every = len(free) - system.constraints.size
    few = modes < every and subspace_layout(system, modes) is not None
    natural = natural_modes(mechanism, system, displacements, modes if few else every)
    angular, shapes, _ = natural
    modal = jnp.zeros((size, shapes.shape[1])).at[free].set(shapes)
    stiffness, jacobian = system.whole_stiffness(displacements)
    tangent = system.hinges.tangent_in_motion(
        displacements, jnp.zeros_like(displacements), tuple(range(size))
    )
    inertia = mechanism.inertia().reshape(-1)
    inertia = jnp.where(jnp.isinf(inertia), 0.0, inertia)
    excitations = [column.at(system, jacobian, displacements) for column in columns]
    forces, viscous, moved = (
        jnp.stack(parts, axis=1) for parts in zip(*excitations, strict=True)
    )
    squares = jnp.abs(angular) * angular
    damping = modal.T @ tangent.damping @ modal
    by_inertia = -modal.T @ (inertia[:, None] * moved)
    at_rest = forces - stiffness @ moved
    by_value = modal.T @ at_rest
    by_rate = modal.T @ (viscous - tangent.damping @ moved)
    statics = by_value / squares[:, None]  # response of each mode
    by_value = by_value - squares[:, None] * by_inertia
    by_rate = by_rate - damping @ by_inertia
    kept = slice(modes)
    by_value, by_rate, damping = by_value[kept], by_rate[kept], damping[kept, kept]
    by_value = by_value - damping @ by_rate
    zero, identity = jnp.zeros((modes, modes)), jnp.eye(modes)
    a = jnp.block([[zero, identity], [-jnp.diag(squares[kept]), -damping]])
    b = jnp.concatenate([by_rate, by_value])
    seen = modal[np.array(rows)]
    c = jnp.concatenate([seen[:, kept], jnp.zeros((len(rows), modes))], axis=1)
    d = moved[np.array(rows)] + seen[:, kept] @ by_inertia[kept]
    if few:
        rest = static_rest(mechanism, system, displacements, natural, at_rest[free])
        d = d + jnp.zeros_like(at_rest).at[free].set(rest)[np.array(rows)]
    elif modes < every:
        d = d + seen[:, modes:] @ statics[modes:]
    finite = (
        jnp.all(jnp.isfinite(a)) & jnp.all(jnp.isfinite(b)) & jnp.all(jnp.isfinite(d))
    )
    result = RESULTS.where(finite, RESULTS.successful, RESULTS.not_finite)
    is_consistent = consistent(system, displacements)
    result = RESULTS.where(is_consistent, result, RESULTS.inconsistent_constraints)
    inputs, outputs = names
    return StateSpace(a=a, b=b, c=c, d=d, result=result, inputs=inputs, outputs=outputs)
