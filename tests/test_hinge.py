"""A hinge between two bodies: balance, indifference, and exact derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, some_poses, some_stiffness

import twistorjax as tj
from twistorjax.geometry import se2
from twistorjax.mechanism import hinge_kinematics


pytestmark = pytest.mark.slow


class Quartic(tj.AbstractEnergy):
    """An energy of no special form, with every coupling."""

    def stored_energy(self, displacement):
        turn, along, across = displacement.twist()
        return turn**2 + along**2 + across**2 + turn**2 * along + turn * across**3


QUADRATIC = [tj.Quadratic(some_stiffness(7), "twist"), tj.Quadratic(some_stiffness(7))]
every_energy = pytest.mark.parametrize(
    "energy", [*QUADRATIC, Quartic()], ids=["twist", "twistor", "quartic"]
)

REST = jnp.array([[0.4, 0.1, -0.2], [-0.7, 0.5, 0.3]])
AT = jnp.array([0.9, 0.3, 0.2])


def pair(energy, at=AT, reference=REST, first="a", second="b"):
    bodies = [tj.Body("a", reference[0]), tj.Body("b", reference[1])]
    return tj.Mechanism(bodies, [tj.Hinge("h", first, second, energy, at)], fixed=["a"])


def states(seed, count=24):
    """Poses of both bodies; those at which charts break are those of the hinge."""
    return jnp.stack([some_poses(seed, count), some_poses(seed + 1, count) / 2], axis=1)


def frames(poses):
    """Both frames of the hinge in the world, carried along by their bodies."""
    return [
        se2.compose(pose, se2.between(reference, AT))
        for pose, reference in zip(poses, REST, strict=True)
    ]


@every_energy
def test_stores_the_energy_of_its_relative_pose(energy):
    """By composing frames, as section 5.1 does."""
    mechanism = pair(energy)
    for poses in states(0):
        a, b = frames(poses)
        assert_close(mechanism.energy(poses), energy(se2.between(a, b)), digits=10)


@every_energy
def test_the_forces_are_the_slope_of_the_energy(energy):
    mechanism = pair(energy)
    slope = jax.jit(jax.vmap(jax.grad(mechanism.energy)))(states(0))
    assert_close(-jax.vmap(mechanism.wrenches)(states(0)), slope, digits=10)


@every_energy
def test_the_stiffness_is_the_slope_of_the_forces(energy):
    mechanism = pair(energy)
    slope = jax.jit(jax.vmap(jax.hessian(mechanism.energy)))(states(0))
    stiffness = jax.vmap(mechanism.stiffness)(states(0))
    scale = jnp.max(jnp.abs(slope))
    assert_close(stiffness / scale, slope / scale, digits=12)


@every_energy
def test_does_not_feel_where_the_observer_stands(energy):
    mechanism = pair(energy)
    for poses, moved in zip(states(0), some_poses(3, 24), strict=True):
        elsewhere = jax.vmap(se2.compose, (None, 0))(moved, poses)
        assert_close(mechanism.energy(elsewhere), mechanism.energy(poses), digits=10)


@pytest.mark.parametrize("energy", QUADRATIC, ids=["twist", "twistor"])
def test_does_not_feel_which_body_is_called_first(energy):
    """As no energy does that is even in the displacement."""
    mechanism, turned = pair(energy), pair(energy, first="b", second="a")
    for poses in states(0):
        assert_close(turned.energy(poses), mechanism.energy(poses), digits=11)


@every_energy
def test_wrenches_on_the_two_bodies_balance(energy):
    mechanism = pair(energy)
    for poses in states(0):
        on_a, on_b = mechanism.wrenches(poses)
        at_origin = [
            se2.transform_wrench(pose.at[0].set(0.0), wrench)
            for pose, wrench in zip(poses, (on_a, on_b), strict=True)
        ]
        scale = 1 + np.abs(on_b).max()
        assert_close(sum(at_origin) / scale, np.zeros(3), digits=13)


@every_energy
def test_the_wrench_on_b_is_that_of_the_energy_carried_to_the_body(energy):
    mechanism = pair(energy)
    for poses in states(0):
        a, b = frames(poses)
        in_world = se2.transform_wrench(b, energy.wrench(se2.between(a, b)))  # by body B
        at_body = se2.transform_wrench(se2.inverse(poses[1].at[0].set(0.0)), -in_world)
        assert_close(mechanism.wrenches(poses)[1], at_body, digits=9)


def test_tiny_displacements_lose_no_digits():
    """A picometre at a hinge that lies metres away; sums of poses would round it off."""
    far = jnp.array([0.0, 5.0, 7.0])
    mechanism = pair(tj.Quadratic(jnp.eye(3)), at=far)
    hinge_assembly = mechanism.hinge_assembly
    tiny = jnp.array([[0.0, 0.0, 0.0], [1e-13, 1e-12, -2e-12]])
    lever = far[1:] - REST[1, 1:]
    moved = [1e-12 - 1e-13 * lever[1], -2e-12 + 1e-13 * lever[0]]
    expected = (1e-13**2 + moved[0] ** 2 + moved[1] ** 2) / 2
    np.testing.assert_allclose(hinge_assembly.energy(tiny), expected, rtol=1e-11)


@every_energy
def test_has_derivatives_of_third_order(energy):
    mechanism = pair(energy)
    poses = states(0)[8]

    def along(step):
        direction = jnp.array([[0.3, -0.1, 0.2], [0.5, 0.4, -0.6]])
        return mechanism.wrenches(poses + step * direction)[1, 0]

    second = jax.jit(jax.jacfwd(jax.jacfwd(along)))
    step = 1e-4
    expected = (second(jnp.array(step)) - second(jnp.array(-step))) / (2 * step)
    actual = jax.jit(jax.jacfwd(second))(jnp.array(0.0))
    assert_close(actual / expected, 1.0, digits=6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"first": "a", "second": "a", "at": AT}, "joins the body 'a' to itself"),
        ({}, "needs either `at`.*neither is given"),
        ({"at": AT, "ports": (AT, AT)}, "needs either `at`.*both are given"),
        (
            {"at": (1.0, 2.0)},
            r"`at` of the hinge 'h' has shape \(2,\), but must be \(an",
        ),
        ({"at": (0.0, np.nan, 0.0)}, "`at` of the hinge 'h' is .*, but must be finite"),
    ],
)
def test_refuses_what_is_no_hinge(arguments, message):
    arguments = {"first": "a", "second": "b", "energy": Quartic(), **arguments}
    with pytest.raises(ValueError, match=message):
        tj.Hinge("h", **arguments)


def test_the_frame_half_way_is_that_of_the_twistor():
    """By products of half angles, against the pose's own Clifford parameters."""
    first, second = some_poses(5)[9], some_poses(6)[9]

    def end(pose):
        half = pose[0] / 2
        zero = jnp.zeros(())
        return hinge_kinematics.End(*pose, jnp.cos(half), jnp.sin(half), zero, zero)

    half = hinge_kinematics.mid_frame(
        end(first), end(second), (jnp.ones(()), jnp.zeros(()))
    )
    seen = half.displacement
    actual = jnp.stack([seen.sigma, seen.xi, seen.x1, seen.x2])
    assert_close(actual, tj.geometry.twistors.twistor(se2.between(first, second)))


