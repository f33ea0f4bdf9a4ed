"""Small displacements of a mechanism out of its plane, about an equilibrium in it."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._compile.compilation import fast_compile
from .._utils.host import as_float
from .._utils.progress import announced
from .._utils.types import (
    MatrixLike,
    NumberLike,
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
    require_float64,
    require_names,
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
from .equations.out_of_plane import (
    compliance_of_port,
)
from .equilibrium import inner_displacements
from .out_of_plane_model import OutOfPlane
from .port_compliance import port_compliance
from .statics.solution import StateLike


# Stiffness of hinges by name: a matrix (N/m, N/rad, N m/rad), or the parts of the hinge
HingesOutOfPlane = TypeAliasType(
    "HingesOutOfPlane", Mapping[str, MatrixLike | SubMechanism]
)


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
    require_names("`fixed`", fixed)
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
    model.require_support()
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
    # The hinges of a lattice are not looked at one by one.
    assembly, outlines, found = mechanism.hinge_assembly, mechanism.hinge_outlines, {}
    for group in assembly.groups:
        if isinstance(getattr(group.energy, "part", None), SubMechanism):
            for row in group.members:
                energy: Any = assembly.energy_of(row)
                found[row] = energy.part
    for rows, outline in zip(outlines.members, outlines.values, strict=True):
        if isinstance(outline, SubMechanism):
            found.update({row: outlines[row] for row in rows})
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
            f"`hinges[{name!r}]`",
            each,
            (3, 3),
            "be a matrix with rows for z and two rotations",
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
