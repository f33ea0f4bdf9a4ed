"""Energies against the dissertation's closed forms and against mechanics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from helpers import assert_close, some_poses, some_stiffness

import twistorjax as tj
from twistorjax.geometry import se2, twistors


pytestmark = pytest.mark.slow


STIFFNESS = some_stiffness(7)
DAMPING = some_stiffness(8)

twist = tj.Quadratic(STIFFNESS, "twist")
twistor = tj.Quadratic(STIFFNESS, "twistor")
both = twist + 0.5 * twistor
every_energy = pytest.mark.parametrize(
    "energy", [twist, twistor, both], ids=["twist", "twistor", "sum"]
)
every_coordinates = pytest.mark.parametrize("coordinates", ["twist", "twistor"])


def lambda_matrix(pose, sign=-1):
    """Equation 4.27; with the other sign, 4.42."""
    sigma, xi, x1, x2 = np.asarray(twistors.twistor(pose))
    return np.array(
        [
            [sigma, -sign * x2, sign * x1],
            [0, sigma, -sign * xi],
            [0, sign * xi, sigma],
        ]
    )


def gamma_matrix(pose):
    """Equation 3.47, from (1 - rho) = angle (1 + cos angle) / (2 sin angle)."""
    angle, t1, t2 = np.asarray(se2.twist(pose))
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
    """Poses at which the dissertation's own formulas keep their digits."""
    angles = jnp.linspace(-2.9, 2.9, 16)
    return some_poses(seed, 16).at[:, 0].set(angles)


def test_the_energy_of_the_twist_is_that_of_equation_3_4():
    for pose in some_poses(0):
        twist_of_pose = np.asarray(se2.twist(pose))
        assert_close(twist(pose), twist_of_pose @ STIFFNESS @ twist_of_pose / 2)


def test_the_energy_of_the_twistor_is_that_of_equation_4_7():
    for pose in some_poses(0):
        vector = np.asarray(twistors.twistor(pose))[1:]
        assert_close(twistor(pose), 2 * vector @ STIFFNESS @ vector)


def test_the_wrench_of_the_twistor_is_that_of_equation_4_35():
    for pose in some_poses(0):
        vector = np.asarray(twistors.twistor(pose))[1:]
        expected = 2 * lambda_matrix(pose) @ STIFFNESS @ vector
        assert_close(twistor.wrench(pose), expected)


def test_the_wrench_of_the_twist_is_that_of_equation_3_53():
    for pose in ordinary_poses(0):
        expected = gamma_matrix(pose).T @ STIFFNESS @ np.asarray(se2.twist(pose))
        assert_close(twist.wrench(pose), expected, digits=10)


def test_gamma_is_the_inverse_right_jacobian_of_the_group():
    for pose in ordinary_poses(0):
        angle, t1, t2 = np.asarray(se2.twist(pose))
        small = np.array([[0, 0, 0], [t2, 0, -angle], [-t1, angle, 0]])
        # ad / (1 - exp(-ad)), the exponential by SciPy, for a generic angle
        right = np.zeros((3, 3))
        block = scipy.linalg.expm(np.block([[-small, np.eye(3)], [np.zeros((3, 6))]]))
        right = block[:3, 3:]
        assert_close(gamma_matrix(pose), np.linalg.inv(right), digits=10)


def test_the_damping_wrench_is_that_of_equation_4_40():
    first, second = jnp.array([0.3, -0.2, 0.9]), jnp.array([-0.5, 0.1, 0.4])
    for pose in some_poses(1):
        forward, backward = lambda_matrix(pose), lambda_matrix(pose, sign=1)
        rate = forward.T @ second / 2 - backward.T @ first / 2  # equation 4.41
        expected = 2 * forward @ DAMPING @ rate
        assert_close(
            tj.energies.ViscousDamping(DAMPING).wrench(pose, first, second), expected
        )


def test_the_damping_wrench_in_the_twist_is_gamma_to_gamma():
    still, moving = jnp.zeros(3), jnp.array([-0.5, 0.1, 0.4])
    for pose in ordinary_poses(1):
        gamma = gamma_matrix(pose)
        expected = gamma.T @ DAMPING @ gamma @ np.asarray(moving)
        actual = tj.energies.ViscousDamping(DAMPING, "twist").wrench(pose, still, moving)
        assert_close(actual, expected, digits=10)


@every_coordinates
def test_damping_does_not_feel_a_common_motion(coordinates):
    """Both frames carried along by one velocity of the world."""
    viscous = tj.energies.ViscousDamping(DAMPING, coordinates)
    for pose, velocity in zip(some_poses(1), some_poses(2), strict=True):
        of_b = se2.adjoint(se2.inverse(pose)) @ velocity
        assert_close(viscous.wrench(pose, velocity, of_b), np.zeros(3), digits=10)


@every_coordinates
def test_damping_always_takes_power(coordinates):
    viscous = tj.energies.ViscousDamping(DAMPING, coordinates)
    still = jnp.zeros(3)
    for pose, velocity in zip(some_poses(1)[1:], some_poses(2)[1:], strict=True):
        assert viscous.wrench(pose, still, velocity) @ velocity > 0


