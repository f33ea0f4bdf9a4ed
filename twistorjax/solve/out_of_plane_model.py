"""Linear model of displacements out of the plane: stiffness, sag, and vibrations."""

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
from .._utils.host import all_concrete, concrete
from .._utils.types import (
    FrequenciesLike,
    NumberLike,
    OutOfPlaneForceLike,
    Pose,
    PoseLike,
    Poses,
    Scalar,
)
from .._utils.validation import (
    index_of,
    listing,
    require_array,
    require_finite,
    require_interval,
    require_pose,
    require_row,
)
from ..assembly.scatter import hinge_dofs
from ..results.codes import finish, RESULTS
from ..results.tables import cells, Column, Columns, columns, Tabular
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
from .state_space import require_named, StateSpace
from .vibration_results import OutOfPlaneVibrations


# Smaller eigenvalues of a stiffness with ones on its diagonal may be rounding errors.
_SINGULAR = 1e-12
_FORCES = "force along z", "moment about axis 1", "moment about axis 2"

# Force along z, and moments about x and y, on bodies by name; N, N m, N m
LoadsOutOfPlane = TypeAliasType("LoadsOutOfPlane", Mapping[str, OutOfPlaneForceLike])
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
            numbers = " ".join(cells(row))
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
            >>> tj.out_of_plane(cantilever).response({"table": (1.0, 0.0, 0.0)})
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
        require_named("inputs", inputs)
        require_named("outputs", outputs)
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
            >>> tj.out_of_plane(guide).constraint_analysis()
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
        dofs = hinge_dofs(self.ends, tuple(range(len(rows)))).T
        dense = np.zeros((len(rows), 3, 3 * len(self.names)))
        np.put_along_axis(dense, np.repeat(dofs[:, None], 3, axis=1), rows, axis=2)
        names = self.names, self.hinge_names
        hinges = HingeStiffness(
            dense,
            stiffness,
            _FORCES,
            COORDINATES,
            rotations=(False, True, True),
            # of a leaf with the same stiffness along z and against bending
            lengths=np.sqrt(12 * stiffness[:, 2, 2] / stiffness[:, 0, 0]),
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

    def require_support(self) -> None:
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
