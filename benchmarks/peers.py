"""The gain of the stage by EXUDYN's static solver, and by Newton's method in NumPy."""

import warnings
from collections.abc import Callable, Iterator

import numpy as np

from twistorjax.examples.stage import microstage, TRAVEL

from .measure import Row, seconds


DESIGNS = 500
REFERENCE_GAIN = 27.628043685  # at a web of 0.25 mm


def stiffness(web: float) -> np.ndarray:
    """Return the rotation, axial, and shear stiffness of a notch.

    The formulas are the fits of the dissertation.

    Args:
        web: Thickness of the neck; m.

    Returns:
        The stiffnesses; N m/rad, N/m, N/m.
    """
    r, scale = web / 3e-3, 69e9 * 0.02
    return scale * np.array(
        [
            (0.1109 * np.sqrt(r) - 0.035 * r) * web**2,
            0.3568 * np.sqrt(r) + 0.1452 * r,
            0.283 * r - 0.03443 * np.sqrt(r) - 0.06692 * r**1.5,
        ]
    )


def exudyn_gain() -> Callable[[float], float]:
    """Build the stage from rigid bodies and bushings of EXUDYN.

    Newton's method stops at a relative residual of 1e-8, because round-off errors
    prevent residuals below 1e-9.

    Returns:
        A function that computes the gain for a given web (m).
    """
    import exudyn as exu
    from exudyn import itemInterface as items

    mechanism = microstage()
    reference = np.asarray(mechanism.reference)[:, 1:]
    system = exu.SystemContainer().AddSystem()
    bodies, nodes = [system.AddObject(items.ObjectGround())], [None]
    for position in reference[1:]:
        node = system.AddNode(
            items.NodeRigidBody2D(referenceCoordinates=[*position.tolist(), 0.0])
        )
        body = items.ObjectRigidBody2D(mass=0.01, inertia=1e-6, nodeNumber=node)
        bodies.append(system.AddObject(body))
        nodes.append(node)
    connectors = []
    for ends, at in zip(
        mechanism.hinge_assembly.ends, np.asarray(mechanism.at)[:, 1:], strict=True
    ):
        markers = [
            system.AddMarker(
                items.MarkerBodyRigid(
                    bodyNumber=bodies[end],
                    localPosition=[*(at - reference[end]).tolist(), 0.0],
                )
            )
            for end in ends
        ]
        bushing = items.ObjectConnectorRigidBodySpringDamper(markerNumbers=markers)
        connectors.append(system.AddObject(bushing))
    ground = system.AddMarker(
        items.MarkerNodeCoordinate(
            nodeNumber=system.AddNode(items.NodePointGround()), coordinate=0
        )
    )
    for coordinate, offset in ((0, TRAVEL), (1, 0.0), (2, 0.0)):
        marker = items.MarkerNodeCoordinate(nodeNumber=nodes[5], coordinate=coordinate)
        markers = [ground, system.AddMarker(marker)]
        system.AddObject(
            items.ObjectConnectorCoordinate(markerNumbers=markers, offset=offset)
        )
    system.Assemble()
    settings = exu.SimulationSettings()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        settings.solutionSettings.writeSolutionToFile = False
    settings.staticSolver.verboseMode = 0
    settings.staticSolver.numberOfLoadSteps = 1
    settings.staticSolver.newton.relativeTolerance = 1e-8
    settings.staticSolver.newton.absoluteTolerance = 1e-9
    solver = exu.MainSolverStatic()
    zero = [0.0] * len(system.systemData.GetODE2Coordinates())

    def gain(web: float) -> float:
        rotation, axial, shear = stiffness(web)
        matrix = np.diag([axial, shear, 0.0, 0.0, 0.0, rotation])
        for connector in connectors:
            system.SetObjectParameter(connector, "stiffness", matrix)
        system.systemData.SetODE2Coordinates(zero, exu.ConfigurationType.Initial)
        solver.SolveSystem(system, settings)
        output = exu.OutputVariableType.Displacement
        displacement = system.GetNodeOutput(nodes[3], output)
        return float(displacement[0]) / TRAVEL

    return gain