@every_energy
def test_is_port_indifferent(energy):
    """Exchanging the two frames leaves the energy as it is."""
    poses = some_poses(0)
    there, back = (
        jax.vmap(energy)(poses),
        jax.vmap(energy)(jax.vmap(se2.inverse)(poses)),
    )
    assert_close(back, there)


@every_coordinates
def test_is_frame_indifferent(coordinates):
    """Other frames on the same bodies, with the stiffness carried along."""
    for pose, moved in zip(some_poses(0), some_poses(1), strict=True):
        # frame a as seen from the new frame a', which is as b is from b'
        inside = se2.compose(se2.compose(se2.inverse(moved), pose), moved)
        stiffness = se2.adjoint(moved).T @ STIFFNESS @ se2.adjoint(moved)
        other = tj.Quadratic((stiffness + stiffness.T) / 2, coordinates)
        assert_close(other(inside), tj.Quadratic(STIFFNESS, coordinates)(pose), digits=10)


@every_energy
def test_has_at_rest_the_stiffness_it_was_given(energy):
    factor = 1.5 if energy is both else 1.0
    assert_close(energy.tangent_stiffness(), factor * STIFFNESS, digits=14)


@every_energy
def test_the_wrench_is_the_slope_of_the_energy_along_fixed_to_b(energy):
    step = 1e-5
    for pose in some_poses(0)[4:20]:
        for k, direction in enumerate(np.eye(3)):
            ahead, behind = (
                energy(se2.compose(pose, se2.exp(jnp.array(sign * step * direction))))
                for sign in (1, -1)
            )
            assert_close(energy.wrench(pose)[k], (ahead - behind) / (2 * step), digits=6)


@every_energy
@pytest.mark.parametrize("turn", [np.pi / 3, np.pi / 2])
def test_a_closed_loop_does_no_work(energy, turn):
    """The wrench along a loop of displacements, integrated by Gauss and Legendre."""
    corners = np.array(
        [[turn, 1.0, 0.0], [turn, -0.5, 1.0], [-turn, -0.7, -0.3], [-turn, 0.9, -0.8]]
    )
    nodes, weights = np.polynomial.legendre.leggauss(40)

    def by_wrench(pose, velocity):
        in_b = jnp.concatenate([velocity[:1], se2._turn(-pose[0], velocity[1:])])
        return energy.wrench(pose) @ in_b

    power = jax.jit(jax.vmap(by_wrench))
    work, exchanged = 0.0, 0.0
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        poses = start + (nodes[:, None] + 1) / 2 * (end - start)
        rates = power(jnp.array(poses), jnp.array(np.broadcast_to(end - start, (40, 3))))
        work += weights @ np.asarray(rates) / 2
        exchanged += weights @ np.abs(np.asarray(rates)) / 2
    stored = max(float(energy(jnp.array(corner))) for corner in corners)
    assert abs(work) < 1e-12 * stored
    assert exchanged > stored  # the loop did meet resistance


def test_twist_and_twistor_part_at_third_order():
    pose = jnp.array([1.0, 0.3, -0.2])
    gaps = [abs(twist(s * pose) - twistor(s * pose)) for s in (1e-2, 1e-3)]
    assert 3.9 < np.log10(gaps[0] / gaps[1]) < 4.1  # of the energy: fourth order


def test_half_a_turn_of_a_twistor_spring_meets_no_moment():
    free = tj.Quadratic(jnp.eye(3))
    assert abs(free.wrench(jnp.array([np.pi, 0.0, 0.0]))[0]) < 1e-15
    wound = tj.Quadratic(jnp.eye(3), "twist")
    assert_close(wound.wrench(jnp.array([np.pi, 0.0, 0.0]))[0], np.pi)


def test_sums_and_multiples_add_up():
    pose = jnp.array([0.3, 0.1, -0.2])
    total = twist + twistor + 2.0 * twist
    assert_close(total(pose), 3 * twist(pose) + twistor(pose))
    assert_close(total.wrench(pose), 3 * twist.wrench(pose) + twistor.wrench(pose))


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
def test_refuses_what_is_no_stiffness(kind, matrix, message):
    with pytest.raises(ValueError, match=message):
        kind(np.array(matrix, float))


def test_accepts_a_stiffness_at_the_edge():
    tj.Quadratic(np.array([[1.0, 1, 0], [1, 1, 0], [0, 0, 0]]))  # no resistance one way
    tj.Quadratic(np.diag([1.0, 1e9, 1e7]) + 1e-12 * np.eye(3, k=1))  # rounding


@pytest.mark.untyped
def test_refuses_unknown_coordinates():
    with pytest.raises(ValueError, match="`coordinates` is 'screw', but must be one of"):
        tj.Quadratic(jnp.eye(3), "screw")


def test_a_negative_factor_is_a_fault():
    assert "not negative" in ((-1.0) * twist).validation_error()
    assert (2.0 * twist).validation_error() is None


def test_only_energies_are_added_and_only_numbers_multiply_them():
    with pytest.raises(TypeError, match="unsupported operand"):
        twist + 1.0
    with pytest.raises(ValueError, match=r"an array of shape \(2,\), but the factor"):
        jnp.ones(2) * twist
