"""Small displacements of a mechanism out of its plane, about an equilibrium in it."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Inexact
from typing_extensions import TypeAliasType

from .._compile.compilation import fast_compile
from .._utils.host import all_concrete, as_float, concrete
from .._utils.progress import announced
from .._utils.types import (
    FrequenciesLike,
    MatrixLike,
    NumberLike,
    OutOfPlaneForceLike,
    Pose,
    PoseLike,
    Poses,
    PosesOrResult,
    Scalar,
)
from .._utils.validation import (
    index_of,
    listing,
    require_array,
    require_finite,
    require_float64,
    require_interval,
    require_pose,
    require_row,
)
from ..assembly.assembly import HingeAssembly
from ..assembly.out_of_plane import (
    assembled_stiffness,
    Given,
    hinge_stiffness,
    hinges_without_stiffness,
    member_stiffness,
)
from ..geometry import se2
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Load
from ..mechanism.mechanism import Mechanism
from ..mechanism.sub_mechanism import SubMechanism
from ..results.codes import finish, RESULTS
from ..results.tables import Column, Columns, columns, Tabular
from .equations.mobility import analyze_hinges, ConstraintAnalysis, HingeStiffness
from .equations.out_of_plane import (
    amplitudes,
    compliance_of_port,
    COORDINATES,
    displacements,
    normal_modes,
    state_space_matrices,
)
from .equations.problem import mode_count
from .equilibrium import inner_displacements
from .port_compliance import port_compliance
from .state_space import StateSpace
from .statics.solution import StateLike
from .vibration_results import OutOfPlaneVibrations


# Smaller eigenvalues of a stiffness with ones on its diagonal may be rounding errors.
_SINGULAR = 1e-12
_FORCES = "force along z", "moment about axis 1", "moment about axis 2"

# Force along z, and moments about x and y, on bodies by name; N, N m, N m
LoadsOutOfPlane = TypeAliasType("LoadsOutOfPlane", Mapping[str, OutOfPlaneForceLike])
# Stiffness of hinges by name: a matrix (N/m, N/rad, N m/rad), or the parts of the hinge
HingesOutOfPlane = TypeAliasType(
    "HingesOutOfPlane", Mapping[str, MatrixLike | SubMechanism]
)
_NONE: LoadsOutOfPlane = MappingProxyType({})


class OutOfPlaneResponse(Tabular):
    """Small displacements of bodies out of the plane.

    Args:
        displacements: z and the rotations about x and y of each body, at its displaced
            origin; complex amplitudes, if there are frequencies; m, rad, rad.
        frequencies: Frequencies of the excitation; None for constant loads; Hz.
        poses: Poses of the bodies in the plane; rad, m, m.
        names: Names of the bodies.
    """

    displacements: Inexact[Array, "..."]
    frequencies: Float[Array, " frequencies"] | None
    poses: Float[Array, "*batch bodies 3"]
    names: tuple[str, ...] = eqx.field(static=True)

    def displacement(self, body: str) -> Inexact[Array, "*batch 3"]:
        """Return z and the rotations about x and y of a body.

        Args:
            body: Name of the body.

        Returns:
            Three numbers, with a row for each frequency; m, rad, rad.

        Raises:
            ValueError: There is no body of this name.
        """
        row = index_of("`body`", "body", body, self.names)
        return self.displacements[..., row, :]

    def columns(self) -> Columns:
        axes, table = ("body",), {}
        if self.frequencies is not None:
            axes = "frequency", "body"
            table["frequency"] = Column(self.frequencies, ("frequency",), "Hz")
        units = zip(COORDINATES, ("m", "rad", "rad"), strict=True)
        return {**table, **columns(self.displacements, axes, *units, body=self.names)}

    def __repr__(self) -> str:
        known = all_concrete([self.displacements])
        if known is None or known[0].ndim > 2:
            return f"displacements out of the plane of {len(self.names)} bodies"
        heads = f"{'z (m)':>13} {'about x (rad)':>13} {'about y (rad)':>13}"
        width = max(map(len, self.names))
        lines = [f"{'':<{width}} {heads}"]
        for name, row in zip(self.names, known[0], strict=True):
            numbers = " ".join(f"{value:>13.6g}" for value in row)
            lines.append(f"{name:<{width}} {numbers}")
        return "\n".join(lines)


class OutOfPlane(eqx.Module):
    """Small displacements of a mechanism out of its plane: a linear model.

    They are z and the rotations about x and y of each body, at its displaced origin; m,
    rad, rad.

    Args:
        stiffness: Forces along z (N) and moments about x and y (N m) on the bodies, for
            unit displacements.
        inertia: Mass, and moments of inertia about x and y, of each body; NaN where they
            are not given; kg, kg m^2.
        poses: Poses of the bodies in the plane; rad, m, m.
        hinge_rows: What each hinge resists: z and the rotations about axes 1 and 2 of its
            mid-frame, for unit displacements of its two bodies.
        hinge_stiffness: Stiffness of each hinge against it; N/m, N/rad, N m/rad.
        names: Names of the bodies.
        hinge_names: Names of the hinges.
        ends: Indices of the two bodies of each hinge.
        length: Length by which rotations and translations are compared; m.
        fixed: Indices of the bodies that cannot move out of the plane.
        lacking: Names of the bodies that can move but have no mass, and of those without
            `tilt_inertia`.
    """

    stiffness: Float[Array, "*batch dofs dofs"]
    inertia: Float[Array, "*batch bodies 3 3"]
    poses: Float[Array, "*batch bodies 3"]
    hinge_rows: Float[Array, "*batch hinges 3 6"]
    hinge_stiffness: Float[Array, "*batch hinges 3 3"]
    length: Scalar
    names: tuple[str, ...] = eqx.field(static=True)
    hinge_names: tuple[str, ...] = eqx.field(static=True)
    ends: tuple[tuple[int, int], ...] = eqx.field(static=True)
    fixed: tuple[int, ...] = eqx.field(static=True)
    lacking: tuple[tuple[str, ...], tuple[str, ...]] = eqx.field(static=True)

    def __repr__(self) -> str:
        fixed = listing(self.names[row] for row in self.fixed)
        return f"stiffness out of the plane of {len(self.names)} bodies; fixed: {fixed}"

    def compliance_at(
        self, body: str, at: PoseLike = (0.0, 0.0, 0.0)
    ) -> Float[Array, "*batch 3 3"]:
        """Compute the compliance at a port, a frame on a body that can move.

        Args:
            body: Name of the body.
            at: Pose of the port in the frame of its body; rad, m, m.

        Returns:
            Displacements of the port along z, and its rotations about its axes 1 and 2,
            for a unit force along z and unit moments about these axes; m/N, rad/N, rad/(N
            m). It is NaN if the stiffness is not positive definite.

        Raises:
            ValueError: There is no such body, or it cannot move.
        """
        return _compliance_at(self, self._row(body), require_pose("`at`", at))

    def stiffness_at(
        self, body: str, at: PoseLike = (0.0, 0.0, 0.0)
    ) -> Float[Array, "*batch 3 3"]:
        """Compute the stiffness at a port, the inverse of `compliance_at`.

        Args:
            body: Name of the body.
            at: Pose of the port in the frame of its body; rad, m, m.

        Returns:
            The force along z and the moments about axes 1 and 2 of the port for unit
            displacements; N/m, N/rad, N m/rad.

        Raises:
            ValueError: There is no such body, or it cannot move.
        """
        return jnp.linalg.inv(self.compliance_at(body, at))

    def response(
        self, loads: LoadsOutOfPlane = _NONE, *, gravity: NumberLike = 0.0
    ) -> OutOfPlaneResponse:
        """Compute the displacements by constant forces and moments, or the sag.

        Args:
            loads: Force along z, and moments about x and y, on bodies by name, at their
                displaced origins; N, N m, N m.
            gravity: Acceleration along z, such as -9.81, for which the bodies need
                masses; m/s^2.

        Returns:
            The displacements of all bodies.

        Raises:
            ValueError: A name is unknown, or there is gravity, but a body has no mass.

        Example:
            >>> import twistorjax as tj
            >>> steel = tj.Material(modulus=210e9, poisson=0.3)
            >>> leaf = tj.flexures.leaf(
            ...     steel, length=40e-3, thickness=0.3e-3, width=10e-3
            ... )
            >>> bodies = [tj.Body("wall"), tj.Body("table", (0.0, 0.02, 0.0))]
            >>> hinge = tj.Hinge("leaf", "wall", "table", leaf, at=(0.0, 0.0, 0.0))
            >>> cantilever = tj.Mechanism(bodies, [hinge], fixed=["wall"])
            >>> out_of_plane(cantilever).response({"table": (1.0, 0.0, 0.0)})
                          z (m) about x (rad) about y (rad)
            wall              0             0             0
            table   4.25778e-06             0  -0.000152381
        """
        acceleration = require_finite("`gravity`", gravity)
        known = concrete(acceleration)
        if known is None or known != 0:
            self._require("`mass`", self.lacking[0])
        found = _response(self, self._forces(loads), acceleration)
        return OutOfPlaneResponse(found, None, self.poses, self.names)

    def vibrations(self, modes: int | None = None) -> OutOfPlaneVibrations:
        """Compute the natural frequencies and mode shapes out of the plane.

        Damping is neglected, and hinges have no mass, as in `tj.vibrations`.

        Args:
            modes: Number of modes, from the lowest frequency; by default all.

        Returns:
            The natural frequencies (Hz) in ascending order, and the mass-normalized mode
            shapes.

        Raises:
            ValueError: A body that can move has no mass or no `tilt_inertia`, or `modes`
                is invalid.
            RuntimeError: A value is not finite.
        """
        count = self._require_inertia(modes)
        return finish(_vibrations(self, count), True)

    def frequency_response(
        self,
        frequencies: FrequenciesLike,
        loads: LoadsOutOfPlane,
        *,
        damping_ratio: NumberLike = 0.0,
    ) -> OutOfPlaneResponse:
        """Compute the response to small harmonic forces and moments.

        The damping of hinges is not known out of the plane; all modes have the same ratio
        of their damping and the critical one.

        Args:
            frequencies: Frequencies of the excitation; Hz.
            loads: Amplitudes of the loads, as in `response`; N, N m, N m.
            damping_ratio: Damping of each mode as a fraction of the critical one.

        Returns:
            The complex amplitudes, with an axis of the frequencies in front of that of
            the bodies.

        Raises:
            ValueError: A name is unknown, a body that can move has no mass or no
                `tilt_inertia`, or the ratio is negative.
            RuntimeError: A frequency is a resonance without damping.
        """
        self._require_inertia(None)
        shape = "be a list or a one-dimensional array, such as [100.0]"
        values = require_array("`frequencies`", frequencies, (None,), shape)
        ratio = _require_ratio(damping_ratio)
        found = _frequency_response(self, self._forces(loads), ratio, values)
        known = concrete(found)
        if known is not None and not np.all(np.isfinite(known)):
            raise RuntimeError(
                "At some frequency the response out of the plane is not finite: there is "
                "a resonance without damping. Give a `damping_ratio`, such as 0.01, or "
                "leave out the frequency."
            )
        return OutOfPlaneResponse(found, values, self.poses, self.names)

    def state_space(
        self,
        inputs: Mapping[str, LoadsOutOfPlane],
        outputs: Mapping[str, tuple[str, str]],
        *,
        modes: int | None = None,
        damping_ratio: NumberLike = 0.0,
    ) -> StateSpace:
        """Create the state-space model of small motions out of the plane.

        As in `tj.state_space`, the model is in modal form, and its matrix D contains the
        static response of the modes that are left out.

        Args:
            inputs: Loads by the name of the input, as in `response`. The value 1 of an
                input is what is given here.
            outputs: A body and one of its coordinates "z", "rotation_x", and
                "rotation_y", by the name of the output.
            modes: Number of modes that are kept, from the lowest frequency; by default
                all.
            damping_ratio: Damping of each mode as a fraction of the critical one.

        Returns:
            The model, which is differentiable unless natural frequencies are equal.

        Raises:
            ValueError: A name is unknown, there are no inputs or outputs, a body that can
                move has no mass or no `tilt_inertia`, or `modes` or the ratio is invalid.
        """
        for name, given in (("inputs", inputs), ("outputs", outputs)):
            if not given:
                raise ValueError(f"`{name}` is empty, but must have at least one entry.")
        count, ratio = self._require_inertia(modes), _require_ratio(damping_ratio)
        forces = jnp.stack([self._forces(loads) for loads in inputs.values()])
        rows = tuple(self._output(name, *given) for name, given in outputs.items())
        a, b, c, d = _state_space(self, forces, rows, count, ratio)
        return StateSpace(
            a=a,
            b=b,
            c=c,
            d=d,
            result=RESULTS.successful,
            inputs=tuple(inputs),
            outputs=tuple(outputs),
        )

    def constraint_analysis(self, ratio: float = 1e-3) -> ConstraintAnalysis:
        """Find motions that no stiff direction resists, and over-constraints.

        As in `tj.constraint_analysis`, the stiff directions of hinges out of the plane
        are taken as rigid, and the others as free. A leaf resists the force along z and
        the moment about axis 2, but hardly torsion.

        Args:
            ratio: Ratio of a stiffness and the largest one above which a direction is
                stiff. Rotational stiffnesses are divided by the square of the
                characteristic length.

        Returns:
            The motions and the states of self-stress, by the names of bodies and hinges.

        Raises:
            ValueError: The ratio is not between 0 and 1, the model is a batch, or a value
                is traced.

        Example:
            Two parallel leaves between two bodies are over-constrained once:

            >>> import twistorjax as tj
            >>> steel = tj.Material(modulus=210e9, poisson=0.3)
            >>> leaf = tj.flexures.leaf(
            ...     steel, length=40e-3, thickness=0.3e-3, width=10e-3
            ... )
            >>> leaves = [
            ...     tj.Hinge(name, "wall", "table", leaf, at=(0.0, 0.0, y))
            ...     for name, y in (("lower", -0.02), ("upper", 0.02))
            ... ]
            >>> bodies = [tj.Body("wall"), tj.Body("table")]
            >>> guide = tj.Mechanism(bodies, leaves, fixed=["wall"])
            >>> out_of_plane(guide).constraint_analysis()
            0 motions that no stiff direction resists, 1 over-constraint
            over-constraint: release one of moment about axis 2 of 'lower', moment about
            axis 2 of 'upper'
        """
        if not 0 < ratio < 1:
            raise ValueError(f"`ratio` is {ratio!r}, but must be between 0 and 1.")
        known = all_concrete([self.hinge_rows, self.hinge_stiffness, self.length])
        if known is None or known[0].ndim > 3:
            raise ValueError(
                "A constraint analysis needs one mechanism whose values are known, but "
                "this one is a batch, or JAX traces it."
            )
        rows, stiffness, length = known
        ends = np.array(self.ends)
        dofs = (3 * ends[:, :, None] + np.arange(3)).reshape(-1, 6)
        dense = np.zeros((len(rows), 3, 3 * len(self.names)))
        np.put_along_axis(dense, np.repeat(dofs[:, None], 3, axis=1), rows, axis=2)
        names = self.names, self.hinge_names
        hinges = HingeStiffness(
            dense, stiffness, _FORCES, COORDINATES, rotations=(False, True, True)
        )
        return analyze_hinges(*names, hinges, self._free_dofs, float(length), ratio)

    @property
    def _free(self) -> list[int]:
        """Indices of the bodies that can move out of the plane."""
        return [row for row in range(len(self.names)) if row not in self.fixed]

    @property
    def _free_dofs(self) -> np.ndarray:
        """Indices of the degrees of freedom of these bodies."""
        return np.ravel(3 * np.array(self._free)[:, None] + np.arange(3))

    def _row(self, body: str) -> int:
        """Return the index of a body that can move."""
        row = index_of("`body`", "body", body, self.names)
        if row in self.fixed:
            raise ValueError(
                f"The body {body!r} cannot move out of the plane. Choose another one of "
                f"{listing(self.names[row] for row in self._free)}."
            )
        return row

    def _output(self, name: str, body: str, coordinate: str) -> int:
        """Return the index of a coordinate of a body that can move."""
        index = index_of(f"The output {name!r}", "coordinate", coordinate, COORDINATES)
        return 3 * self._row(body) + index

    def _forces(self, loads: LoadsOutOfPlane) -> Float[Array, "bodies 3"]:
        """Arrange loads in a row for each body; N, N m, N m."""
        forces = jnp.zeros((len(self.names), 3))
        for body, given in loads.items():
            row = index_of("`loads`", "body", body, self.names)
            entries = "a force along z and moments about x and y"
            forces = forces.at[row].set(require_row(f"`loads[{body!r}]`", given, entries))
        return forces

    def _require(self, field: str, lacking: Sequence[str]) -> None:
        """Require that no body lacks a mass or moments of inertia."""
        if lacking:
            raise ValueError(
                f"{listing(lacking)} can move out of the plane, but has no {field}. "
                "Create it by `plate`, or give `Body` its `mass` and its `tilt_inertia`, "
                "or name it in `fixed`."
            )

    def _require_inertia(self, modes: int | None) -> int:
        """Require masses and moments of inertia, and return the number of modes."""
        self._require("`mass`", self.lacking[0])
        self._require("`tilt_inertia`", self.lacking[1])
        return mode_count(modes, 3 * len(self._free))

    def _require_support(self) -> None:
        """Raise an error if a body can move out of the plane without resistance."""
        known = all_concrete([self.stiffness, self.poses])
        if known is None:
            return
        free, dofs = self._free, self._free_dofs
        matrices = known[0][..., dofs[:, None], dofs].reshape(-1, dofs.size, dofs.size)
        poses = known[1].reshape(-1, *known[1].shape[-2:])
        for matrix, pose in zip(matrices, poses, strict=True):
            if not np.all(np.isfinite(pose)):
                continue  # An equilibrium was not found, which has been reported.
            if not np.all(np.isfinite(matrix)):
                rows = np.flatnonzero(~np.isfinite(np.sum(matrix, axis=1)))
                names = dict.fromkeys(self.names[free[row // 3]] for row in rows)
                raise RuntimeError(
                    f"The stiffness out of the plane of {listing(names)} is not finite: "
                    "the deformed shape of a flexure is not known at this state, or its "
                    "dimensions are not finite."
                )
            sizes = np.maximum(np.abs(np.diagonal(matrix)), np.finfo(float).tiny)
            scale = 1 / np.sqrt(sizes)
            values, vectors = np.linalg.eigh(scale[:, None] * matrix * scale[None])
            if values[0] <= _SINGULAR:
                parts = np.linalg.norm(vectors[:, 0].reshape(-1, 3), axis=1)
                rows = np.flatnonzero(parts > 0.1 * np.max(parts))
                raise RuntimeError(
                    f"{listing(self.names[free[row]] for row in rows)} can move out of "
                    "the plane without resistance. Connect it to fixed bodies by "
                    "flexures, or name it in `fixed`."
                )

    def _for_each(self, function: Callable, *values: Array) -> Any:
        """Evaluate a function of the stiffness and further values for a whole batch."""
        for _ in range(self.poses.ndim - 2):
            function = jax.vmap(function)
        dofs = self._free_dofs
        return function(self.stiffness[..., dofs[:, None], dofs], *values)

    def _of_all(self, free: Inexact[Array, "*batch free"]) -> Inexact[Array, "..."]:
        """Return displacements of all bodies from those that can move."""
        shape = (*free.shape[:-1], len(self.names), 3)
        of_free = free.reshape(*free.shape[:-1], -1, 3)
        return jnp.zeros(shape, free.dtype).at[..., np.array(self._free), :].set(of_free)


def _require_ratio(given: NumberLike) -> Scalar:
    smallest = -np.finfo(float).tiny
    requirement = "must be zero or positive, and small compared with 1"
    return require_interval("`damping_ratio`", given, smallest, 1.0, requirement)


@fast_compile
def _compliance_at(model: OutOfPlane, body: int, port: Pose) -> Array:
    compliance = partial(compliance_of_port, model._free.index(body), port)
    return model._for_each(compliance, model.poses[..., body, :])


@fast_compile
def _response(
    model: OutOfPlane, loads: Float[Array, "bodies 3"], gravity: Scalar
) -> Array:
    free = np.array(model._free)

    def respond(stiffness: Array, inertia: Array) -> Array:
        weights = jnp.where(gravity == 0, 0.0, gravity * inertia[free, 0, 0])
        forces = loads[free].at[:, 0].add(weights)
        return displacements(stiffness, forces.reshape(-1))

    return model._of_all(model._for_each(respond, model.inertia))


@fast_compile
def _vibrations(model: OutOfPlane, count: int) -> OutOfPlaneVibrations:
    free = np.array(model._free)

    def vibrate(stiffness: Array, inertia: Array, poses: Poses) -> OutOfPlaneVibrations:
        natural = normal_modes(stiffness, inertia[free])
        frequencies = natural.angular[:count] / (2 * jnp.pi)
        finite = jnp.all(jnp.isfinite(frequencies))
        return OutOfPlaneVibrations(
            frequencies=frequencies,
            shapes=model._of_all(natural.shapes.T[:count]),
            result=RESULTS.where(finite, RESULTS.successful, RESULTS.not_finite),
            names=model.names,
            poses=poses,
        )

    return model._for_each(vibrate, model.inertia, model.poses)


@fast_compile
def _frequency_response(
    model: OutOfPlane,
    loads: Float[Array, "bodies 3"],
    damping_ratio: Scalar,
    frequencies: Float[Array, " frequencies"],
) -> Array:
    free = np.array(model._free)

    def respond(stiffness: Array, inertia: Array) -> Array:
        natural = normal_modes(stiffness, inertia[free])
        forces = loads[free].reshape(-1)
        return amplitudes(natural, damping_ratio, forces, frequencies)

    return model._of_all(model._for_each(respond, model.inertia))


@fast_compile
def _state_space(
    model: OutOfPlane,
    loads: Float[Array, "inputs bodies 3"],
    rows: tuple[int, ...],
    count: int,
    damping_ratio: Scalar,
) -> tuple[Array, Array, Array, Array]:
    free = np.array(model._free)
    observed = model._of_all(jnp.eye(3 * len(free))).reshape(3 * len(free), -1)

    def matrices(stiffness: Array, inertia: Array) -> tuple[Array, ...]:
        natural = normal_modes(stiffness, inertia[free])
        forces = loads[:, free].reshape(len(loads), -1).T
        seen = observed[:, np.array(rows)].T
        return state_space_matrices(natural, damping_ratio, count, forces, seen)

    return model._for_each(matrices, model.inertia)


@announced("out-of-plane stiffness")
def out_of_plane(
    mechanism: Mechanism,
    about: PosesOrResult | None = None,
    *,
    warping: bool = True,
    hinges: HingesOutOfPlane | None = None,
    fixed: Sequence[str] = (),
) -> OutOfPlane:
    """Compute small displacements of a mechanism out of its plane.

    To first order, the displacements out of the plane of a mechanism that is symmetric
    about the middle plane of its plate are independent of those in the plane; their
    stiffness depends on the deformed state in the plane, because a force along z twists a
    bent leaf. This is why a guide loses most of its support stiffness at the end of its
    stroke. See `flexures.out_of_plane_stiffness` for the theory and its errors.

    Bodies whose three coordinates in the plane are fixed cannot move out of it either.
    All others can, also if some of their coordinates are fixed.

    Args:
        mechanism: The mechanism.
        about: Equilibrium, motion, or poses of the bodies; by default the reference
            configuration; rad, m, m.
        warping: Whether the ends of the flexures cannot warp, because they are clamped to
            thick bodies.
        hinges: Stiffness of hinges that were not created from dimensions, by their names:
            force along z and moments about axes 1 and 2 in the frame of the hinge, for
            unit displacements; N/m, N/rad, N m/rad. Or the `SubMechanism` of which the
            hinge consists; the outline of the hinge need not be repeated here. It
            replaces what follows from the dimensions.
        fixed: Further bodies that cannot move out of the plane.

    Returns:
        A linear model with the stiffness at ports, the sag under weights, vibrations, and
        the response to forces. It has an axis in front for the times of a motion or a
        batch.

    Raises:
        ValueError: Double precision is disabled, the stiffness of a hinge is not known, a
            name is unknown, or all bodies are fixed.
        RuntimeError: A body can move out of the plane without resistance, or the deformed
            shape of a flexure is not known.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> leaf = tj.flexures.leaf(steel, length=40e-3, thickness=0.3e-3, width=10e-3)
        >>> bodies = [tj.Body("wall"), tj.Body("table", (0.0, 0.04, 0.02))]
        >>> leaves = [
        ...     tj.Hinge(name, "wall", "table", leaf, at=(0.0, 0.02, y))
        ...     for name, y in (("lower", 0.0), ("upper", 0.04))
        ... ]
        >>> guide = tj.Mechanism(bodies, leaves, fixed=["wall"])
        >>> middle = 0.0, -0.02, 0.0  # of the leaves, in the frame of the table
        >>> out_of_plane(guide).stiffness_at("table", middle)[0, 0].round(-3)  # N/m
        Array(1653000., dtype=float64)
        >>> pushed = tj.equilibrium(guide, drives=[tj.Drive("table", y=4e-3)])
        >>> out_of_plane(guide, pushed).stiffness_at("table", middle)[0, 0].round(-3)
        Array(732000., dtype=float64)
    """
    require_float64(mechanism.reference)
    if unknown := hinges_not_known(mechanism, hinges):
        raise ValueError(
            f"The stiffness out of the plane of {listing(unknown)} is not known. Create "
            "the energies from dimensions, by `flexures.leaf`, `flexures.notch`, or "
            "`flexures.surrogate`, or give it in `hinges`."
        )
    given, parts = _given_and_parts(mechanism, hinges)
    held = {index_of("`fixed`", "body", name, mechanism.names) for name in fixed}
    held |= {row for row in range(len(mechanism.names)) if mechanism.is_fixed(row)}
    free = [row for row in range(len(mechanism.names)) if row not in held]
    if not free:
        raise ValueError("All bodies are fixed, so none can move out of the plane.")
    at = mechanism.reference if about is None else about
    matrix, rows, stiffness = mechanism.of_hinges(
        at, partial(_stiffness, given, parts, warping)
    )
    without_mass, without_inertia = (
        tuple(mechanism.names[row] for row in free if values.is_none()[row])
        for values in (mechanism.masses, mechanism.tilt_inertias)
    )
    poses, inertia = _poses_and_inertia(
        mechanism.displacements(at, "about"),
        mechanism.reference,
        mechanism.masses.numbers(np.nan),
        mechanism.tilt_inertias.numbers(np.nan, (2, 2)),
    )
    assembly = mechanism.hinge_assembly
    moving = tuple(3 * row for row in free)
    model = OutOfPlane(
        stiffness=matrix,
        inertia=inertia,
        poses=poses,
        hinge_rows=rows,
        hinge_stiffness=stiffness,
        length=as_float(assembly.characteristic_length(moving)),
        names=mechanism.names,
        hinge_names=mechanism.hinge_names,
        ends=assembly.ends,
        fixed=tuple(sorted(held)),
        lacking=(without_mass, without_inertia),
    )
    model._require_support()
    return model


@announced("spatial compliance")
def spatial_compliance(
    mechanism: Mechanism,
    body: str,
    at: PoseLike = (0.0, 0.0, 0.0),
    *,
    about: StateLike | None = None,
    loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    time: NumberLike = 0.0,
    warping: bool = True,
    hinges: HingesOutOfPlane | None = None,
    fixed: Sequence[str] = (),
) -> Float[Array, "6 6"]:
    """Compute the compliance at a port against forces and moments in all directions.

    It consists of the blocks of `port_compliance` in the plane and of `out_of_plane`,
    which are independent of each other for a plate that is symmetric about its middle
    plane.

    Args:
        mechanism: The mechanism.
        body: Name of the body.
        at: Pose of the port in the frame of its body; rad, m, m.
        about: Equilibrium or poses; by default the reference configuration; rad, m, m.
        loads: Loads that act at this equilibrium; see `port_compliance`.
        constraints: Constraints between the bodies in the plane.
        time: Time at which time-dependent constraints are evaluated; s.
        warping: See `out_of_plane`.
        hinges: See `out_of_plane`.
        fixed: See `out_of_plane`.

    Returns:
        Rotations about axes 1, 2, and 3 of the port, and displacements along them, for
        unit moments about these axes and unit forces along them; rad/(N m), rad/N, m/N.
        Axis 3 is z.

    Raises:
        ValueError: A name is unknown, a coordinate of the body is fixed, or the stiffness
            of a hinge out of the plane is not known.
        RuntimeError: A body can move out of the plane without resistance.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> leaf = tj.flexures.leaf(steel, length=40e-3, thickness=0.3e-3, width=10e-3)
        >>> hinge = tj.Hinge("leaf", "wall", "table", leaf, at=(0.0, 0.0, 0.0))
        >>> bodies = [tj.Body("wall"), tj.Body("table")]
        >>> cantilever = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        >>> compliance = spatial_compliance(cantilever, "table")
        >>> compliance.diagonal()[:3].round(6)  # against moments about axes 1, 2, and z
        Array([4.949757e+00, 7.619000e-03, 8.465608e+00], dtype=float64)
    """
    in_plane = port_compliance(
        mechanism, body, at, about=about, loads=loads, constraints=constraints, time=time
    )
    model = out_of_plane(mechanism, about, warping=warping, hinges=hinges, fixed=fixed)
    whole = jnp.zeros((6, 6))
    for block, found in (
        ((2, 3, 4), in_plane.compliance),
        ((5, 0, 1), model.compliance_at(body, at)),
    ):
        index = np.array(block)
        whole = whole.at[index[:, None], index].set(found)
    return whole


Parts = dict[int, SubMechanism]


def _parts_of_hinges(mechanism: Mechanism) -> Parts:
    """Return the sub-mechanisms that act as hinges, by the index of the hinge."""
    assembly, found = mechanism.hinge_assembly, {}
    for row, outline in enumerate(mechanism.hinge_outlines):
        part = outline
        if not isinstance(part, SubMechanism):
            part = getattr(assembly.energy_of(row), "part", None)
        if isinstance(part, SubMechanism):
            found[row] = part
    return found


def _given_and_parts(
    mechanism: Mechanism, hinges: HingesOutOfPlane | None
) -> tuple[dict[int, Any], Parts]:
    """Arrange the matrices and the parts of hinges by the index of the hinge."""
    parts, given = _parts_of_hinges(mechanism), {}
    for name, each in (hinges or {}).items():
        row = index_of("`hinges`", "hinge", name, mechanism.hinge_names)
        if isinstance(each, SubMechanism):
            parts[row] = each
            continue
        parts.pop(row, None)
        given[row] = require_array(
            f"`hinges[{name!r}]`", each, (3, 3), "be a matrix with three rows"
        )
    return given, parts


def hinges_not_known(
    mechanism: Mechanism, hinges: HingesOutOfPlane | None = None
) -> list[str]:
    """Return the names of hinges, or of their parts, whose stiffness is not known."""
    given, parts = _given_and_parts(mechanism, hinges)
    unknown = [
        mechanism.hinge_names[row]
        for row in hinges_without_stiffness(mechanism.hinge_assembly)
        if row not in given and row not in parts
    ]
    for part in parts.values():
        unknown += hinges_not_known(part.mechanism)
    return unknown


@fast_compile
def _stiffness(
    given: Given, parts: Parts, warping: bool, hinges: HingeAssembly, displacements: Poses
) -> tuple[Array, Array, Array]:
    """Compute the stiffness of all bodies, and what each hinge resists and how stiffly.

    Some hinges have parts.
    """
    by_parts = {}
    for row, part in parts.items():
        pose = hinges.displacement_of(row, displacements).pose()
        by_parts[row] = _stiffness_of_parts(part, pose, warping)
    known = {**given, **by_parts}
    members = member_stiffness(hinges, displacements, warping, known)
    return assembled_stiffness(hinges, members), *hinge_stiffness(hinges, members)


def _stiffness_of_parts(part: SubMechanism, pose: Pose, warping: bool) -> Array:
    """Compute the stiffness of a sub-mechanism in the mid-frame of its two ends.

    `pose` is that of frame b relative to frame a; rad, m, m.
    """
    mechanism = part.without_ranges()
    moved = inner_displacements(mechanism, part.second, pose)
    inner = _parts_of_hinges(mechanism)
    whole, _, _ = _stiffness({}, inner, warping, mechanism.hinge_assembly, moved)
    first, second = mechanism.index(part.first), mechanism.index(part.second)
    free = [row for row in range(len(mechanism.names)) if row != first]
    dofs = np.ravel(3 * np.array(free)[:, None] + np.arange(3))
    to_middle = se2.between(pose, pose / 2)
    compliance = compliance_of_port(
        free.index(second), to_middle, whole[dofs[:, None], dofs], pose
    )
    return jnp.linalg.inv(compliance)


@fast_compile
def _poses_and_inertia(
    displacements: Float[Array, "*batch bodies 3"],
    reference: Poses,
    masses: Float[Array, " bodies"],
    tilt_inertias: Float[Array, "bodies 2 2"],
) -> tuple[Array, Array]:
    """Compute poses, and masses and moments of inertia in the axes of the world."""
    poses = displacements + reference.reshape(
        *(displacements.ndim - 2) * (1,), *reference.shape
    )

    def turned(pose: Pose, mass: Scalar, tilt_inertia: Array) -> Array:
        cos, sin = jnp.cos(pose[0]), jnp.sin(pose[0])
        axes = jnp.array([[cos, -sin], [sin, cos]])
        about_axes = axes @ tilt_inertia @ axes.T
        return jnp.zeros((3, 3)).at[0, 0].set(mass).at[1:, 1:].set(about_axes)

    def of_bodies(poses: Poses) -> Array:
        return jax.vmap(turned)(poses, masses, tilt_inertias)

    for _ in range(poses.ndim - 2):
        of_bodies = jax.vmap(of_bodies)
    return poses, of_bodies(poses)
