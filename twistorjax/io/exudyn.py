"""Scripts that compute the equilibrium of a mechanism with EXUDYN."""

from collections.abc import Iterable, Sequence

import numpy as np

from .._utils.validation import require_float64
from ..mechanism.loads import Drive, Load, loaded_bodies, prescribed_dofs
from ..mechanism.mechanism import Mechanism


def exudyn_script(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    steps: int = 10,
) -> str:
    """Create a Python script that computes the same equilibrium with EXUDYN.

    The script is meant for cross-checks. Its hinges are linear springs of EXUDYN between
    two frames, with the stiffness of each energy in the reference configuration. They
    agree with the hinges of the mechanism to first order in the rotation of a hinge. At a
    rotation of 0.1 rad the transverse forces differ by some percent.

    Args:
        mechanism: The mechanism. Its reference configuration must be free of external
            loads.
        loads: Loads on the bodies.
        drives: Prescribed displacements of coordinates that are not fixed.
        steps: Number of increments in which loads and prescribed displacements are
            applied.

    Returns:
        The text of the script. It prints the displacement of each body: angle (rad),
        x (m), y (m).

    Raises:
        ValueError: Double precision is disabled; a name is unknown; or a displacement is
            prescribed twice or for a fixed coordinate; or a hinge has a misfit.

    Source:
        EXUDYN's `ObjectConnectorRigidBodySpringDamper`: github.com/jgerstmayr/EXUDYN.

    Example:
        >>> from twistorjax import Drive
        >>> from twistorjax.examples import stage
        >>> script = exudyn_script(stage.microstage(), drives=[Drive("6", x=1e-6)])
        >>> "import exudyn as exu" in script
        True
    """
    require_float64(mechanism.reference)
    if mechanism.hinge_assembly.misfits is not None:
        raise ValueError(
            "The mechanism has misfits, but the springs of the script are not loaded in "
            "the reference configuration. Use a mechanism without misfits, strokes, and "
            "changes of temperature."
        )
    dofs, targets = prescribed_dofs(mechanism, drives)
    displacements = dict.fromkeys(mechanism.fixed, 0.0)
    displacements |= {dof: float(to) for dof, to in zip(dofs, targets, strict=True)}
    bodies = {
        name: [float(value) for value in mechanism.reference[row]]
        for row, name in enumerate(mechanism.names)
    }
    hinges = {}
    for row, name in enumerate(mechanism.hinge_names):
        first, second = mechanism.hinge_assembly.ends[row]
        stiffness = mechanism.hinge_assembly.energy_of(row).tangent_stiffness()
        hinges[name] = (
            mechanism.names[first],
            mechanism.names[second],
            [float(value) for value in mechanism.at[row]],
            np.asarray(stiffness).tolist(),
        )
    prescribed = [
        (mechanism.names[dof // 3], dof % 3, value)
        for dof, value in sorted(displacements.items())
    ]
    applied = [
        (
            mechanism.names[body],
            np.asarray(load.wrench).tolist(),
            np.asarray(load.at).tolist(),
            load.follower,
        )
        for body, load in zip(loaded_bodies(mechanism, loads), loads, strict=True)
    ]
    return _SCRIPT.format(
        title=f"{len(bodies)} bodies and {len(hinges)} hinges",
        bodies=_lines(f"{name!r}: {pose!r}" for name, pose in bodies.items()),
        hinges=_lines(f"{name!r}: {hinge!r}" for name, hinge in hinges.items()),
        prescribed=_lines(map(repr, prescribed)),
        loads=_lines(map(repr, applied)),
        steps=steps,
    )


def _lines(entries: Iterable[str]) -> str:
    """Format the entries of a list or dictionary, one in each line."""
    return "".join(f"    {entry},\n" for entry in entries)


_SCRIPT = '''\
"""Equilibrium of a mechanism of {title}, computed with EXUDYN.

Install EXUDYN with `pip install exudyn`. The hinges are linear springs with the stiffness
of the reference configuration. Nonlinear effects of flexures, such as the shortening of a
leaf that bends, are not included.
"""

import exudyn as exu
import numpy as np
from exudyn import itemInterface as items

# Reference pose of each body: angle (rad), x (m), y (m)
BODIES = {{
{bodies}}}
# First and second body; reference pose of the hinge: angle (rad), x (m), y (m); stiffness
# matrix in the order rotation, axis 1, axis 2
HINGES = {{
{hinges}}}
# Body; coordinate, 0 for angle, 1 for x, 2 for y; prescribed displacement (rad or m)
PRESCRIBED = [
{prescribed}]
# Body; moment (N m) and force (N); point of application in the frame of the body (m);
# whether the force rotates with the body
LOADS = [
{loads}]


def rotation_matrix(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


system = exu.SystemContainer().AddSystem()
nodes, bodies = {{}}, {{}}
for name, (angle, x, y) in BODIES.items():
    node = items.NodeRigidBody2D(referenceCoordinates=[x, y, angle])
    nodes[name] = system.AddNode(node)
    body = items.ObjectRigidBody2D(mass=1, inertia=1, nodeNumber=nodes[name])
    bodies[name] = system.AddObject(body)


def add_marker(name, point):
    """Add a marker on a body, at a point in the frame of the body (m)."""
    body = items.MarkerBodyRigid(bodyNumber=bodies[name], localPosition=[*point, 0.0])
    return system.AddMarker(body)


def to_body(name, point):
    """Transform a point from world coordinates to the frame of a body (m)."""
    angle, *origin = BODIES[name]
    return (rotation_matrix(-angle)[:2, :2] @ (np.array(point) - origin)).tolist()


for first, second, (angle, *point), stiffness in HINGES.values():
    # EXUDYN orders the components as x, y, z and the rotations about x, y, z.
    order, components = [1, 2, 0], [0, 1, 5]
    matrix = np.zeros((6, 6))
    matrix[np.ix_(components, components)] = np.array(stiffness)[np.ix_(order, order)]
    markers = [add_marker(name, to_body(name, point)) for name in (first, second)]
    frames = [rotation_matrix(angle - BODIES[name][0]) for name in (first, second)]
    system.AddObject(
        items.ObjectConnectorRigidBodySpringDamper(
            markerNumbers=markers, stiffness=matrix, rotationMarker0=frames[0],
            rotationMarker1=frames[1],
        )
    )
ground = system.AddNode(items.NodePointGround())
ground = system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
connectors = []
for name, coordinate, value in PRESCRIBED:
    marker = items.MarkerNodeCoordinate(
        nodeNumber=nodes[name], coordinate=(2, 0, 1)[coordinate]
    )
    markers = [ground, system.AddMarker(marker)]
    connector = items.ObjectConnectorCoordinate(markerNumbers=markers, offset=0.0)
    connectors.append((system.AddObject(connector), value))
loads = []
for name, (moment, *force), point, follower in LOADS:
    marker = add_marker(name, point)
    force_vector = items.LoadForceVector(markerNumber=marker, bodyFixed=follower)
    torque_vector = items.LoadTorqueVector(markerNumber=marker)
    loads.append((system.AddLoad(force_vector), [*force, 0.0]))
    loads.append((system.AddLoad(torque_vector), [0.0, 0.0, moment]))
system.Assemble()

settings = exu.SimulationSettings()
if hasattr(settings, "solution"):  # EXUDYN 1.11 and later
    settings.solution.file.write = False
else:
    settings.solutionSettings.writeSolutionToFile = False
settings.staticSolver.verboseMode = 0
settings.staticSolver.newton.relativeTolerance = 1e-8
settings.staticSolver.newton.absoluteTolerance = 1e-9
for step in range(1, {steps} + 1):
    fraction = step / {steps}
    for connector, value in connectors:
        system.SetObjectParameter(connector, "offset", fraction * value)
    for load, vector in loads:
        vector = (fraction * np.array(vector)).tolist()
        system.SetLoadParameter(load, "loadVector", vector)
    exu.MainSolverStatic().SolveSystem(system, settings)
    solution = system.systemData.GetODE2Coordinates(exu.ConfigurationType.Current)
    system.systemData.SetODE2Coordinates(solution, exu.ConfigurationType.Initial)

print("body, angle (rad), x (m), y (m)")
for name, node in nodes.items():
    x, y, angle = system.GetNodeOutput(node, exu.OutputVariableType.Coordinates)
    print(f"{{name}} {{angle:.12g}} {{x:.12g}} {{y:.12g}}")
'''
