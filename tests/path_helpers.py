"""Mechanisms with known equilibrium paths."""

from itertools import pairwise

import numpy as np

import twistorjax as tj
from twistorjax._utils.host import on_host


BAR_STIFFNESS = 1000.0


def von_mises_force(height, rise=0.3, stiffness=BAR_STIFFNESS):
    """Force on the apex of the truss, downward, at a height of the apex."""
    xp, (height, rise) = on_host(height, rise)
    length, deformed = xp.hypot(1.0, rise), xp.hypot(1.0, height)
    return 2 * stiffness * height * (length / deformed - 1)


def von_mises_limit_height(rise=0.3):
    """Height of the apex at the first limit point."""
    xp, (rise,) = on_host(rise)
    return xp.sqrt(xp.hypot(1.0, rise) ** (2 / 3) - 1)


def von_mises_limit_force(rise=0.3, stiffness=BAR_STIFFNESS):
    """Largest force that the truss carries before it snaps through."""
    return von_mises_force(von_mises_limit_height(rise), rise, stiffness)


def bar(name, first, second, start, end, stiffness):
    """Bar of a stiffness (N/m) between two points, which may be traced."""
    xp, (start, end) = on_host(start, end)
    side = end - start
    spring = tj.energies.AxialSpring(stiffness, length=xp.hypot(*side))
    at = xp.append(xp.arctan2(side[1], side[0]), (start + end) / 2)
    return tj.Hinge(name, first, second, spring, at=at)


def bars_of_a_truss(left=BAR_STIFFNESS, right=BAR_STIFFNESS, rise=0.3):
    """Two bars, of stiffness `left` and `right`, to an apex at a height; N/m, m."""
    feet, apex = (np.array([-1.0, 0.0]), np.array([1.0, 0.0])), np.array([0.0, rise])
    return [
        bar("left", "wall", "apex", feet[0], apex, left),
        bar("right", "apex", "wall", apex, feet[1], right),
    ]


def truss_of(hinges, rise=0.3, apex=("angle",)):
    """Truss of some hinges; the coordinates `apex` of the apex are fixed."""
    bodies = [tj.Body("wall"), tj.Body("apex", pose=(0.0, 0.0, rise))]
    fixed = {"wall": ["angle", "x", "y"], "apex": list(apex)}
    return tj.Mechanism(bodies, hinges, fixed=fixed)


def truss_and_link(stiffness, force=1.0):
    """Truss of von Mises, a link that buckles at a load of `stiffness`, and their loads.

    `force` is that on the apex; the load on the link is 1 N. They are not connected.
    """
    spring = tj.Quadratic(np.diag([stiffness, 1.0, 1.0]))
    hinge = tj.Hinge("link", "wall", "link", spring, (np.pi / 2, 10.0, 0.0))
    bodies = [tj.Body("wall"), tj.Body("apex", (0, 0, 0.3)), tj.Body("link", (0, 10, 0))]
    fixed = {"wall": ["angle", "x", "y"], "apex": ["angle"], "link": ["x", "y"]}
    loads = [
        tj.Load("apex", force=(0.0, -force)),
        tj.Load("link", force=(0.0, -1.0), at=(0.0, 1.0)),
    ]
    return tj.Mechanism(bodies, [*bars_of_a_truss(), hinge], fixed=fixed), loads


def column(count=6, rotational=1.0, stiff=1e7):
    """Vertical column of unit length: rigid links, clamped at the lower end."""
    length = 1.0 / count
    rotation = np.diag([1.0, 0.0, 0.0])
    spring = tj.Quadratic(rotation * rotational + np.diag([0.0, stiff, stiff]))
    names = ["base", *(f"link {k}" for k in range(count))]
    bodies = [tj.Body("base")]
    bodies += [
        tj.Body(name, pose=(0.0, 0.0, (k + 0.5) * length))
        for k, name in enumerate(names[1:])
    ]
    hinges = [
        tj.Hinge(f"hinge {k}", first, second, spring, at=(np.pi / 2, 0.0, k * length))
        for k, (first, second) in enumerate(pairwise(names))
    ]
    return tj.Mechanism(bodies, hinges, fixed=["base"])


def column_load(count=6, force=1.0):
    """Force at the upper end of the column, downward."""
    last = f"link {count - 1}"
    return tj.Load(last, force=(0.0, -force), at=(0.0, 0.5 / count))


def parallel_links(loads, forces=None):
    """Links on rotational springs that buckle independently at the given load factors.

    The load factor times a force acts downward on the upper end of each link, which is
    1 m long; by default 1 N.
    """
    sizes = np.ones(len(loads)) if forces is None else np.asarray(forces, float)
    names = [f"link {k}" for k in range(len(loads))]
    fixed = {"base": ["angle", "x", "y"], **{name: ["x", "y"] for name in names}}
    bodies, hinges, applied = [tj.Body("base")], [], []
    for x, (name, load) in enumerate(zip(names, loads, strict=True)):
        rotation = np.diag([abs(sizes[x]), 0.0, 0.0])
        spring = tj.Quadratic(rotation * load + np.diag([0.0, 1.0, 1.0]), "twist")
        bodies.append(tj.Body(name, pose=(0.0, float(x), 0.0)))
        at = (np.pi / 2, float(x), 0.0)
        hinges.append(tj.Hinge(name, "base", name, spring, at=at))
        applied.append(tj.Load(name, force=(0.0, -sizes[x]), at=(0.0, 1.0)))
    return tj.Mechanism(bodies, hinges, fixed=fixed), applied


def unconnected_trusses(*rises):
    """Trusses of von Mises with the same limit force, and a load on each; m."""
    bodies, hinges, loads = [tj.Body("wall")], [], []
    fixed = {"wall": ["angle", "x", "y"]}
    for k, rise in enumerate(rises):
        name, x = f"apex {k}", 5.0 * k
        stiffness = von_mises_limit_force() / von_mises_limit_force(rise, 1.0)
        apex = np.array([x, rise])
        bodies.append(tj.Body(name, pose=(0.0, x, rise)))
        fixed[name] = ["angle"]
        for side in (-1.0, 1.0):
            foot = np.array([x + side, 0.0])
            hinges.append(bar(f"{name} {side}", "wall", name, foot, apex, stiffness))
        loads.append(tj.Load(name, force=(0.0, -20.0)))
    return tj.Mechanism(bodies, hinges, fixed=fixed), loads