@pytest.mark.parametrize("coordinates", ["twist", "twistor"])
@every_energy
def test_the_tangent_of_a_moving_hinge_is_the_slope_of_its_forces(energy, coordinates):
    """With a damping of every coupling, by displacements and by their rates."""
    damping = tj.energies.ViscousDamping(some_stiffness(5), coordinates)
    hinge = tj.Hinge("h", "a", "b", energy, AT, damping=damping)
    bodies = [tj.Body("a", REST[0]), tj.Body("b", REST[1])]
    hinge_assembly = tj.Mechanism(bodies, [hinge], fixed=["a"]).hinge_assembly
    every = tuple(range(6))
    for place, rate in zip(0.4 * states(0, 8), states(5, 8), strict=True):
        place = place - 0.4 * REST

        def forces(place, rate):
            return hinge_assembly.forces_in_motion(place, rate)[0]

        found = hinge_assembly.tangent_in_motion(place, rate, every)
        slopes = jax.jacfwd(forces, argnums=(0, 1))(place, rate)
        for mine, slope in zip((found.stiffness, found.damping), slopes, strict=True):
            scale = jnp.max(jnp.abs(slope))
            assert_close(mine / scale, slope.reshape(6, 6) / scale, digits=11)


@pytest.mark.parametrize("coordinates", ["twist", "twistor"])
def test_drag_is_the_viscous_wrench_and_takes_its_power(coordinates):
    """Equations 3.62 to 3.66, carried to the bodies; the power is that of the forces."""
    damping = tj.energies.ViscousDamping(some_stiffness(5), coordinates)
    none = tj.Quadratic(jnp.zeros((3, 3)))
    hinge = tj.Hinge("h", "a", "b", none, AT, damping=damping)
    bodies = [tj.Body("a", REST[0]), tj.Body("b", REST[1])]
    hinge_assembly = tj.Mechanism(bodies, [hinge], fixed=["a"]).hinge_assembly
    for poses, rates in zip(states(0, 8), states(5, 8), strict=True):
        drag, _, power = hinge_assembly.forces_in_motion(poses - REST, rates)
        assert_close(power, jnp.sum(drag * rates), digits=10)

        def apart(poses):
            return se2.between(*frames(poses))

        pose, rate = jax.jvp(apart, (poses,), (rates,))
        assert_close(power, 2 * damping(pose, rate), digits=10)
