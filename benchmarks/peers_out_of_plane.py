"""Stiffness and frequencies out of the plane, by the beams in space of EXUDYN.

All leaves have the same sizes. EXUDYN divides each leaf into geometrically exact beams,
whose theory shares no code with twistorjax. They have the bending, torsional, and shear
stiffness of the same cross-section, but no restraint of warping, which is therefore left
out in twistorjax, too. Each element has constant strains, so that shear does not lock it,
and the error falls with the square of the number of elements.

EXUDYN also contains what the theory of twistorjax leaves out: the stress in the bent
leaf. It increases the stiffness along z of the guide by 0.13 % at a stroke of 2 mm, and
by 0.43 % at 4 mm, a tenth of the length; and that of the pivot against tilts by 0.32 % at
0.2 rad. The approximate shape of the energy `leaf` decreases the stiffness of the guide
by 0.04 % and 0.32 %, so that these rows miss their bound at 4 mm; the shape of
`ExactBeam` is exact. The last rows of the guide compare with leaves that have the bent
shape in EXUDYN, but no stress.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

import twistorjax as tj

from .measure import at_most, Row


STEEL = tj.Material(modulus=210e9, poisson=0.3, density=7800.0)
LENGTH, THICKNESS, WIDTH = 40e-3, 0.3e-3, 10e-3  # of all leaves; m
LEAF = tj.flexures.leaf(STEEL, length=LENGTH, thickness=THICKNESS, width=WIDTH)
# Elements of a leaf, for stiffness and for frequencies. The errors of compliances are
# 0.02 % with 64 elements and 0.005 % with 128 at rest, and 0.05 % and 0.01 % in the bent
# guide; those of frequencies are 0.2 % with 16 elements and 0.05 % with 32.
ELEMENTS, ELEMENTS_OF_MODES = 128, 32
LOAD_STEPS = 8
# Small force along z and moments about x and y. A third of them is close to the tolerance
# of Newton's method; with ten times as much, displacements of the third order are 0.3 %;
# N, N m.
LOADS = 0.3, 3e-3, 3e-3
# x and y of opposite corners of the bodies of the folded guide; m
CORNERS = {
    "bar": np.array([[40e-3, -30e-3], [52e-3, 30e-3]]),
    "table": np.array([[-20e-3, -14e-3], [0.0, 14e-3]]),
}

NUMBERS = {"y": 1, "angle": 5}  # of coordinates in EXUDYN
Stroke = tuple[str, float]  # A coordinate of the table, and its displacement; m or rad


class Shape(NamedTuple):
    """Planar poses of the bodies, and of the ends of the elements of all leaves."""

    bodies: np.ndarray  # rad, m, m
    leaves: np.ndarray  # rad, m, m


class Peer(NamedTuple):
    """A system of EXUDYN before its assembly, and the numbers of its nodes."""

    system: Any
    bodies: list[int]  # without the wall
    leaves: list[list[int]]


def table_on(
    leaves: Sequence[tuple[float, float, float]], x: float, y: float, energy: Any = LEAF
) -> tj.Mechanism:
    """Create a table with the origin x, y (m) on leaves (rad, m, m) of a wall."""
    bodies = [tj.Body("wall"), tj.Body("table", (0.0, x, y))]
    hinges = [
        tj.Hinge(f"leaf {k}", "wall", "table", energy, at=at)
        for k, at in enumerate(leaves)
    ]
    return tj.Mechanism(bodies, hinges, fixed=["wall"])


def guide(energy: Any = LEAF) -> tj.Mechanism:
    """Create two parallel leaves. The origin of the table is in the middle of them."""
    middle = LENGTH / 2
    return table_on([(0.0, middle, -0.02), (0.0, middle, 0.02)], middle, 0.0, energy)


def folded_guide() -> tj.Mechanism:
    """Create two pairs of leaves in series, between bodies that are cut from a plate."""
    bodies = [tj.Body("wall")]
    for name, (low, high) in CORNERS.items():
        outline = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        bodies.append(tj.plate(name, outline, width=WIDTH, material=STEEL))
    outer, inner = ("wall", "bar", 0.0), ("bar", "table", np.pi)
    hinges = [
        tj.Hinge(f"leaf at {y} m", first, second, LEAF, at=(angle, LENGTH / 2, y))
        for (first, second, angle), distance in ((outer, 25e-3), (inner, 10e-3))
        for y in (-distance, distance)
    ]
    return tj.Mechanism(bodies, hinges, fixed=["wall"])


def reference(mechanism: tj.Mechanism, elements: int) -> Shape:
    """Return the shape of a mechanism whose leaves are straight."""
    angle, x, y = np.asarray(mechanism.at).T[..., None]
    along = LENGTH * np.linspace(-0.5, 0.5, elements + 1)
    ends = x + np.cos(angle) * along, y + np.sin(angle) * along
    leaves = np.stack([angle + 0 * along, *ends], axis=-1)
    return Shape(np.asarray(mechanism.reference), leaves)


def section() -> Any:
    """Create the cross-section of the leaves, of which axis z is out of the plane."""
    import exudyn as exu

    shear_modulus, poisson = float(STEEL.shear_modulus), 0.3
    area, odd = THICKNESS * WIDTH, np.arange(1, 200, 2)
    shear = 10 * (1 + poisson) / (12 + 11 * poisson) * shear_modulus * area
    series = np.sum(np.tanh(odd * np.pi * WIDTH / (2 * THICKNESS)) / odd**5)
    factor = 1 - 192 / np.pi**5 * THICKNESS / WIDTH * series
    torsion = shear_modulus * WIDTH * THICKNESS**3 / 3 * factor
    axial = float(STEEL.modulus) * area
    bending = axial / 12 * np.array([WIDTH, THICKNESS]) ** 2
    found = exu.BeamSection()
    found.stiffnessMatrix = np.diag([axial, shear, shear, torsion, *bending])
    return found


def frame(pose: np.ndarray) -> Any:
    """Return a planar pose as a frame of EXUDYN in space; rad, m, m."""
    import exudyn as exu

    angle, x, y = pose.tolist()
    return exu.HT(Rxyz=[0.0, 0.0, angle], translation=[x, y, 0.0])


def exudyn_system(mechanism: tj.Mechanism, shape: Shape) -> Peer:
    """Build a mechanism in EXUDYN from rigid bodies, massless beams, and rigid joints.

    The first body is the wall. The leaves have no stress in the given shape.
    """
    import exudyn as exu
    from exudyn import itemInterface as items
    from exudyn.rigidBodyUtilities import InertiaCuboid

    system, of_leaf = exu.SystemContainer().AddSystem(), section()

    def node(pose: np.ndarray) -> Any:
        coordinates = frame(pose).GetCoordinatesRxyz()
        return system.AddNode(items.NodeRigidBodyRxyz(referenceCoordinates=coordinates))

    bodies, nodes = [system.AddObject(items.ObjectGround())], []
    for name, pose in zip(mechanism.names[1:], shape.bodies[1:], strict=True):
        # The inertia is of no importance for the stiffness.
        sides = np.diff(CORNERS[name], axis=0)[0].tolist()
        cuboid = InertiaCuboid(float(STEEL.density), [*sides, WIDTH])
        nodes.append(node(pose))
        body = items.ObjectRigidBody(
            mass=cuboid.mass, inertia=cuboid.GetInertia6D(), nodeNumber=nodes[-1]
        )
        bodies.append(system.AddObject(body))
    leaves = []
    for ends, poses in zip(mechanism.hinge_assembly.ends, shape.leaves, strict=True):
        leaves.append([node(pose) for pose in poses])
        for pair in zip(leaves[-1][:-1], leaves[-1][1:], strict=True):
            beam = items.Beam3D(nodeNumbers=list(pair), sectionData=of_leaf)
            beam.length = LENGTH / (len(poses) - 1)
            system.AddObject(beam)
        for row, end in zip(ends, (0, -1), strict=True):
            on_body = frame(shape.bodies[row]).Inverse() @ frame(poses[end])
            markers = (
                items.MarkerBodyRigid(bodyNumber=bodies[row], localHT=on_body),
                items.MarkerNodeRigid(nodeNumber=leaves[-1][end]),
            )
            joined = [system.AddMarker(marker) for marker in markers]
            system.AddObject(items.GenericJoint(markerNumbers=joined))
    return Peer(system, nodes, leaves)


def exudyn_settings() -> Any:
    """Return the settings of the static solver."""
    import exudyn as exu

    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse
    settings.staticSolver.verboseMode = 0
    # With 128 elements, round-off errors prevent residuals below 1e-7 N.
    settings.staticSolver.newton.relativeTolerance = 1e-6
    settings.staticSolver.newton.absoluteTolerance = 1e-6
    return settings


def assemble(peer: Peer, stroke: Stroke | None) -> None:
    """Assemble a system, and move its table in the plane by a constraint, in steps."""
    from exudyn import itemInterface as items

    system, table = peer.system, peer.bodies[-1]
    if stroke is None:
        system.Assemble()
        return
    coordinate, travel = stroke
    ends = (system.AddNode(items.NodePointGround()), 0), (table, NUMBERS[coordinate])
    markers = [
        system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=number))
        for node, number in ends
    ]
    drive = system.AddObject(items.ObjectConnectorCoordinate(markerNumbers=markers))
    system.Assemble()
    for offset in np.linspace(0, travel, LOAD_STEPS + 1)[1:]:
        system.SetObjectParameter(drive, "offset", offset)
        system.SolveStatic(exudyn_settings(), updateInitialValues=True)


def exudyn_compliance(
    mechanism: tj.Mechanism, stroke: Stroke | None = None, shape: Shape | None = None
) -> tuple[np.ndarray, Shape]:
    """Compute the compliance of the table after a stroke, by small loads in EXUDYN.

    The leaves have no stress in the given shape; by default they are straight.

    Returns:
        z and the rotations about x and y for unit loads (m/N, rad/N, rad/(N m)), and the
        shape after the stroke.
    """
    import exudyn as exu
    from exudyn import itemInterface as items

    shape = reference(mechanism, ELEMENTS) if shape is None else shape
    peer = exudyn_system(mechanism, shape)
    system, bodies, leaves = peer
    table = system.AddMarker(items.MarkerNodeRigid(nodeNumber=bodies[-1]))
    force, moment = (
        system.AddLoad(load(markerNumber=table, loadVector=[0.0, 0.0, 0.0]))
        for load in (items.Force, items.Torque)
    )
    assemble(peer, stroke)

    def coordinates(node: int) -> np.ndarray:
        kind = exu.OutputVariableType.CoordinatesTotal
        return np.asarray(system.GetNodeOutput(node, kind))

    in_plane = np.array([5, 0, 1])
    moved = Shape(
        np.array([shape.bodies[0], *(coordinates(node)[in_plane] for node in bodies)]),
        np.array([[coordinates(node)[in_plane] for node in leaf] for leaf in leaves]),
    )
    columns = []
    for along_z, about_x, about_y in np.diag(LOADS).tolist():
        system.SetLoadParameter(force, "loadVector", [0.0, 0.0, along_z])
        system.SetLoadParameter(moment, "loadVector", [about_x, about_y, 0.0])
        system.SolveStatic(exudyn_settings())
        columns.append(coordinates(bodies[-1])[2:5])
    return np.column_stack(columns) / LOADS, moved


def exudyn_frequencies() -> np.ndarray:
    """Compute the lowest frequencies of the folded guide; Hz.

    EXUDYN eliminates the joints. The leaves have no mass, so that only the stiffness is
    positive definite, and the eigenvalues are the inverse ones.
    """
    from scipy.linalg import eigh

    mechanism = folded_guide()
    system, _, _ = exudyn_system(mechanism, reference(mechanism, ELEMENTS_OF_MODES))
    system.Assemble()
    mass, stiffness, *_ = system.ComputeLinearizedSystem(
        projectIntoConstraintNullspace=True
    )
    inverse_squares = eigh(mass, stiffness, eigvals_only=True)[::-1]
    return 1 / (2 * np.pi * np.sqrt(inverse_squares[:5]))


def compliance(mechanism: tj.Mechanism, stroke: Stroke | None = None) -> np.ndarray:
    """Compute the compliance of the table out of the plane by twistorjax."""
    state = None
    if stroke is not None:
        drive = tj.Drive("table", **dict([stroke]))
        state = tj.equilibrium(mechanism, drives=[drive])
    model = tj.out_of_plane(mechanism, state, warping=False)
    columns = [
        model.response({"table": (z, x, y)}).displacement("table")
        for z, x, y in np.eye(3).tolist()
    ]
    return np.column_stack(columns)


def differences(
    what: str, found: np.ndarray, peer: np.ndarray, bound: float = 0.005
) -> Iterator[Row]:
    """Yield the largest differences of the stiffness of a table by two compliances."""
    free = np.abs(np.diagonal(peer) / np.diagonal(found) - 1)
    held = abs(np.linalg.inv(found)[0, 0] / np.linalg.inv(peer)[0, 0] - 1)
    for name, error in (
        ("along z, free to tilt", free[0]),
        ("along z, without tilts", held),
        ("against tilts", max(free[1:])),
    ):
        title = f"EXUDYN: {what}: stiffness {name}: relative difference"
        yield at_most(title, float(error), "", bound)


def rows_of_cantilever() -> Iterator[Row]:
    """Yield the rows of a leaf with a force along z or a torque at its end."""
    cantilever = table_on([(0.0, LENGTH / 2, 0.0)], LENGTH, 0.0)
    found, (peer, _) = compliance(cantilever), exudyn_compliance(cantilever)
    entries = {"deflection by a force": (0, 0), "rotation by a force": (2, 0)}
    for name, at in {**entries, "twist by a torque": (1, 1)}.items():
        title = f"EXUDYN: cantilever: {name}: relative difference"
        yield at_most(title, float(abs(found[at] / peer[at] - 1)), "", 0.005)


def rows_of_guide() -> Iterator[Row]:
    """Yield the rows of the guide at strokes up to a tenth of the length."""
    for travel in (0.0, 2e-3, 4e-3):
        stroke = ("y", travel) if travel else None
        peer, bent = exudyn_compliance(guide(), stroke)
        what = f"leaf guide at {1e3 * travel:g} mm"
        yield from differences(what, compliance(guide(), stroke), peer)
    beam = tj.flexures.Beam(STEEL, length=LENGTH, thickness=THICKNESS, width=WIDTH)
    exact = compliance(guide(tj.flexures.ExactBeam(beam)), stroke)
    yield from differences(f"{what}, exact shape", exact, peer)
    relaxed, _ = exudyn_compliance(guide(), shape=bent)
    yield from differences(f"{what}, exact shape, no stress", exact, relaxed, 0.001)


def run() -> Iterator[Row]:
    """Yield the rows of the table; there are none if EXUDYN is not installed."""
    try:
        import exudyn
    except ImportError:
        return
    del exudyn
    yield from rows_of_cantilever()
    yield from rows_of_guide()
    pivot = table_on([(np.pi / 4, 0.0, 0.0), (-np.pi / 4, 0.0, 0.0)], 0.0, 0.0)
    for turn in (0.0, 0.2):
        stroke = ("angle", turn) if turn else None
        peer, _ = exudyn_compliance(pivot, stroke)
        what = f"cross-spring pivot at {turn:g} rad"
        yield from differences(what, compliance(pivot, stroke), peer)
    folded = folded_guide()
    outside = tj.out_of_plane(folded, warping=False).vibrations(3).frequencies
    lowest = np.concatenate([tj.vibrations(folded, modes=2).frequencies, outside])
    for row, (found, peer) in enumerate(zip(lowest, exudyn_frequencies(), strict=True)):
        where = "in the plane" if row < 2 else "out of the plane"
        title = f"EXUDYN: folded guide: {peer:.1f} Hz {where}: relative difference"
        yield at_most(title, float(abs(found / peer - 1)), "", 0.01)
