"""Motion of the four-bar linkage by the stiff solvers of SciPy, and by EXUDYN.

The linkage is that of section 5.2 of the dissertation. Its equations of motion are an
independent derivation that shares no code with twistorjax. The nine coordinates are the
angles of links 2 to 4 (rad), their displacements along x (m), and those along y (m).
"""
# The stubs of EXUDYN contain wrong types.
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportCallIssue=false, reportIndexIssue=false

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .measure import Row, seconds


MASS = 2.7e-3  # of a link; kg
INERTIA = MASS * (0.04**2 + 0.005**2) / 12  # of a link; kg m2
# Stiffnesses of a hinge; N m/rad, N/m, N/m.
ROTATION, ALONG_X, ALONG_Y = 0.14375, 17250.0, 1.725e6
# Positions of the centers of links 1 to 4, and of the hinges 1-2, 2-3, 3-4, 4-1; m.
CENTERS = np.array([[0, 0], [-0.0175, 0.0325], [0, 0.065], [0.0175, 0.0325]])
HINGES = np.array(
    [[-0.0175, 0.0075], [-0.0175, 0.0575], [0.0175, 0.0575], [0.0175, 0.0075]]
)
SPEED = 10.0  # initial velocity of link 3; m/s
# Times at which the two motions are compared; s.
RELEASED_TIMES = np.linspace(0, 0.2, 101)
PRESCRIBED_TIMES = np.array([0, 0.09, 0.18, 0.27, 0.36, 0.405])

Rates = Callable[[float, np.ndarray], np.ndarray]
Motion = tuple[Callable[[], np.ndarray], Callable[[], int]]


