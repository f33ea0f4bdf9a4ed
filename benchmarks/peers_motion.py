"""The four-bar linkage in motion, by others: SciPy's stiff solvers, and EXUDYN.

Chapter 5.2, from plain numbers: a second derivation, that shares no code with twistorjax.
Coordinates are the angles of links 2 to 4, then their displacements along x, along y.
"""
# EXUDYN's stubs are wrong
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportCallIssue=false, reportIndexIssue=false

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .measure import Row, seconds


MASS = 2.7e-3
INERTIA = MASS * (0.04**2 + 0.005**2) / 12
ROTATION, ALONG_X, ALONG_Y = 0.14375, 17250.0, 1.725e6
# of links 1 to 4, and of the hinges 1-2, 2-3, 3-4, 4-1
CENTRES = np.array([[0, 0], [-0.0175, 0.0325], [0, 0.065], [0.0175, 0.0325]])
HINGES = np.array(
    [[-0.0175, 0.0075], [-0.0175, 0.0575], [0.0175, 0.0575], [0.0175, 0.0075]]
)
SPEED = 10.0
RELEASE = np.linspace(0, 0.2, 101)
DRIVEN = np.array([0, 0.09, 0.18, 0.27, 0.36, 0.405])

Rates = Callable[[float, np.ndarray], np.ndarray]
Motion = tuple[Callable[[], np.ndarray], Callable[[], int]]