def numpy_gain() -> Callable[[float], float]:
    """Prepare Newton's method in NumPy, vectorized over the hinges.

    The energy is quadratic in the twistor, as in twistorjax. The tangent stiffness has no
    geometric stiffness, so each step reduces the error by a factor of about 1000 only.

    Returns:
        A function that computes the gain for a given web (m).
    """
    mechanism = microstage()
    first, second = np.array(mechanism.hinge_assembly.ends).T
    arms = np.asarray(mechanism.hinge_assembly.arms)
    free = np.arange(3, 15)
    dofs = np.concatenate(
        [3 * first[:, None] + np.arange(3), 3 * second[:, None] + np.arange(3)], axis=1
    )

    def rotate(angle: np.ndarray, arm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotate the arms (m) of all hinges by angles (rad)."""
        c, s = np.cos(angle), np.sin(angle)
        return c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]

    def gain(web: float) -> float:
        diagonal = stiffness(web)
        displacements = np.zeros((6, 3))
        displacements[5, 1] = TRAVEL
        for _ in range(12):
            a, b = displacements[first], displacements[second]
            first_x, first_y = rotate(a[:, 0], arms[:, 0])
            second_x, second_y = rotate(b[:, 0], arms[:, 1])
            dx = b[:, 1] + second_x - arms[:, 1, 0] - a[:, 1] - first_x + arms[:, 0, 0]
            dy = b[:, 2] + second_y - arms[:, 1, 1] - a[:, 2] - first_y + arms[:, 0, 1]
            half, mean = (b[:, 0] - a[:, 0]) / 2, (b[:, 0] + a[:, 0]) / 2
            c, s = np.cos(mean), np.sin(mean)
            v0, v1, v2 = 2 * np.sin(half), c * dx + s * dy, c * dy - s * dx
            zero = np.zeros_like(c)
            # The three strains by the six displacements of the two bodies.
            jacobian = np.array(
                [
                    [-np.cos(half), zero, zero, np.cos(half), zero, zero],
                    [
                        c * first_y - s * first_x + v2 / 2,
                        -c,
                        -s,
                        s * second_x - c * second_y + v2 / 2,
                        c,
                        s,
                    ],
                    [
                        -s * first_y - c * first_x - v1 / 2,
                        s,
                        -c,
                        c * second_x + s * second_y - v1 / 2,
                        -s,
                        c,
                    ],
                ]
            )
            forces = np.einsum("ijh,ih->hj", jacobian, diagonal[:, None] * [v0, v1, v2])
            tangent = np.einsum("ijh,i,ikh->hjk", jacobian, diagonal, jacobian)
            residual = np.zeros(18)
            np.add.at(residual, dofs, forces)
            matrix = np.zeros((18, 18))
            np.add.at(matrix, (dofs[:, :, None], dofs[:, None, :]), tangent)
            step = np.linalg.solve(matrix[np.ix_(free, free)], -residual[free])
            displacements.reshape(-1)[free] += step
            if np.abs(step).max() < 1e-14:
                break
        return displacements[3, 1] / TRAVEL

    return gain


def run() -> Iterator[Row]:
    """Yield the rows of the table; there are none for a peer that is not installed."""
    webs = np.linspace(0.2e-3, 0.4e-3, DESIGNS)
    for name, make in (("EXUDYN", exudyn_gain), ("NumPy", numpy_gain)):
        try:
            gain = make()
        except ImportError:
            continue
        error = abs(gain(0.25e-3) - REFERENCE_GAIN)
        rate = DESIGNS / seconds(lambda gain=gain: np.array([gain(web) for web in webs]))
        yield Row(f"{name}: stage: nonlinear gains, on one core", rate, "/s")
        yield Row(f"{name}: stage: absolute error of the gain", error, "")
