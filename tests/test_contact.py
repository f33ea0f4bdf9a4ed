"""Contact energies, and how the solvers pass a gap that closes."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, mostly_slow
from path_helpers import bars_of_a_truss, truss_of, von_mises_limit_force

import twistorjax as tj
from twistorjax.geometry.twistors import Displacement


GAP, STIFFNESS, SMOOTHING, SPRING = 1e-3, 1e6, 1e-6, 100.0


def block(direction: Any = "+x", gap=GAP, smoothing=SMOOTHING, size=0.0):
    """Return a block on a spring, and a stop that limits one of its displacements.

    The size is the distance from the middle of the block to the spring; m.
    """
    stop = tj.energies.Stop(direction, gap=gap, stiffness=STIFFNESS, smoothing=smoothing)
    spring = tj.Quadratic(np.diag([SPRING, SPRING, SPRING])) + stop
    hinge = tj.Hinge("h", "wall", "block", spring, at=(0, 0, 0))
    return tj.Mechanism(
        [tj.Body("wall"), tj.Body("block", (0, size, 0))], [hinge], ["wall"]
    )


def displacement(force, smoothing=SMOOTHING):
    """Solve the equation of a spring and a contact in series of cases; m."""
    if force <= SPRING * GAP:
        return force / SPRING
    # SPRING (GAP + d) + STIFFNESS d^2 / (2 e) = force
    a, b, c = STIFFNESS / (2 * smoothing), SPRING, SPRING * GAP - force
    depth = 2 * -c / (b + np.sqrt(b * b - 4 * a * c))
    if depth > smoothing:
        depth = (force - SPRING * GAP + STIFFNESS * smoothing / 2) / (SPRING + STIFFNESS)
    return GAP + depth


@pytest.mark.parametrize("force", [0.05, 0.1, 0.1 + 1e-7, 0.3, 10.0])
@pytest.mark.parametrize("direction", mostly_slow(["+x", "-x", "+y", "-y"]))
def test_a_gap_closes_in_few_steps(force, direction):
    sign, axis = float(direction[0] + "1"), 1 + "xy".index(direction[1])
    push = np.eye(3)[axis] * sign * force
    load = tj.Load("block", force=tuple(push[1:]))
    found = tj.equilibrium(block(direction), loads=[load])
    assert_close(sign * found.displacement("block")[axis] / displacement(force), 1.0)
    assert found.steps < 12


@pytest.mark.parametrize("sign", [1, -1])
def test_a_stop_limits_the_angle(sign):
    mechanism = block(f"{'+' if sign > 0 else '-'}angle", smoothing=1e-6)
    found = tj.equilibrium(mechanism, loads=[tj.Load("block", moment=sign * 5.0)])
    angle = sign * found.displacement("block")[0]
    resisting = SPRING * np.sin(angle) + STIFFNESS * (angle - GAP - 0.5e-6)
    assert_close(resisting / 5.0, 1.0, digits=9)


def test_stiffness_at_the_smoothing_length_is_whole():
    """This also holds for the force inside a program with a constant stop."""
    smoothing = 2.0**-19
    stop = tj.energies.Stop("+x", gap=0.0, stiffness=STIFFNESS, smoothing=smoothing)
    pose = jnp.array([0.0, smoothing, 0.0])
    assert_close(jax.hessian(stop)(pose)[1, 1] / STIFFNESS, 1.0)
    mechanism = block(gap=1e-4, smoothing=2e-6)

    @jax.jit
    def reaction(x):
        drives = [tj.Drive("block", x=x)]
        return tj.equilibrium(mechanism, drives=drives).reaction("block")[1]

    x = 1e-4 + 2e-6
    assert_close(reaction(x) / (SPRING * x + STIFFNESS * 1e-6), 1.0, digits=9)


def test_force_and_stiffness_of_a_contact_are_continuous():
    stop = tj.energies.Stop("-y", gap=GAP, stiffness=STIFFNESS, smoothing=SMOOTHING)

    def energy(depth):
        pose = jnp.stack([0.0, 0.0, -GAP - depth])
        return stop.stored_energy(Displacement.from_pose(pose))

    at = jnp.array([-0.5, 0.0, 0.3, 1.0, 4.0]) * SMOOTHING
    forces = jax.vmap(jax.grad(energy))(at)
    assert_close(forces / (STIFFNESS * SMOOTHING), [0, 0, 0.045, 0.5, 3.5])
    stiffness = jax.vmap(jax.grad(jax.grad(energy)))(at)
    assert_close(stiffness / STIFFNESS, [0, 0, 0.3, 1.0, 1.0])
    assert_close(energy(4 * SMOOTHING) / (STIFFNESS * SMOOTHING**2), 8 - 2 + 1 / 6)


def test_a_closed_contact_moves_with_its_gap():
    def end(gap):
        load = tj.Load("block", force=(10.0, 0.0))
        return tj.equilibrium(block(gap=gap), loads=[load]).displacement("block")[1]

    assert_close(jax.grad(end)(GAP), STIFFNESS / (STIFFNESS + SPRING))


def test_a_corner_rests_on_an_inclined_edge():
    """The force is perpendicular to the edge, and the block turns about nothing."""
    slope, force = 0.3, 5.0
    tangent = np.array([np.cos(slope), np.sin(slope)])
    contact = tj.energies.CornerContact(
        (0.02, -0.01), (0.5 * tangent, -0.5 * tangent), stiffness=1e5, smoothing=1e-7
    )
    normal = np.array([-np.sin(slope), np.cos(slope)])
    guide = tj.Quadratic(np.diag([1e4, 1e3, 1e3])) + contact
    at = (0.0, 0.0, 0.0)
    hinge = tj.Hinge("h", "ramp", "block", guide, at)
    bodies = [tj.Body("ramp"), tj.Body("block")]
    mechanism = tj.Mechanism(
        bodies, [hinge], fixed={"ramp": ["angle", "x", "y"], "block": ["angle"]}
    )
    load = tj.Load("block", force=tuple(-force * normal))
    found = tj.equilibrium(mechanism, loads=[load])
    x, y = np.asarray(found.displacement("block"))[1:]
    depth = -normal @ np.array([0.02 + x, -0.01 + y])
    resisting = 1e5 * (depth - 0.5e-7) * normal - 1e3 * np.array([x, y])
    assert depth > 1e-6
    assert_close(resisting / force, normal, digits=9)
    assert found.steps < 30


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"direction": "x"}, "`direction` is 'x', but must be one of"),
        ({"stiffness": 0.0}, "`stiffness` is 0, but must be positive"),
        ({"smoothing": -1.0}, "`smoothing` is -1, but must be positive"),
        ({"gap": np.nan}, "`gap` is nan"),
    ],
)
@pytest.mark.untyped
def test_values_of_a_stop_are_checked(settings, message):
    values = {"direction": "+x", "gap": GAP, "stiffness": 1.0, "smoothing": 1.0}
    direction, rest = (values | settings).pop("direction"), values | settings
    del rest["direction"]
    with pytest.raises(ValueError, match=message):
        tj.energies.Stop(direction, **rest)


def test_an_edge_needs_two_points():
    with pytest.raises(ValueError, match="two points that coincide"):
        tj.energies.CornerContact((0, 0), ((1, 1), (1, 1)), stiffness=1.0, smoothing=1.0)


def test_a_path_goes_on_after_a_gap_has_closed():
    load = tj.Load("block", force=(10.0, 0.0))
    found = tj.path(block(size=2 * GAP), loads=[load], max_points=60)
    forces = 10.0 * np.asarray(found.load_factors)
    expected = [displacement(force) for force in forces]
    assert forces[-1] == 10.0
    assert_close(found.displacements[:, 1, 1] / GAP, np.array(expected) / GAP, digits=8)


def lattice(size, **settings):
    """Return compressed squares, and the loads that compress them until they touch."""
    damping = tj.energies.ViscousDamping(np.diag([2e-5, 20.0, 2.0]))
    cell = tj.lattices.rotating_squares(
        tj.Quadratic(np.diag([1.5e-3, 1.2e5, 1.2e3])), pitch=15e-3, angle=0.6, mass=1e-3,
        damping=damping, stop_stiffness=0.2, stop_smoothing=0.02,
    )  # fmt: skip
    squares = tj.lattices.repeat(cell, (size, size))
    top = squares.border("top")
    fixed = {name: ["angle", "x", "y"] for name in squares.border("bottom")}
    fixed |= {name: ["angle", "x"] for name in top}
    mechanism = tj.Mechanism(squares.bodies, squares.hinges, fixed=fixed)
    return mechanism, [tj.Load(name, force=(0.0, -4.0)) for name in top]


@pytest.mark.slow
@pytest.mark.parametrize("size", [2, 3])
def test_a_compressed_lattice_with_contact_is_the_end_of_its_damped_motion(size):
    mechanism, loads = lattice(size)
    static = tj.equilibrium(mechanism, loads=loads)
    assert static.steps < 30
    motion = tj.simulate(mechanism, [0.0, 1.0], loads=loads, energies=False)
    assert_close(motion.displacements[-1], static.displacements, digits=6)
    turned = np.abs(np.asarray(static.displacements)[:, 0])
    assert turned.max() > np.pi / 4 - 0.6  # some squares touch


def test_a_stop_does_not_hide_that_a_mechanism_snaps_through():
    """The truss would rest on the stop below, but it does not get there by equilibria."""
    hinges = bars_of_a_truss()
    stop = tj.energies.Stop("-y", gap=0.7, stiffness=1e3, smoothing=1e-2)
    hinges.append(tj.Hinge("stop", "wall", "apex", stop, at=(0, 0, 0.3)))
    load = tj.Load("apex", force=(0.0, -1.1 * von_mises_limit_force()))
    found = tj.equilibrium(truss_of(hinges), loads=[load], throw=False)
    assert not found.succeeded
    assert_close(found.fraction, 1 / 1.1, digits=2)