def linkage(lag: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The accelerations at coordinates and rates (9, any), for dampers of this lag.

    Vectors of the plane are complex numbers, in rows, one for each hinge.
    """
    ends = np.eye(4)[:, 1:], np.eye(4)[[1, 2, 3, 0], 1:]
    relative, none = ends[1] - ends[0], np.zeros((4, 3))
    turns = np.concatenate([relative / 2, (ends[0] + ends[1]) / 2, *ends])
    angles = np.hstack([turns, np.zeros((16, 6))])
    # what moves a hinge: i times the half angle, the mean angle and the ends' angles; its
    # translation but for what the arms add
    moving = np.vstack([1j * angles, np.hstack([none, relative, 1j * relative])])
    apart = np.block([[none, relative, none], [none, none, relative]])
    inertia = np.repeat([INERTIA, MASS, MASS], 3)
    pull = -np.vstack([angles, apart]).T / inertia[:, None]
    centres, hinges = CENTRES @ [1, 1j], HINGES @ [1, 1j]
    first, second = hinges - centres, hinges - centres[[1, 2, 3, 0]]
    reference = np.concatenate([first, second])[:, None]
    gap = (first - second)[:, None]

    def accelerations(coordinates: np.ndarray, rates: np.ndarray) -> np.ndarray:
        place, motion = moving @ coordinates, moving @ rates
        turned = np.exp(place[:16])
        half, mean, arms = turned[:4], turned[4:8], turned[8:] * reference
        back, swing = mean.conj(), motion[8:16] * arms
        strain = back * (place[16:] + arms[4:] - arms[:4] + gap)
        rate = back * (motion[16:] + swing[4:] - swing[:4]) - motion[4:8] * strain
        lagging = strain + lag * rate
        force = ALONG_X * lagging.real + 1j * ALONG_Y * lagging.imag
        world = mean * force
        wrench = np.empty((24, *coordinates.shape[1:]))
        bend = half.imag + lag * half.real * motion[:4].imag
        wrench[:4] = 4 * ROTATION * half.real * bend
        wrench[4:8] = (force.conj() * strain).imag
        wrench[8:12] = -(world * arms[:4].conj()).imag
        wrench[12:16] = (world * arms[4:].conj()).imag
        wrench[16:20], wrench[20:] = world.real, world.imag
        return pull @ wrench

    return accelerations


def released() -> Rates:
    """The rates of the nine coordinates and of their rates, free."""
    accelerations = linkage(1e-4)

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        q, v = state.reshape(2, 9, -1)
        return np.concatenate([v, accelerations(q, v)]).reshape(state.shape)

    return rates


def driven() -> Rates:
    """The rates of the eight coordinates beside the angle of link 2, which is imposed."""
    accelerations = linkage(1e-3)

    def rates(time: float, state: np.ndarray) -> np.ndarray:
        free = state.reshape(2, 8, -1)
        q, v = np.empty((2, 9, free.shape[2]))
        q[0] = 0.05 * np.pi * (1 - np.cos(10 * np.pi * time))
        v[0] = 0.5 * np.pi**2 * np.sin(10 * np.pi * time)
        q[1:], v[1:] = free
        return np.concatenate([v[1:], accelerations(q, v)[1:]]).reshape(state.shape)

    return rates


def scipy_motion(
    rates: Rates,
    start: np.ndarray,
    times: np.ndarray,
    method: str,
    rtol: float,
    atol: float,
) -> Motion:
    """The coordinates at these times, and the steps taken, as two calls.

    The tolerance `atol` is that of an angle, of a length in cm, and of their rates in
    1e4 /s: rates must be loose, or the stiff ones rule the steps. A small `rtol` helps
    SciPy's own BDF and Radau, because it loosens their Newton's method. LSODA is
    called by `odeint`, whose steps are compiled.
    """
    from scipy.integrate import odeint, solve_ivp

    count = start.size // 2
    scale = np.tile(np.repeat([1, 0.01], [count - 6, 6]), 2)
    scale[count:] *= 1e4
    nudge = 1e-6 * scale

    def jacobian(time: float, state: np.ndarray) -> np.ndarray:
        near = rates(time, np.column_stack([state, state[:, None] + np.diag(nudge)]))
        return (near[:, 1:] - near[:, :1]) / nudge

    tolerances = {"rtol": rtol, "atol": atol * scale}

    def lsoda() -> tuple[np.ndarray, dict]:
        options = {"tfirst": True, "mxstep": 10**6, "full_output": True}
        return odeint(rates, start, times, Dfun=jacobian, **options, **tolerances)

    def ivp(shown: np.ndarray | None) -> np.ndarray:
        span = times[0], times[-1]
        options = {"method": method, "jac": jacobian, "t_eval": shown}
        return solve_ivp(rates, span, start, **options, **tolerances).y

    if method == "LSODA":
        return lambda: lsoda()[0].T[:count], lambda: int(lsoda()[1]["nst"][-1])
    return lambda: ivp(times)[:count], lambda: ivp(None).shape[1] - 1


def scipy_release(method: str, rtol: float, atol: float) -> Motion:
    """Link 3 set off along x, and the angles of links 2 to 4 for 0.2 s."""
    start = np.zeros(18)
    start[13] = SPEED
    motion, steps = scipy_motion(released(), start, RELEASE, method, rtol, atol)
    return lambda: motion()[:3], steps


def scipy_driven(method: str, rtol: float, atol: float) -> Motion:
    """The angle of link 2 imposed, and the displacements of links 2 to 4 for 0.405 s."""
    motion, steps = scipy_motion(driven(), np.zeros(16), DRIVEN, method, rtol, atol)
    return lambda: motion()[2:], steps


def exudyn_linkage(
    end: float, kept: float, steps: int, relative: float, absolute: float
) -> tuple[Any, Callable[[], np.ndarray], int]:
    """The linkage of EXUDYN's rigid bodies and bushings, let go.

    With its implicit solver as Newmark's method without numerical damping, and a modified
    Newton's method that renews its matrix often, to the given tolerances. With beta 0.16
    it errs less than with 1/4, which needs 5700 steps for 1e-4 rad over 0.2 s, but is
    unstable at 3500; RK44, the best of its explicit solvers, is unstable at 25,000.

    Returns:
        The system; a call that runs it, and gives displacements (x, y, angle) of links 2
        to 4 at each time kept; and the number of the connector that is hinge A.
    """
    import exudyn as exu
    from exudyn import itemInterface as items

    system = exu.SystemContainer().AddSystem()
    bodies, nodes = [system.AddObject(items.ObjectGround())], []
    for place, speed in zip(CENTRES[1:], (0, SPEED, 0), strict=True):
        node = items.NodeRigidBody2D(
            referenceCoordinates=[*place, 0], initialVelocities=[speed, 0, 0]
        )
        nodes.append(system.AddNode(node))
        body = items.ObjectRigidBody2D(mass=MASS, inertia=INERTIA, nodeNumber=nodes[-1])
        bodies.append(system.AddObject(body))
    stiffness = np.diag([ALONG_X, ALONG_Y, 0, 0, 0, ROTATION])
    connectors = []
    for row, at in enumerate(HINGES):
        markers = [
            system.AddMarker(
                items.MarkerBodyRigid(
                    bodyNumber=bodies[link], localPosition=[*(at - CENTRES[link]), 0]
                )
            )
            for link in (row, (row + 1) % 4)
        ]
        connector = items.ObjectConnectorRigidBodySpringDamper(
            markerNumbers=markers, stiffness=stiffness, damping=1e-4 * stiffness
        )
        connectors.append(system.AddObject(connector))
    sensors = [
        system.AddSensor(
            items.SensorNode(
                nodeNumber=node,
                outputVariableType=exu.OutputVariableType.Coordinates,
                storeInternal=True,
                writeToFile=False,
            )
        )
        for node in nodes
    ]
    system.Assemble()
    settings = exu.SimulationSettings()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        settings.solutionSettings.writeSolutionToFile = False
        settings.solutionSettings.sensorsWritePeriod = kept
    integration = settings.timeIntegration
    integration.verboseMode = 0
    integration.endTime = end
    integration.numberOfSteps = steps
    integration.generalizedAlpha.useNewmark = True
    integration.generalizedAlpha.newmarkBeta = 0.16
    integration.newton.useModifiedNewton = True
    integration.newton.modifiedNewtonContractivity = 0.03
    integration.newton.relativeTolerance = relative
    integration.newton.absoluteTolerance = absolute
    solver = exu.MainSolverImplicitSecondOrder()

    def moved() -> np.ndarray:
        solver.SolveSystem(system, settings)
        told = [system.GetSensorStoredData(sensor)[:, 1:] for sensor in sensors]
        return np.array(told)

    return system, moved, connectors[0]


def exudyn_release(
    steps: int = 4000, relative: float = 2e-5, absolute: float = 1e-6
) -> Callable[[], np.ndarray]:
    """The release by EXUDYN, built once: the angles of links 2 to 4."""
    _, moved, _ = exudyn_linkage(RELEASE[-1], RELEASE[1], steps, relative, absolute)
    return lambda: moved()[:, :, 2]


# The loosest settings that keep the error: 1e-4 rad at all times, and 1e-8 m.
FOUR_BARS = (
    (
        "four-bar released",
        scipy_release,
        "rad",
        {"BDF": 1e-6, "Radau": 6e-6, "LSODA": 1e-7},
    ),
    ("four-bar driven", scipy_driven, "m", {"BDF": 2e-6, "Radau": 7e-6, "LSODA": 3e-7}),
)


def table(
    what: str, motion: Callable[[], np.ndarray], steps: int, exact: np.ndarray, unit: str
) -> Iterator[Row]:
    """The rows of one peer at one motion, on one core."""
    time = seconds(motion, repeats=5)
    yield Row(f"{what}: one simulation, on one core", time, "s")
    yield Row(f"{what}: simulations, on one core", 1 / time, "/s")
    yield Row(f"{what}: steps", steps, "")
    yield Row(f"{what}: its error", float(np.abs(motion() - exact).max()), unit)


def run() -> Iterator[Row]:
    """The rows of the table; peers that are not installed are left out."""
    for what, make, unit, tolerances in FOUR_BARS:
        try:
            exact = make("Radau", 1e-13, 1e-9)[0]()
        except ImportError:
            break
        for method, atol in tolerances.items():
            motion, steps = make(method, 1e-13, atol)
            yield from table(f"SciPy {method}: {what}", motion, steps(), exact, unit)
    try:
        motion, exact = exudyn_release(), exudyn_release(50_000, 1e-9, 1e-11)()
    except ImportError:
        return
    yield from table("EXUDYN: four-bar released", motion, 4000, exact, "rad")
