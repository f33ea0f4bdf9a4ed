"""Chains of a thousand hinges and more, wound up, beside EXUDYN's sparse solver."""

import time
import warnings
from collections.abc import Iterator

import jax
import numpy as np

import twistorjax as tj

from .measure import at_most, Row, seconds


TURN = 3.0  # of the last body; rad


def slender(hinges: int) -> tj.Mechanism:
    """A beam of unit length and bending stiffness, clamped at one end."""
    leaf = tj.Quadratic(np.diag(stiffness(hinges)), "twist")
    size = 1 / hinges
    bodies = [tj.Body(str(k), (0.0, k * size, 0.0)) for k in range(hinges + 1)]
    joints = [
        tj.Hinge(str(k), str(k), str(k + 1), leaf, (0.0, (k + 0.5) * size, 0.0))
        for k in range(hinges)
    ]
    return tj.Mechanism(bodies, joints, held=["0"])


def stiffness(hinges: int) -> np.ndarray:
    """Rotation, axial and shear stiffness of each hinge; N m/rad, N/m, N/m."""
    return np.array([1.0, 1e6, 12.0 * hinges**2]) * hinges


def tip(hinges: int) -> np.ndarray:
    """Where the last body's origin ends, exactly: on a polygon; m."""
    angles = TURN / hinges * np.arange(hinges + 1)
    links = np.stack([np.cos(angles), np.sin(angles)]) / hinges
    return links.sum(axis=1) - (links[:, 0] + links[:, -1]) / 2


def exudyn_tip(hinges: int, load_steps: int) -> tuple[float, np.ndarray]:
    """The same by EXUDYN: seconds of the solve, and where its last body ends; s, m."""
    import exudyn as exu
    from exudyn import itemInterface as items

    size = 1 / hinges
    rotation, axial, shear = stiffness(hinges)
    system = exu.SystemContainer().AddSystem()
    last = system.AddObject(items.ObjectGround())
    node = None
    for k in range(hinges):
        place = [(k + 1) * size, 0.0, 0.0]
        node = system.AddNode(items.NodeRigidBody2D(referenceCoordinates=place))
        body = system.AddObject(
            items.ObjectRigidBody2D(mass=1.0, inertia=1.0, nodeNumber=node)
        )
        ends = [
            system.AddMarker(items.MarkerBodyRigid(bodyNumber=end, localPosition=local))
            for end, local in (
                (last, [k * size + size / 2 if k == 0 else size / 2, 0.0, 0.0]),
                (body, [-size / 2, 0.0, 0.0]),
            )
        ]
        system.AddObject(
            items.ObjectConnectorRigidBodySpringDamper(
                markerNumbers=ends,
                stiffness=np.diag([axial, shear, 0.0, 0.0, 0.0, rotation]),
            )
        )
        last = body
    marker = system.AddMarker(items.MarkerBodyRigid(bodyNumber=last))
    system.AddLoad(items.Torque(markerNumber=marker, loadVector=[0.0, 0.0, TURN]))
    system.Assemble()
    settings = exu.SimulationSettings()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        settings.solutionSettings.writeSolutionToFile = False
    settings.linearSolverType = exu.LinearSolverType.EigenSparse
    settings.staticSolver.verboseMode = 0
    settings.staticSolver.numberOfLoadSteps = load_steps
    settings.staticSolver.newton.relativeTolerance = 1e-8
    settings.staticSolver.newton.absoluteTolerance = 1e-9
    started = time.perf_counter()
    exu.MainSolverStatic().SolveSystem(system, settings)
    taken = time.perf_counter() - started
    moved = system.GetNodeOutput(node, exu.OutputVariableType.Position)
    return taken, np.asarray(moved)[:2]


def run() -> Iterator[Row]:
    """The rows of the table."""
    for hinges, bound in ((1000, 2.0), (3000, 20.0)):
        mechanism = slender(hinges)
        load = tj.Load(str(hinges), (TURN, 0.0, 0.0))

        def wind(mechanism: tj.Mechanism, load: tj.Load = load) -> tj.Equilibrium:
            return tj.equilibrium(mechanism, loads=[load])

        started = time.perf_counter()
        wound = jax.block_until_ready(wind(mechanism))
        first = time.perf_counter() - started
        what = f"chain of {hinges:,} hinges wound by 3 rad"
        yield Row(f"{what}: first call, compiled in it", first, "s")
        again = seconds(wind, mechanism, repeats=3)
        yield at_most(f"{what}: once compiled", again, "s", bound)
        error = np.max(np.abs(wound.pose(str(hinges))[1:] - tip(hinges)))
        yield at_most(f"{what}: error of the tip", float(error), "m", 1e-6)
        taken, place = exudyn_tip(hinges, 10)
        yield Row(f"{what}: EXUDYN, sparse, 10 load steps", taken, "s")
        yield Row(f"{what}: its error", float(np.max(np.abs(place - tip(hinges)))), "m")
