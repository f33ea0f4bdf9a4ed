"""The same stage by others: EXUDYN's static solver, and Newton's method in NumPy."""

import warnings
from collections.abc import Callable, Iterator

import numpy as np

from twistorjax.examples.stage import microstage, TRAVEL

from .measure import Row, seconds


WEBS = 500


def stiffness(web: float) -> np.ndarray:
    """Rotation, axial and shear, of the dissertation's fits."""
    r, scale = web / 3e-3, 69e9 * 0.02
    return scale * np.array(
        [
            (0.1109 * np.sqrt(r) - 0.035 * r) * web**2,
            0.3568 * np.sqrt(r) + 0.1452 * r,
            0.283 * r - 0.03443 * np.sqrt(r) - 0.06692 * r**1.5,
        ]
    )


def exudyn_gain() -> Callable[[float], float]:
    """A stage of EXUDYN's rigid bodies and bushings, built once.

    Its Newton's method stops at a relative residual of 1e-8: below 1e-9 its residual is
    round-off here, and the solver would try in vain.
    """
    import exudyn as exu
    from exudyn import itemInterface as items

    mechanism = microstage()
    reference = np.asarray(mechanism.reference)[:, 1:]
    system = exu.SystemContainer().AddSystem()
    bodies, nodes = [system.AddObject(items.ObjectGround())], [None]
    for place in reference[1:]:
        node = system.AddNode(
            items.NodeRigidBody2D(referenceCoordinates=[*place.tolist(), 0.0])
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
        moved = system.GetNodeOutput(nodes[3], exu.OutputVariableType.Displacement)
        return float(moved[0]) / TRAVEL

    return gain


def numpy_gain() -> Callable[[float], float]:
    """Newton's method in NumPy, over all hinges at once, by hand: what many would write.

    With the energy of the twistor, exactly; the tangent leaves out what tension adds, so
    that each step gains three digits.
    """
    mechanism = microstage()
    first, second = np.array(mechanism.hinge_assembly.ends).T
    arms = np.asarray(mechanism.hinge_assembly.arms)
    free = np.arange(3, 15)
    places = np.concatenate(
        [3 * first[:, None] + np.arange(3), 3 * second[:, None] + np.arange(3)], axis=1
    )

    def swing(angle: np.ndarray, arm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        c, s = np.cos(angle), np.sin(angle)
        return c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]

    def gain(web: float) -> float:
        diagonal = stiffness(web)
        moved = np.zeros((6, 3))
        moved[5, 1] = TRAVEL
        for _ in range(12):
            a, b = moved[first], moved[second]
            lax, lay = swing(a[:, 0], arms[:, 0])
            lbx, lby = swing(b[:, 0], arms[:, 1])
            dx = b[:, 1] + lbx - arms[:, 1, 0] - a[:, 1] - lax + arms[:, 0, 0]
            dy = b[:, 2] + lby - arms[:, 1, 1] - a[:, 2] - lay + arms[:, 0, 1]
            half, mean = (b[:, 0] - a[:, 0]) / 2, (b[:, 0] + a[:, 0]) / 2
            c, s = np.cos(mean), np.sin(mean)
            v0, v1, v2 = 2 * np.sin(half), c * dx + s * dy, c * dy - s * dx
            zero = np.zeros_like(c)
            # rows: the three strains by the six displacements
            jacobian = np.array(
                [
                    [-np.cos(half), zero, zero, np.cos(half), zero, zero],
                    [
                        c * lay - s * lax + v2 / 2,
                        -c,
                        -s,
                        s * lbx - c * lby + v2 / 2,
                        c,
                        s,
                    ],
                    [
                        -s * lay - c * lax - v1 / 2,
                        s,
                        -c,
                        c * lbx + s * lby - v1 / 2,
                        -s,
                        c,
                    ],
                ]
            )
            forces = np.einsum("ijh,ih->hj", jacobian, diagonal[:, None] * [v0, v1, v2])
            tangent = np.einsum("ijh,i,ikh->hjk", jacobian, diagonal, jacobian)
            residual = np.zeros(18)
            np.add.at(residual, places, forces)
            matrix = np.zeros((18, 18))
            np.add.at(matrix, (places[:, :, None], places[:, None, :]), tangent)
            step = np.linalg.solve(matrix[np.ix_(free, free)], -residual[free])
            moved.reshape(-1)[free] += step
            if np.abs(step).max() < 1e-14:
                break
        return moved[3, 1] / TRAVEL

    return gain


def run() -> Iterator[Row]:
    """The rows of the table; peers that are not installed are left out."""
    webs = np.linspace(0.2e-3, 0.4e-3, WEBS)
    for name, make in (("EXUDYN", exudyn_gain), ("NumPy", numpy_gain)):
        try:
            gain = make()
        except ImportError:
            continue
        error = abs(gain(0.25e-3) - 27.628043685)
        rate = WEBS / seconds(lambda gain=gain: np.array([gain(web) for web in webs]))
        yield Row(f"{name}: nonlinear gains, on one core", rate, "/s")
        yield Row(f"{name}: its gain less the reference", error, "")