def linkage(damping_time: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Prepare the equations of motion of the linkage.

    Vectors of the plane are complex numbers. Arrays have one row for each hinge.

    Args:
        damping_time: Ratio of damping to stiffness of the hinges; s.

    Returns:
        A function that computes the accelerations from coordinates and velocities; each
        array has nine rows, and any number of columns.
    """
    ends = np.eye(4)[:, 1:], np.eye(4)[[1, 2, 3, 0], 1:]
    relative, zeros = ends[1] - ends[0], np.zeros((4, 3))
    # Rows: the half angle and the mean angle of each hinge, and the angles of its ends.
    angles = np.concatenate([relative / 2, (ends[0] + ends[1]) / 2, *ends])
    angles = np.hstack([angles, np.zeros((16, 6))])
    # These angles times i, and the relative displacement of the centers of the two links.
    kinematics = np.vstack([1j * angles, np.hstack([zeros, relative, 1j * relative])])
    translations = np.block([[zeros, relative, zeros], [zeros, zeros, relative]])
    inertia = np.repeat([INERTIA, MASS, MASS], 3)
    accelerations_of_forces = -np.vstack([angles, translations]).T / inertia[:, None]
    centers, hinges = CENTERS @ [1, 1j], HINGES @ [1, 1j]
    first, second = hinges - centers, hinges - centers[[1, 2, 3, 0]]
    reference_arms = np.concatenate([first, second])[:, None]
    center_distance = (first - second)[:, None]

    def accelerations(coordinates: np.ndarray, rates: np.ndarray) -> np.ndarray:
        # Numba multiplies only matrices of the same type.
        position = kinematics @ coordinates.astype(np.complex128)
        velocity = kinematics @ rates.astype(np.complex128)
        rotations = np.exp(position[:16])
        half, mean = rotations[:4], rotations[4:8]
        arms = rotations[8:] * reference_arms
        to_mid_frame, arm_velocities = mean.conj(), velocity[8:16] * arms
        strain = to_mid_frame * (position[16:] + arms[4:] - arms[:4] + center_distance)
        rate = (
            to_mid_frame * (velocity[16:] + arm_velocities[4:] - arm_velocities[:4])
            - velocity[4:8] * strain
        )
        damped_strain = strain + damping_time * rate
        force = ALONG_X * damped_strain.real + 1j * ALONG_Y * damped_strain.imag
        world_force = mean * force
        forces = np.empty((24, coordinates.shape[1]))
        damped_sine = half.imag + damping_time * half.real * velocity[:4].imag
        forces[:4] = 4 * ROTATION * half.real * damped_sine
        forces[4:8] = (force.conj() * strain).imag
        forces[8:12] = -(world_force * arms[:4].conj()).imag
        forces[12:16] = (world_force * arms[4:].conj()).imag
        forces[16:20], forces[20:] = world_force.real, world_force.imag
        return accelerations_of_forces @ forces

    return accelerations


def released_linkage(compiler: Callable[[Callable], Callable] | None = None) -> Rates:
    """Return the time derivative of the state: nine coordinates and their velocities.

    A `compiler`, such as `numba.njit`, compiles it.
    """
    accelerations = linkage(1e-4)
    if compiler is not None:
        accelerations = compiler(accelerations)

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        both = np.ascontiguousarray(state).reshape(2, 9, -1)
        q, v = both[0], both[1]
        return np.concatenate((v, accelerations(q, v))).reshape(state.shape)

    return rates if compiler is None else compiler(rates)


def prescribed_linkage() -> Rates:
    """Return the time derivative of the state if the angle of link 2 is prescribed.

    The state consists of the eight other coordinates and their velocities.
    """
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
    """Prepare the integration of a motion by SciPy.

    LSODA is called by `odeint`, because its steps are compiled.

    Args:
        rates: Time derivative of the state.
        start: Initial state.
        times: Times of the output; s.
        method: "BDF", "Radau", or "LSODA".
        rtol: Relative tolerance. A small value makes BDF and Radau of SciPy faster,
            because it loosens the tolerance of their Newton's method.
        atol: Absolute tolerance of an angle in rad, of a length in cm, and of their rates
            in units of 1e4 /s. The tolerance of the rates is loose, because otherwise
            stiff components determine the steps.

    Returns:
        A function that computes the coordinates at the times, and a function that counts
        the steps.
    """
    from scipy.integrate import odeint, solve_ivp

    count = start.size // 2
    scale = np.tile(np.repeat([1, 0.01], [count - 6, 6]), 2)
    scale[count:] *= 1e4
    increments = 1e-6 * scale

    def jacobian(time: float, state: np.ndarray) -> np.ndarray:
        values = rates(
            time, np.column_stack([state, state[:, None] + np.diag(increments)])
        )
        return (values[:, 1:] - values[:, :1]) / increments

    tolerances = {"rtol": rtol, "atol": atol * scale}

    def lsoda() -> tuple[np.ndarray, dict]:
        options = {"tfirst": True, "mxstep": 10**6, "full_output": True}
        return odeint(rates, start, times, Dfun=jacobian, **options, **tolerances)

    def ivp(output_times: np.ndarray | None) -> np.ndarray:
        span = times[0], times[-1]
        options = {"method": method, "jac": jacobian, "t_eval": output_times}
        return solve_ivp(rates, span, start, **options, **tolerances).y

    if method == "LSODA":
        return lambda: lsoda()[0].T[:count], lambda: int(lsoda()[1]["nst"][-1])
    return lambda: ivp(times)[:count], lambda: ivp(None).shape[1] - 1


def scipy_released(method: str, rtol: float, atol: float) -> Motion:
    """Prepare the released motion for 0.2 s. The output is the angles of links 2 to 4.

    With the method `COMPILED`, Numba compiles the time derivative.
    """
    start, compiler = np.zeros(18), None
    start[13] = SPEED
    if method == COMPILED:
        import numba

        method, compiler = "LSODA", numba.njit
    rates = released_linkage(compiler)
    motion, steps = scipy_motion(rates, start, RELEASED_TIMES, method, rtol, atol)
    return lambda: motion()[:3], steps


def scipy_prescribed(method: str, rtol: float, atol: float) -> Motion:
    """Prepare the motion for 0.405 s in which the angle of link 2 is prescribed.

    The output is the displacements of links 2 to 4.
    """
    start = np.zeros(16)
    motion, steps = scipy_motion(
        prescribed_linkage(), start, PRESCRIBED_TIMES, method, rtol, atol
    )
    return lambda: motion()[2:], steps


def exudyn_linkage(
    end: float, output_interval: float, steps: int, relative: float, absolute: float
) -> tuple[Any, Callable[[], np.ndarray], int]:
    """Build the released linkage from rigid bodies and bushings of EXUDYN.

    The implicit solver is Newmark's method without numerical damping. Its modified Newton
    method updates the matrix often. With the parameter beta = 0.16, 4000 steps reach an
    error of 1e-4 rad over 0.2 s, but 3500 steps are unstable; with beta = 1/4, 5700 steps
    are needed. RK44, the best explicit solver, is unstable even with 25,000 steps.

    Args:
        end: End time of the simulation; s.
        output_interval: Time between two outputs; s.
        steps: Number of time steps.
        relative: Relative tolerance of Newton's method.
        absolute: Absolute tolerance of Newton's method.

    Returns:
        The system; a function that simulates it and returns the displacements x, y and
        angle of links 2 to 4 at the output times; and the number of the connector of
        hinge A.
    """
    import exudyn as exu
    from exudyn import itemInterface as items

    system = exu.SystemContainer().AddSystem()
    bodies, nodes = [system.AddObject(items.ObjectGround())], []
    for position, speed in zip(CENTERS[1:], (0, SPEED, 0), strict=True):
        node = items.NodeRigidBody2D(
            referenceCoordinates=[*position, 0], initialVelocities=[speed, 0, 0]
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
                    bodyNumber=bodies[link], localPosition=[*(at - CENTERS[link]), 0]
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
        settings.solutionSettings.sensorsWritePeriod = output_interval
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

    def simulate() -> np.ndarray:
        solver.SolveSystem(system, settings)
        outputs = [system.GetSensorStoredData(sensor)[:, 1:] for sensor in sensors]
        return np.array(outputs)

    return system, simulate, connectors[0]


def exudyn_released(
    steps: int = 4000, relative: float = 2e-5, absolute: float = 1e-6
) -> Callable[[], np.ndarray]:
    """Prepare the released motion with EXUDYN. The output is the angles of the links."""
    end, output_interval = RELEASED_TIMES[-1], RELEASED_TIMES[1]
    _, simulate, _ = exudyn_linkage(end, output_interval, steps, relative, absolute)
    return lambda: simulate()[:, :, 2]


RELEASED = "released four-bar linkage"
COMPILED = "LSODA with Numba"
PRESCRIBED = "four-bar linkage with a prescribed rotation"
# The loosest tolerances with which the error is about 1e-4 rad or 1e-8 m at all times.
FOUR_BARS = (
    (
        RELEASED,
        scipy_released,
        "rad",
        {"BDF": 1e-6, "Radau": 6e-6, "LSODA": 1e-7, COMPILED: 1e-7},
    ),
    (PRESCRIBED, scipy_prescribed, "m", {"BDF": 2e-6, "Radau": 7e-6, "LSODA": 3e-7}),
)


def table(
    what: str, motion: Callable[[], np.ndarray], steps: int, exact: np.ndarray, unit: str
) -> Iterator[Row]:
    """Yield the rows of one program and one motion, on one core."""
    time = seconds(motion, repeats=5)
    yield Row(f"{what}: one simulation, on one core", time, "s")
    yield Row(f"{what}: simulations, on one core", 1 / time, "/s")
    yield Row(f"{what}: steps", steps, "")
    yield Row(f"{what}: error", float(np.abs(motion() - exact).max()), unit)


def run() -> Iterator[Row]:
    """Yield the rows of the table; there are none for a peer that is not installed."""
    for what, make, unit, tolerances in FOUR_BARS:
        try:
            exact = make("Radau", 1e-13, 1e-9)[0]()
        except ImportError:
            break
        for method, atol in tolerances.items():
            try:
                motion, steps = make(method, 1e-13, atol)
            except ImportError:
                continue
            yield from table(f"SciPy {method}: {what}", motion, steps(), exact, unit)
    try:
        motion, exact = exudyn_released(), exudyn_released(50_000, 1e-9, 1e-11)()
    except ImportError:
        return
    yield from table(f"EXUDYN: {RELEASED}", motion, 4000, exact, "rad")
