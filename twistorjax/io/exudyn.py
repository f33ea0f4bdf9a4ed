"""Scripts by which another program checks a mechanism."""

from collections.abc import Sequence

import numpy as np

from .._utils.validation import require_float64
from ..mechanism.loads import Drive, driven, Load, loaded_bodies
from ..mechanism.mechanism import Mechanism


def exudyn_script(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    steps: int = 10,
) -> str:
    """A Python script that finds the same equilibrium with EXUDYN, for cross-checking.

    Its hinges are EXUDYN's linear springs between two frames, with the stiffness at rest
    of each energy. They are the same to first order in the turn of a hinge; a hinge that
    turns by 0.1 rad differs by some per cent of its transverse force.

    Args:
        mechanism: at rest where nothing loads it.
        loads: on its bodies.
        drives: of coordinates that are not held.
        steps: in which loads and drives are applied.

    Returns:
        The script, to be written into a file. It prints how far each body has moved:
        angle, x, y; rad, m, m.

    Raises:
        ValueError: double precision is off; a name is unknown; a coordinate is driven
            twice, or driven and held.

    Source:
        EXUDYN's `ObjectConnectorRigidBodySpringDamper`: github.com/jgerstmayr/EXUDYN.

    Example:
        >>> from twistorjax.examples import stage
        >>> script = exudyn_script(stage.microstage(), drives=[Drive("6", x=1e-6)])
        >>> script.splitlines()[6]
        'import exudyn as exu'
    """
    require_float64(mechanism.reference)
    places, targets = driven(mechanism, drives)
    given = dict.fromkeys(mechanism.fixed, 0.0)
    given |= {place: float(to) for place, to in zip(places, targets, strict=True)}
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
    fixed = [(mechanism.names[p // 3], p % 3, to) for p, to in sorted(given.items())]
    pushes = [
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
        bodies=_listed(bodies.items()),
        hinges=_listed(hinges.items()),
        fixed=_rows(fixed),
        pushes=_rows(pushes),
        steps=steps,
    )


def _listed(items) -> str:
    lines = "".join(f"    {name!r}: {value!r},\n" for name, value in items)
    return "{\n" + lines + "}"


def _rows(rows) -> str:
    return "[\n" + "".join(f"    {row!r},\n" for row in rows) + "]"


_SCRIPT = '''\
"""{title} at rest under loads, by EXUDYN (pip install exudyn).

Hinges are linear springs with their stiffness at rest: what they do beyond it, as leaves
that shorten where they bend, is not in here.
"""

import exudyn as exu
import numpy as np
from exudyn import itemInterface as items

# angle, x, y at rest; rad, m, m
BODIES = {bodies}
# two bodies; angle, x, y at rest; stiffness by turn, along, across
HINGES = {hinges}
# body; 0, 1, 2 for angle, x, y; displacement
GIVEN = {fixed}
# body; moment, force; where in its frame; whether it follows
LOADS = {pushes}


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


system = exu.SystemContainer().AddSystem()
nodes, bodies = {{}}, {{}}
for name, (angle, x, y) in BODIES.items():
    node = items.NodeRigidBody2D(referenceCoordinates=[x, y, angle])
    nodes[name] = system.AddNode(node)
    body = items.ObjectRigidBody2D(mass=1, inertia=1, nodeNumber=nodes[name])
    bodies[name] = system.AddObject(body)


def marker(name, place):
    body = items.MarkerBodyRigid(bodyNumber=bodies[name], localPosition=[*place, 0.0])
    return system.AddMarker(body)


def inside(name, place):
    angle, *rest = BODIES[name]
    return (turned(-angle)[:2, :2] @ (np.array(place) - rest)).tolist()


for first, second, (angle, *place), stiffness in HINGES.values():
    rotation, along, across = range(3)
    order, slots = [along, across, rotation], [0, 1, 5]
    matrix = np.zeros((6, 6))
    matrix[np.ix_(slots, slots)] = np.array(stiffness)[np.ix_(order, order)]
    ends = [marker(name, inside(name, place)) for name in (first, second)]
    frames = [turned(angle - BODIES[name][0]) for name in (first, second)]
    system.AddObject(
        items.ObjectConnectorRigidBodySpringDamper(
            markerNumbers=ends, stiffness=matrix, rotationMarker0=frames[0],
            rotationMarker1=frames[1],
        )
    )
ground = system.AddNode(items.NodePointGround())
ground = system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
moving = []
for name, which, value in GIVEN:
    place = items.MarkerNodeCoordinate(
        nodeNumber=nodes[name], coordinate=(2, 0, 1)[which]
    )
    both = [ground, system.AddMarker(place)]
    held = items.ObjectConnectorCoordinate(markerNumbers=both, offset=0.0)
    moving.append((system.AddObject(held), value))
loads = []
for name, (moment, *force), place, follows in LOADS:
    at = marker(name, place)
    push = items.LoadForceVector(markerNumber=at, bodyFixed=follows)
    turn = items.LoadTorqueVector(markerNumber=at)
    loads.append((system.AddLoad(push), [*force, 0.0]))
    loads.append((system.AddLoad(turn), [0.0, 0.0, moment]))
system.Assemble()

settings = exu.SimulationSettings()
if hasattr(settings, "solution"):  # since EXUDYN 1.11
    settings.solution.file.write = False
else:
    settings.solutionSettings.writeSolutionToFile = False
settings.staticSolver.verboseMode = 0
settings.staticSolver.newton.relativeTolerance = 1e-8
settings.staticSolver.newton.absoluteTolerance = 1e-9
for step in range(1, {steps} + 1):
    part = step / {steps}
    for connector, value in moving:
        system.SetObjectParameter(connector, "offset", part * value)
    for load, vector in loads:
        system.SetLoadParameter(load, "loadVector", (part * np.array(vector)).tolist())
    exu.MainSolverStatic().SolveSystem(system, settings)
    found = system.systemData.GetODE2Coordinates(exu.ConfigurationType.Current)
    system.systemData.SetODE2Coordinates(found, exu.ConfigurationType.Initial)

print("body, angle (rad), x (m), y (m)")
for name, node in nodes.items():
    x, y, angle = system.GetNodeOutput(node, exu.OutputVariableType.Coordinates)
    print(f"{{name}} {{angle:.12g}} {{x:.12g}} {{y:.12g}}")
'''
