"""A hinge between two bodies: balance, invariance, and exact derivatives."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    assert_close,
    for_each,
    mostly_slow,
    some_poses,
    some_stiffness,
    with_value,
)

import twistorjax as tj
from twistorjax.assembly import kinematics
from twistorjax.geometry import se2, twistors


class Quartic(tj.AbstractEnergy):
    """A general energy that couples all components of the twist."""

    def stored_energy(self, displacement):
        angle, along, across = displacement.twist()
        return angle**2 + along**2 + across**2 + angle**2 * along + angle * across**3


QUADRATIC = [tj.Quadratic(some_stiffness(7), "twist"), tj.Quadratic(some_stiffness(7))]
ENERGIES = dict(
    zip(["twist", "twistor", "quartic"], [*QUADRATIC, Quartic()], strict=True)
)
every_energy = pytest.mark.parametrize("energy", ENERGIES.values(), ids=ENERGIES)
every_name = pytest.mark.parametrize("name", ENERGIES)

REFERENCE = np.array([[0.4, 0.1, -0.2], [-0.7, 0.5, 0.3]])
AT = np.array([0.9, 0.3, 0.2])


def two_bodies(energy, at=AT, first="a", second="b", damping=None):
    """Return two bodies that one hinge connects."""
    bodies = [tj.Body("a", REFERENCE[0]), tj.Body("b", REFERENCE[1])]
    hinge = tj.Hinge("h", first, second, energy, at, damping=damping)
    return tj.Mechanism(bodies, [hinge], fixed=["a"])


def random_states(seed, count=24):
    """Return random poses of both bodies, some with angles where formulas may fail."""
    return np.stack([some_poses(seed, count), some_poses(seed + 1, count) / 2], axis=1)


@functools.cache
def forces_and_derivatives(name):
    """Return quantities of a mechanism in random states, by one program."""
    mechanism = two_bodies(ENERGIES[name])

    @jax.jit
    @jax.vmap
    def quantities(poses):
        return {
            "wrenches": mechanism.wrenches(poses),
            "stiffness": mechanism.stiffness(poses),
            "gradient": jax.grad(mechanism.energy)(poses),
            "hessian": jax.hessian(mechanism.energy)(poses),
        }

    return {key: np.asarray(value) for key, value in quantities(random_states(0)).items()}


@eqx.filter_jit
def energies(mechanism, states):
    """Return the energy in each of several states."""
    return jax.vmap(mechanism.energy)(states)


def frames(poses):
    """Return both frames of the hinge in the world, which move with their bodies."""
    return [
        se2.compose(pose, se2.between(reference, AT))
        for pose, reference in zip(poses, REFERENCE, strict=True)
    ]


@every_energy
def test_energy_is_that_of_the_relative_pose_of_both_frames(energy):
    """The frames are composed as in section 5.1 of the dissertation."""
    states = random_states(0)
    expected = for_each(lambda poses: energy(se2.between(*frames(poses))), states)
    assert_close(energies(two_bodies(energy), states), expected, digits=10)


@every_name
def test_forces_are_the_gradient_of_the_energy(name):
    found = forces_and_derivatives(name)
    assert_close(-found["wrenches"], found["gradient"], digits=10)


@every_name
def test_stiffness_is_the_hessian_of_the_energy(name):
    found = forces_and_derivatives(name)
    scale = np.max(np.abs(found["hessian"]))
    assert_close(found["stiffness"] / scale, found["hessian"] / scale, digits=12)


@every_energy
def test_energy_does_not_depend_on_the_frame_of_the_observer(energy):
    states, mechanism = random_states(0), two_bodies(energy)
    compose = jax.vmap(se2.compose, (None, 0))
    observed = for_each(compose, some_poses(3, 24), states)
    assert_close(energies(mechanism, observed), energies(mechanism, states), digits=10)


@pytest.mark.parametrize("energy", QUADRATIC, ids=["twist", "twistor"])
def test_even_energy_does_not_depend_on_the_order_of_the_bodies(energy):
    states, exchanged = random_states(0), two_bodies(energy, first="b", second="a")
    expected = energies(two_bodies(energy), states)
    assert_close(energies(exchanged, states), expected, digits=11)


@every_name
def test_wrenches_on_both_bodies_balance(name):
    states, wrenches = random_states(0), forces_and_derivatives(name)["wrenches"]
    (_, x, y), (moment, force_x, force_y) = np.moveaxis(
        np.stack([states, wrenches]), -1, 1
    )
    about_origin = np.stack([moment + x * force_y - y * force_x, force_x, force_y], -1)
    scale = 1 + np.abs(wrenches[:, 1]).max(axis=1, keepdims=True)
    assert_close(about_origin.sum(axis=1) / scale, np.zeros((24, 3)), digits=13)


@every_name
def test_wrench_on_body_b_is_the_transformed_wrench_of_the_energy(name):
    def on_body_b(poses):
        a, b = frames(poses)
        by_body_b = se2.transform_wrench(b, ENERGIES[name].wrench(se2.between(a, b)))
        origin = poses[1].at[0].set(0.0)
        return se2.transform_wrench(se2.inverse(origin), -by_body_b)

    expected = for_each(on_body_b, random_states(0))
    assert_close(forces_and_derivatives(name)["wrenches"][:, 1], expected, digits=9)


def test_energy_of_tiny_displacements_is_accurate():
    """A pose of meters cannot represent a displacement of a picometer."""
    far = np.array([0.0, 5.0, 7.0])
    mechanism = two_bodies(tj.Quadratic(np.eye(3)), at=far)
    displacements = jnp.array([[0.0, 0.0, 0.0], [1e-13, 1e-12, -2e-12]])
    arm = far[1:] - REFERENCE[1, 1:]
    x, y = 1e-12 - 1e-13 * arm[1], -2e-12 + 1e-13 * arm[0]
    energy = eqx.filter_jit(mechanism.hinge_assembly.energy)(displacements)
    np.testing.assert_allclose(energy, (1e-13**2 + x**2 + y**2) / 2, rtol=1e-11)


@pytest.mark.parametrize(
    "energy",
    mostly_slow([*QUADRATIC[::-1], Quartic()]),
    ids=["twistor", "twist", "quartic"],
)
def test_wrenches_have_third_derivatives(energy):
    mechanism = two_bodies(energy)
    poses = random_states(0)[8]
    direction = np.array([[0.3, -0.1, 0.2], [0.5, 0.4, -0.6]])

    def moment(step):
        return mechanism.wrenches(poses + step * direction)[1, 0]

    second = with_value(jax.jacfwd(jax.jacfwd(moment)))
    derivatives = jax.jit(jax.jacfwd(second, has_aux=True))
    (_, behind), (third, _), (_, ahead) = map(derivatives, (-1e-4, 0.0, 1e-4))
    difference = (float(ahead) - float(behind)) / 2e-4
    assert_close(float(third) / difference, 1.0, digits=6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"first": "a", "second": "a", "at": AT}, "connects the body 'a' to itself"),
        ({}, "needs either `at`.*neither is given"),
        ({"at": AT, "ports": (AT, AT)}, "needs either `at`.*both are given"),
        (
            {"at": (1.0, 2.0)},
            r"`at` of the hinge 'h' has shape \(2,\), but must be \(an",
        ),
        ({"at": (0.0, np.nan, 0.0)}, "`at` of the hinge 'h' has .*, but must be finite"),
    ],
)
def test_invalid_arguments_of_a_hinge_are_reported(arguments, message):
    arguments = {"first": "a", "second": "b", "energy": Quartic(), **arguments}
    with pytest.raises(ValueError, match=message):
        tj.Hinge("h", **arguments)


def test_displacement_in_the_mid_frame_is_the_twistor():
    """Products of half angles agree with the Clifford parameters of the relative pose."""

    def end(pose):
        angle, x, y = pose
        cos, sin, zero = jnp.cos(angle / 2), jnp.sin(angle / 2), jnp.zeros(())
        return kinematics.End(angle, x, y, cos, sin, zero, zero)

    def displacement(first, second):
        axis = kinematics.Axis(jnp.ones(()), jnp.zeros(()))
        at = kinematics.mid_frame(end(first), end(second), axis).displacement
        return jnp.stack([at.sigma, at.xi, at.x1, at.x2])

    def twistor(first, second):
        return twistors.twistor(se2.between(first, second))

    poses = some_poses(5)[7:], some_poses(6)[7:]
    assert_close(for_each(displacement, *poses), for_each(twistor, *poses))


@pytest.mark.parametrize(
    ("energy", "coordinates"),
    [
        pytest.param(Quartic(), "twist", id="quartic-twist"),
        pytest.param(QUADRATIC[1], "twistor", id="twistor-twistor"),
        *(
            pytest.param(energy, coordinates, marks=pytest.mark.slow)
            for energy, coordinates in (
                (Quartic(), "twistor"),
                (QUADRATIC[0], "twist"),
                (QUADRATIC[0], "twistor"),
                (QUADRATIC[1], "twist"),
            )
        ),
    ],
)
def test_tangent_in_motion_is_the_derivative_of_the_forces(energy, coordinates):
    """Derivatives with respect to displacements and rates, with a full damping matrix."""
    damping = tj.energies.ViscousDamping(some_stiffness(5), coordinates)
    hinge_assembly = two_bodies(energy, damping=damping).hinge_assembly
    dofs = tuple(range(6))

    def forces(displacements, rates):
        return hinge_assembly.forces_in_motion(displacements, rates)[0]

    @jax.jit
    @jax.vmap
    def computed_and_expected(displacements, rates):
        tangent = hinge_assembly.tangent_in_motion(displacements, rates, dofs)
        expected = jax.jacfwd(forces, argnums=(0, 1))(displacements, rates)
        return (tangent.stiffness, tangent.damping), expected

    displacements = 0.4 * random_states(0, 8) - 0.4 * REFERENCE
    computed, expected = computed_and_expected(displacements, random_states(5, 8))
    for matrices, derivatives in zip(computed, expected, strict=True):
        derivatives = np.reshape(derivatives, (8, 6, 6))
        scale = np.abs(derivatives).max(axis=(1, 2), keepdims=True)
        assert_close(matrices / scale, derivatives / scale, digits=11)


@pytest.mark.parametrize("coordinates", ["twist", "twistor"])
def test_viscous_forces_dissipate_the_power_of_the_viscous_wrench(coordinates):
    """Equations 3.62 to 3.66; the power is that of the forces on both bodies."""
    damping = tj.energies.ViscousDamping(some_stiffness(5), coordinates)
    no_spring = tj.Quadratic(np.zeros((3, 3)))
    hinge_assembly = two_bodies(no_spring, damping=damping).hinge_assembly

    def relative_pose(poses):
        return se2.between(*frames(poses))

    @jax.jit
    @jax.vmap
    def powers(poses, rates):
        forces, _, (power, _) = hinge_assembly.forces_in_motion(poses - REFERENCE, rates)
        pose, pose_rate = jax.jvp(relative_pose, (poses,), (rates,))
        return power, jnp.sum(forces * rates), 2 * damping(pose, pose_rate)

    power, of_forces, of_wrench = powers(random_states(0, 8), random_states(5, 8))
    assert_close(power, of_forces, digits=10)
    assert_close(power, of_wrench, digits=10)
