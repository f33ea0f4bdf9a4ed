"""The same chains by EXUDYN's static solver with a sparse factorization."""

import time
import warnings
from collections.abc import Iterator

import numpy as np

from .chains import HINGES, stiffness, tip, TURN
from .measure import Row


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
    for hinges in HINGES:
        taken, place = exudyn_tip(hinges, 10)
        what = f"EXUDYN, sparse: chain of {hinges:,} hinges wound by 3 rad"
        yield Row(f"{what}, 10 load steps", taken, "s")
        yield Row(f"{what}: error", float(np.max(np.abs(place - tip(hinges)))), "m")
