"""Quadratic energies, sums and dampings: closed forms of the dissertation, mechanics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from helpers import assert_close, for_each, some_poses, some_stiffness

import twistorjax as tj
from twistorjax.energies.base import validation_error
from twistorjax.geometry import se2, twistors


STIFFNESS = some_stiffness(7)
DAMPING = some_stiffness(8)

twist = tj.Quadratic(STIFFNESS, "twist")
twistor = tj.Quadratic(STIFFNESS, "twistor")
both = twist + 0.5 * twistor
every_energy = pytest.mark.parametrize(
    "energy", [twist, twistor, both], ids=["twist", "twistor", "sum"]
)
every_coordinates = pytest.mark.parametrize("coordinates", ["twist", "twistor"])


def lambda_matrix(vector, sign=-1):
    """Matrix of equation 4.27 of a twistor; with the other sign, that of 4.42."""
    sigma, xi, x1, x2 = vector
    return np.array(
        [
            [sigma, -sign * x2, sign * x1],
            [0, sigma, -sign * xi],
            [0, sign * xi, sigma],
        ]
    )


def gamma_matrix(twist):
    """Matrix of equation 3.47, with 1 - rho = angle (1 + cos angle) / (2 sin angle)."""
    angle, t1, t2 = twist
    if angle == 0:
        rho_by_angle, half_cot = 0.0, 1.0
    else:
        half_cot = angle * (1 + np.cos(angle)) / (2 * np.sin(angle))
        rho_by_angle = (1 - half_cot) / angle
    gamma = np.eye(3)
    gamma[1:, 1:] = [[half_cot, -angle / 2], [angle / 2, half_cot]]
    gamma[1:, 0] = [rho_by_angle * t1 + t2 / 2, rho_by_angle * t2 - t1 / 2]
    return gamma


def ordinary_poses(seed):
    """Poses at which the formulas of the dissertation are accurate."""
    poses = some_poses(seed, 16)
    poses[:, 0] = np.linspace(-2.9, 2.9, 16)
    return poses


def test_energy_of_the_twist_is_that_of_equation_3_4():
    poses = some_poses(0)
    expected = [t @ STIFFNESS @ t / 2 for t in for_each(se2.twist, poses)]
    assert_close(for_each(twist, poses), expected)


def test_energy_of_the_twistor_is_that_of_equation_4_7():
    poses = some_poses(0)
    vectors = for_each(twistors.twistor, poses)[:, 1:]
    expected = [2 * vector @ STIFFNESS @ vector for vector in vectors]
    assert_close(for_each(twistor, poses), expected)


def test_wrench_of_the_twistor_is_that_of_equation_4_35():
    poses = some_poses(0)
    expected = [
        2 * lambda_matrix(vector) @ STIFFNESS @ vector[1:]
        for vector in for_each(twistors.twistor, poses)
    ]
    assert_close(for_each(twistor.wrench, poses), expected)


def test_wrench_of_the_twist_is_that_of_equation_3_53():
    poses = ordinary_poses(0)
    twists = for_each(se2.twist, poses)
    expected = [gamma_matrix(t).T @ STIFFNESS @ t for t in twists]
    assert_close(for_each(twist.wrench, poses), expected, digits=10)


def test_gamma_is_the_inverse_right_jacobian_of_the_group():
    for angle, t1, t2 in ordinary_poses(0):
        ad = np.array([[0, 0, 0], [t2, 0, -angle], [-t1, angle, 0]])
        # (1 - exp(-ad)) / ad, from the matrix exponential of SciPy
        block = scipy.linalg.expm(np.block([[-ad, np.eye(3)], [np.zeros((3, 6))]]))
        right = block[:3, 3:]
        assert_close(gamma_matrix((angle, t1, t2)), np.linalg.inv(right), digits=10)


def test_damping_wrench_is_that_of_equation_4_40():
    velocity_a, velocity_b = np.array([0.3, -0.2, 0.9]), np.array([-0.5, 0.1, 0.4])
    damping = tj.energies.ViscousDamping(DAMPING)
    poses, expected = some_poses(1), []
    for vector in for_each(twistors.twistor, poses):
        forward, backward = lambda_matrix(vector), lambda_matrix(vector, sign=1)
        rate = forward.T @ velocity_b / 2 - backward.T @ velocity_a / 2  # equation 4.41
        expected.append(2 * forward @ DAMPING @ rate)

    velocities = np.broadcast_to([velocity_a, velocity_b], (64, 2, 3))
    wrenches = for_each(damping.wrench, poses, velocities[:, 0], velocities[:, 1])
    assert_close(wrenches, expected)


def test_damping_of_the_twist_rate_is_transformed_by_gamma():
    velocity_b = np.array([-0.5, 0.1, 0.4])
    damping = tj.energies.ViscousDamping(DAMPING, "twist")
    poses = ordinary_poses(1)
    gammas = [gamma_matrix(t) for t in for_each(se2.twist, poses)]
    expected = [gamma.T @ DAMPING @ gamma @ velocity_b for gamma in gammas]
    velocities = np.broadcast_to([np.zeros(3), velocity_b], (16, 2, 3))
    wrenches = for_each(damping.wrench, poses, velocities[:, 0], velocities[:, 1])
    assert_close(wrenches, expected, digits=10)


@every_coordinates
def test_damping_wrench_vanishes_in_a_rigid_body_motion_of_both_bodies(coordinates):
    damping = tj.energies.ViscousDamping(DAMPING, coordinates)

    def wrench(pose, velocity_a):
        velocity_b = se2.adjoint(se2.inverse(pose)) @ velocity_a
        return damping.wrench(pose, velocity_a, velocity_b)

    wrenches = for_each(wrench, some_poses(1), some_poses(2))
    assert_close(wrenches, np.zeros((64, 3)), digits=10)


@every_coordinates
def test_dissipated_power_is_positive(coordinates):
    damping = tj.energies.ViscousDamping(DAMPING, coordinates)

    def power(pose, velocity_b):
        return damping.wrench(pose, jnp.zeros(3), velocity_b) @ velocity_b

    assert np.all(for_each(power, some_poses(1)[1:], some_poses(2)[1:]) > 0)


def test_a_pose_may_be_a_list_and_has_three_numbers():
    energy = tj.Quadratic(np.diag([2.0, 300.0, 40.0]), "twist")
    pose = [0.2, 1e-3, 0.05]
    assert_close(energy.wrench(pose), energy.wrench(jnp.array(pose)), digits=15)
    assert_close((energy * 3)(pose), 3 * energy(pose), digits=12)
    with pytest.raises(ValueError, match=r"`pose` has shape .* three numbers"):
        energy.tangent_stiffness([0.1, 0.2])


@every_energy
def test_energy_does_not_change_if_its_frames_are_exchanged(energy):
    poses = some_poses(0)
    exchanged = for_each(lambda pose: energy(se2.inverse(pose)), poses)
    assert_close(exchanged, for_each(energy, poses))


@every_coordinates
def test_energy_does_not_depend_on_the_choice_of_frames(coordinates):
    """New frames on the same bodies, with the stiffness transformed to them."""

    def transformed(pose, frame):
        # the new frames have the same pose in frame a and in frame b
        new_pose = se2.compose(se2.compose(se2.inverse(frame), pose), frame)
        stiffness = se2.adjoint(frame).T @ STIFFNESS @ se2.adjoint(frame)
        return tj.Quadratic((stiffness + stiffness.T) / 2, coordinates)(new_pose)

    poses = some_poses(0)
    expected = for_each(tj.Quadratic(STIFFNESS, coordinates), poses)
    assert_close(for_each(transformed, poses, some_poses(1)), expected, digits=10)


@every_energy
def test_reference_stiffness_is_the_given_stiffness(energy):
    factor = 1.5 if energy is both else 1.0
    assert_close(energy.tangent_stiffness(), factor * STIFFNESS, digits=14)


@every_energy
def test_wrench_is_the_derivative_along_displacements_fixed_to_b(energy):
    step = 1e-5
    steps = step * np.concatenate([np.eye(3), -np.eye(3)])

    def energies(pose):
        moved = jax.vmap(lambda twist: se2.compose(pose, se2.exp(twist)))(steps)
        return jax.vmap(energy)(moved)

    poses = some_poses(0)[4:20]
    ahead, behind = np.split(for_each(energies, poses), 2, axis=1)
    differences = (ahead - behind) / (2 * step)
    assert_close(for_each(energy.wrench, poses), differences, digits=6)


@every_energy
@pytest.mark.parametrize("angle", [np.pi / 3, np.pi / 2])
def test_work_on_a_closed_path_of_displacements_is_zero(energy, angle):
    """The work is integrated by Gauss-Legendre quadrature."""
    corners = np.array(
        [
            [angle, 1.0, 0.0],
            [angle, -0.5, 1.0],
            [-angle, -0.7, -0.3],
            [-angle, 0.9, -0.8],
        ]
    )
    nodes, weights = np.polynomial.legendre.leggauss(40)

    def power_at(pose, rate):
        velocity_b = jnp.concatenate([rate[:1], se2.rotate(-pose[0], rate[1:])])
        return energy.wrench(pose) @ velocity_b

    rates = np.repeat(np.roll(corners, -1, axis=0) - corners, 40, axis=0)
    poses = np.repeat(corners, 40, axis=0) + np.tile(nodes + 1, 4)[:, None] / 2 * rates
    power = for_each(power_at, poses, rates).reshape(4, 40)
    work = np.sum(power @ weights) / 2
    exchanged = np.sum(np.abs(power) @ weights) / 2
    stored = np.max(for_each(energy, corners))
    assert abs(work) < 1e-12 * stored
    assert exchanged > stored  # the path is not one of zero power


def test_energies_of_twist_and_twistor_differ_in_fourth_order():
    poses = np.array([[1e-2], [1e-3]]) * [1.0, 0.3, -0.2]
    differences = abs(for_each(twist, poses) - for_each(twistor, poses))
    assert 3.9 < np.log10(differences[0] / differences[1]) < 4.1


def test_moment_of_a_twistor_energy_vanishes_after_half_a_turn():
    half_turn = jnp.array([np.pi, 0.0, 0.0])
    spring = tj.Quadratic(np.eye(3))
    assert abs(np.asarray(spring.wrench(half_turn))[0]) < 1e-15
    spring_of_twist = tj.Quadratic(np.eye(3), "twist")
    assert_close(np.asarray(spring_of_twist.wrench(half_turn))[0], np.pi)


def test_energies_and_wrenches_of_sums_and_multiples_add_up():
    pose = jnp.array([0.3, 0.1, -0.2])
    energies = [twist + twistor + 2.0 * twist, twist, twistor]
    total, first, second = (np.asarray(energy(pose)) for energy in energies)
    assert_close(total, 3 * first + second)
    total, first, second = (np.asarray(energy.wrench(pose)) for energy in energies)
    assert_close(total, 3 * first + second)


@pytest.mark.untyped
@pytest.mark.parametrize("kind", [tj.Quadratic, tj.energies.ViscousDamping])
@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(2), r"has shape \(2, 2\), but must be 3 by 3"),
        ([[1, 1e-3, 0], [0, 1, 0], [0, 0, 1]], "is not symmetric"),
        ([[1, 2, 0], [2, 1, 0], [0, 0, 1]], "has a negative eigenvalue"),
        ([[np.nan, 0, 0], [0, 1, 0], [0, 0, 1]], "is not finite"),
    ],
)
def test_invalid_matrix_raises_an_error(kind, matrix, message):
    with pytest.raises(ValueError, match=message):
        kind(np.array(matrix, float))


def test_singular_stiffness_and_rounding_errors_are_accepted():
    tj.Quadratic(np.array([[1.0, 1, 0], [1, 1, 0], [0, 0, 0]]))
    tj.Quadratic(np.diag([1.0, 1e9, 1e7]) + 1e-12 * np.eye(3, k=1))


@pytest.mark.untyped
def test_unknown_coordinates_raise_an_error():
    with pytest.raises(ValueError, match="`coordinates` is 'screw', but must be one of"):
        tj.Quadratic(np.eye(3), "screw")  # pyright: ignore[reportArgumentType]


def test_negative_factor_is_a_validation_error():
    error = validation_error((-1.0) * twist)
    assert error is not None and "not negative" in error
    assert validation_error(2.0 * twist) is None


def test_only_energies_can_be_added_and_only_numbers_multiply_them():
    with pytest.raises(TypeError, match="unsupported operand"):
        _ = twist + 1.0  # pyright: ignore[reportOperatorIssue]
    with pytest.raises(ValueError, match=r"an array of shape \(2,\), but the factor"):
        _ = jnp.ones(2) * twist
