"""Motion, statics, and modes of lattices of rotating squares, beside EXUDYN and SciPy.

Squares of 15 mm are joined at their corners. In a motion, one in the middle is pushed.
"""
# The stubs of EXUDYN contain wrong types, and only benchmarks install it.
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportCallIssue=false, reportMissingImports=false

import time
from collections.abc import Iterator
from functools import partial

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import eigsh, spsolve

import twistorjax as tj

from .measure import at_most, Row, seconds


SIDE, MASS = 15e-3, 1e-3  # m, kg
INERTIA = MASS * SIDE**2 / 6  # kg m2
STIFFNESS = np.array([1.5e-3, 1.2e5, 1.2e3])  # of a corner; N m/rad, N/m, N/m
SPEED, DURATION = 1.0, 0.02  # m/s, s
PEER_STEP = 1e-5  # s


def corners(count: int) -> Iterator[tuple[tuple[int, int], tuple[int, int], np.ndarray]]:
    """Yield both squares of each corner, and its pose; rad, m, m."""
    for i in range(count):
        for j in range(count):
            shift = 0.2 * (1 if (i + j) % 2 == 0 else -1)
            if i + 1 < count:
                yield (
                    (i, j),
                    (i + 1, j),
                    np.array([0, (i + 0.5) * SIDE, (j + shift) * SIDE]),
                )
            if j + 1 < count:
                at = [np.pi / 2, (i - shift) * SIDE, (j + 0.5) * SIDE]
                yield (i, j), (i, j + 1), np.array(at)


def lattice(count: int, stiffness: jax.Array | None = None) -> tj.Mechanism:
    """Return `count` by `count` squares between two walls, of which one may move along y.

    Args:
        stiffness: Factor of the stiffness of each corner.
    """
    squares = [(i, j) for i in range(count) for j in range(count)]
    bodies = [
        tj.Body(f"{i} {j}", (0.0, i * SIDE, j * SIDE), mass=MASS, inertia=INERTIA)
        for i, j in squares
    ]
    corner = tj.Quadratic(np.diag(STIFFNESS))
    hinges = [
        tj.Hinge(
            f"{k}",
            "{} {}".format(*first),
            "{} {}".format(*second),
            corner if stiffness is None else stiffness[k] * corner,
            at,
        )
        for k, (first, second, at) in enumerate(corners(count))
    ]
    fixed = {f"{i} 0": ["angle", "x", "y"] for i in range(count)}
    fixed |= {f"{i} {count - 1}": ["angle", "x"] for i in range(count)}
    return tj.Mechanism(bodies, hinges, fixed=fixed)


def motion(count: int, mechanism: tj.Mechanism, **settings) -> tj.Motion:
    """Simulate a lattice after a push on its middle."""
    middle = f"{count // 2} {count // 2}"
    return tj.simulate(
        mechanism,
        np.linspace(0, DURATION, 21),
        velocities={middle: (0.0, 0.0, -SPEED)},
        energies=False,
        **settings,
    )


