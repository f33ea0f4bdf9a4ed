"""The chains of `chains.py` with EXUDYN's static solver and its sparse factorization."""

import time
import warnings
from collections.abc import Iterator

import numpy as np

from .chains import END_ROTATION, exact_tip, HINGES, stiffness
from .measure import Row


LOAD_STEPS = 10


def exudyn_tip(hinges: int, load_steps: int) -> tuple[float, np.ndarray]:
    """Bend a chain with EXUDYN.

    Returns:
        The time of the solve (s), and the position of the last body (m).
    """
    import exudyn as exu
    from exudyn import itemInterface as items

    size = 1 / hinges
    rotation, axial, shear = stiffness(hinges)
    system = exu.SystemContainer().AddSystem()
    last = system.AddObject(items.ObjectGround())
    node = None
    for k in range(hinges):
        position = [(k + 1) * size, 0.0, 0.0]
        node = system.AddNode(items.NodeRigidBody2D(referenceCoordinates=position))
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
    moment = [0.0, 0.0, END_ROTATION]
    system.AddLoad(items.Torque(markerNumber=marker, loadVector=moment))
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
    start = time.perf_counter()
    exu.MainSolverStatic().SolveSystem(system, settings)
    elapsed = time.perf_counter() - start
    position = system.GetNodeOutput(node, exu.OutputVariableType.Position)
    return elapsed, np.asarray(position)[:2]


def run() -> Iterator[Row]:
    """Yield the rows of the table; there are none if EXUDYN is not installed."""
    try:
        import exudyn
    except ImportError:
        return
    del exudyn
    for hinges in HINGES:
        elapsed, position = exudyn_tip(hinges, LOAD_STEPS)
        what = f"EXUDYN, sparse: chain of {hinges:,} hinges, end rotated by 3 rad"
        yield Row(f"{what}: {LOAD_STEPS} load steps", elapsed, "s")
        error = float(np.max(np.abs(position - exact_tip(hinges))))
        yield Row(f"{what}: error of the end position", error, "m")