def exudyn_motion(count: int, step: float) -> tuple[float, np.ndarray]:
    """Simulate a lattice by EXUDYN, which is sparse and implicit.

    Returns:
        The time of the simulation (s), and the positions of the squares at its end; m.
    """
    import exudyn as exu
    from exudyn import itemInterface as items

    system = exu.SystemContainer().AddSystem()
    ground = items.NodePointGround()
    wall = system.AddMarker(
        items.MarkerNodeCoordinate(nodeNumber=system.AddNode(ground), coordinate=0)
    )
    nodes, bodies = {}, {}
    for i in range(count):
        for j in range(count):
            pushed = (i, j) == (count // 2, count // 2)
            nodes[i, j] = system.AddNode(
                items.NodeRigidBody2D(
                    referenceCoordinates=[i * SIDE, j * SIDE, 0.0],
                    initialVelocities=[0.0, -SPEED if pushed else 0.0, 0.0],
                )
            )
            bodies[i, j] = system.AddObject(
                items.ObjectRigidBody2D(
                    mass=MASS, inertia=INERTIA, nodeNumber=nodes[i, j]
                )
            )
    rotation, along, across = STIFFNESS
    for first, second, (angle, x, y) in corners(count):
        markers = [
            system.AddMarker(
                items.MarkerBodyRigid(
                    bodyNumber=bodies[i, j],
                    localPosition=[x - i * SIDE, y - j * SIDE, 0],
                )
            )
            for i, j in (first, second)
        ]
        cos, sin = np.cos(angle), np.sin(angle)
        axes = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        system.AddObject(
            items.ObjectConnectorRigidBodySpringDamper(
                markerNumbers=markers,
                stiffness=np.diag([along, across, 0, 0, 0, rotation]),
                rotationMarker0=axes,
                rotationMarker1=axes,
            )
        )
    for i in range(count):
        for j, coordinates in ((0, (0, 1, 2)), (count - 1, (0, 2))):
            for coordinate in coordinates:
                marker = items.MarkerNodeCoordinate(
                    nodeNumber=nodes[i, j], coordinate=coordinate
                )
                held = [wall, system.AddMarker(marker)]
                system.AddObject(items.ObjectConnectorCoordinate(markerNumbers=held))
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.solutionSettings.writeSolutionToFile = False
    settings.linearSolverType = exu.LinearSolverType.EigenSparse
    settings.timeIntegration.endTime = DURATION
    settings.timeIntegration.numberOfSteps = round(DURATION / step)
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.timeIntegration.generalizedAlpha.spectralRadius = 1.0
    start = time.perf_counter()
    assert exu.MainSolverImplicitSecondOrder().SolveSystem(system, settings)
    elapsed = time.perf_counter() - start
    position = exu.OutputVariableType.Position
    ends = [system.GetNodeOutput(node, position)[:2] for node in nodes.values()]
    return elapsed, np.array(ends)


def run() -> Iterator[Row]:
    """Yield the rows of the table."""
    per_body = {}
    for count in (10, 20, 40):
        name = f"lattice of {count} x {count} squares"
        mechanism = lattice(count)
        start = time.perf_counter()
        jax.block_until_ready(motion(count, mechanism).displacements)
        yield Row(f"{name}: first motion", time.perf_counter() - start, "s")
        elapsed = seconds(motion, count, mechanism, repeats=5)
        found = motion(count, mechanism)
        yield Row(f"{name}: motion for 20 ms", elapsed, "s")
        per_body[count] = elapsed / int(found.steps) / count**2
        of_peer, positions = exudyn_motion(count, PEER_STEP)
        yield Row(f"EXUDYN: {name}: motion for 20 ms", of_peer, "s")
        what = f"{name}: time over that of EXUDYN"
        yield at_most(what, elapsed / of_peer, "x", 0.5)
        if count == 40:
            continue
        exact = motion(count, mechanism, solver=dfx.Tsit5(), tolerance=1e-10)
        largest = np.max(np.abs(exact.displacements[-1, :, 1:]))

        def error(positions: np.ndarray, exact=exact, largest=largest) -> float:
            return float(np.max(np.abs(positions - exact.poses[-1, :, 1:])) / largest)

        yield Row(
            f"{name}: relative error at the end", error(found.poses[-1, :, 1:]), "1"
        )
        yield Row(f"EXUDYN: {name}: relative error at the end", error(positions), "1")
        implicit = partial(motion, solver=tj.solve.Radau(), tolerance=1e-3)
        elapsed = seconds(implicit, count, mechanism, repeats=3)
        yield Row(f"{name}: motion for 20 ms, Radau, tolerance 1e-3", elapsed, "s")
    what = "lattices: time per step and body, 40 x 40 over 10 x 10"
    yield at_most(what, per_body[40] / per_body[10], "x", 2.0)
    factors = jnp.ones(180)

    def end(factors: jax.Array) -> jax.Array:
        return motion(10, lattice(10, factors)).displacements[-1, 55, 2]

    once = seconds(end, factors, repeats=3)
    ratio = seconds(jax.grad(end), factors, repeats=3) / once
    what = "lattice of 10 x 10 squares: gradient by 180 stiffnesses, over the motion"
    yield at_most(what, ratio, "x", 5.0)
    yield from modes(30, 20)
    yield from statics()


def modes(count: int, number: int) -> Iterator[Row]:
    """Yield the time of the lowest frequencies, and that of SciPy's Lanczos method."""
    mechanism, name = lattice(count), f"lattice of {count} x {count} squares"

    def frequencies() -> jax.Array:
        return tj.vibrations(mechanism, modes=number).frequencies

    what = f"{name}: {number} lowest modes"
    start = time.perf_counter()
    found = np.asarray(frequencies())
    yield Row(f"{what}: first call", time.perf_counter() - start, "s")
    yield at_most(what, seconds(frequencies, repeats=5), "s", 0.5)
    free = np.setdiff1d(np.arange(3 * count**2), mechanism.fixed)
    size = mechanism.reference.size
    stiffness = mechanism.stiffness(mechanism.reference).reshape(size, size)
    sparse = csc_array(np.asarray(stiffness)[np.ix_(free, free)])
    inertia = np.asarray(mechanism.inertia()).reshape(-1)[free]
    inertia = np.where(np.isinf(inertia), MASS, inertia)
    start = time.perf_counter()
    squares = eigsh(sparse, number, diags_array(inertia), sigma=0, tol=0)[0]
    yield Row(f"SciPy eigsh: {what}", time.perf_counter() - start, "s")
    exact = np.sqrt(np.sort(squares)) / (2 * np.pi)
    what = f"{what}: relative difference from SciPy"
    yield at_most(what, float(np.max(np.abs(found / exact - 1))), "1", 1e-9)

    body, inputs = f"{count // 2} {count // 2}", np.linspace(1.0, 20.0, 10)  # Hz
    push = tj.Load(body, force=(0.0, 1.0))

    def harmonic() -> jax.Array:
        found = tj.frequency_response(mechanism, inputs, loads=[push])
        return found.displacement(body)[:, 2]

    def by_scipy() -> np.ndarray:
        row = int(np.flatnonzero(free == 3 * mechanism.names.index(body) + 2)[0])
        force = np.eye(len(free))[row]
        masses = diags_array(inertia, format="csc")
        systems = (sparse - (2 * np.pi * f) ** 2 * masses for f in inputs)
        return np.array([spsolve(system, force)[row] for system in systems])

    what = f"{name}: harmonic response at 10 frequencies"
    yield Row(what, seconds(harmonic, repeats=3), "s")
    yield Row(f"SciPy spsolve: {what}", seconds(by_scipy, repeats=3), "s")
    difference = np.max(np.abs(np.asarray(harmonic()) / by_scipy() - 1))
    yield at_most(f"{what}: relative difference from SciPy", difference, "1", 1e-9)

    def model() -> jax.Array:
        return tj.state_space(
            mechanism, {"force": push}, {"y": (body, "y")}, modes=number
        ).b

    yield Row(f"{name}: model of {number} modes", seconds(model, repeats=3), "s")


def statics() -> Iterator[Row]:
    """Yield times of building, and of equilibria compressed by 10 %."""
    corner = tj.Quadratic(np.diag(STIFFNESS))

    def squares(count: int, angle: jax.Array | float, stops: float | None, factor):
        def cell(angle) -> tj.lattices.UnitCell:
            return tj.lattices.rotating_squares(
                factor * corner, pitch=SIDE, angle=angle, mass=MASS, stop_stiffness=stops
            )

        field = None if isinstance(angle, float) else angle
        made = cell(angle) if field is None else cell
        return tj.lattices.repeat(made, (count // 2, count // 2), field)

    def build(
        count: int,
        angle: jax.Array | float = 0.5,
        stops: float | None = None,
        factor: jax.Array | float = 1.0,
    ):
        parts = squares(count, angle, stops, factor)
        fixed = {name: ["angle", "x", "y"] for name in parts.border("bottom")}
        fixed |= {name: ["angle", "x"] for name in parts.border("top")}
        return tj.Mechanism(parts.bodies, parts.hinges, fixed=fixed), parts.border("top")

    def energy(mechanism: tj.Mechanism, top: tuple[str, ...], count: int) -> jax.Array:
        travel = -0.1 * (count - 1) * SIDE
        drives = [tj.Drive(name, y=travel) for name in top]
        return tj.equilibrium(mechanism, drives=drives).energy

    start = time.perf_counter()
    build(40)
    what = "lattice of 40 x 40 squares: building"
    yield at_most(what, time.perf_counter() - start, "s", 1.0)
    for count, stops, goal in ((30, None, 0.2), (30, 0.5, 1.0), (100, None, 60.0)):
        touching = "" if stops is None else ", with contact"
        what = f"lattice of {count} x {count} squares{touching}: compressed by 10 %"
        mechanism, top = build(count, stops=stops)
        start = time.perf_counter()
        jax.block_until_ready(energy(mechanism, top, count))
        yield Row(f"{what}: first call", time.perf_counter() - start, "s")
        elapsed = seconds(partial(energy, mechanism, top, count), repeats=3)
        yield at_most(what, elapsed, "s", goal)

    @jax.jit
    def gradient(angles: jax.Array) -> jax.Array:
        return jax.grad(lambda angles: energy(*build(30, angles), 30))(angles)

    what = "lattice of 30 x 30 squares: derivatives by all angles, compressed by 10 %"
    yield at_most(what, seconds(gradient, jnp.full((15, 15), 0.5), repeats=3), "s", 2.0)

    def buckling_load(factor: jax.Array | float) -> jax.Array:
        mechanism, top = build(30, 0.0, factor=factor)
        loads = [tj.Load(name, force=(0.0, -1.0)) for name in top]
        return tj.buckling(mechanism, loads=loads, modes=1).load_factors[0]

    what = "lattice of 30 x 30 squares: buckling load"
    yield Row(what, seconds(buckling_load, 1.0, repeats=3), "s")
    slope = jax.grad(buckling_load)
    yield Row(f"{what}, and its derivative", seconds(slope, 1.0, repeats=3), "s")
