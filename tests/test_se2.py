"""Poses and twists against matrices, mpmath and the examples of the dissertation."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.linalg
from helpers import assert_close, for_each, some_poses, some_stiffness

from twistorjax.geometry import se2


def matrix(pose):
    """Return the homogeneous matrix of a pose, equation 5.1."""
    angle, x, y = np.asarray(pose)
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])


def wedge(twist):
    """Return the matrix of a twist in the Lie algebra."""
    rotation, along, across = np.asarray(twist)
    return np.array([[0, -rotation, along], [rotation, 0, across], [0, 0, 0]])


def unwedge(matrix):
    """Return the twist of a matrix in the Lie algebra."""
    return np.array([matrix[1, 0], matrix[0, 2], matrix[1, 2]])


def precise_twist(angle, x, y):
    """Return the logarithm of a pose, computed with a hundred digits."""
    with mpmath.workdps(100):
        half = mpmath.mpf(angle) / 2
        along = x * mpmath.cos(half) + y * mpmath.sin(half)
        across = y * mpmath.cos(half) - x * mpmath.sin(half)
        factor = half / mpmath.sin(half) if half else mpmath.mpf(1)
        return angle, factor * along, factor * across


def matrices(poses):
    return np.array([matrix(pose) for pose in poses])


def test_compose_is_the_product_of_matrices():
    outer, inner = some_poses(0), some_poses(1)
    composed = for_each(se2.compose, outer, inner)
    assert_close(matrices(composed), matrices(outer) @ matrices(inner), digits=14)


def test_angles_are_not_wrapped():
    assert se2.compose(jnp.array([6.0, 0, 0]), jnp.array([5.0, 0, 0]))[0] == 11.0


def test_the_product_with_the_inverse_is_the_identity():
    products = for_each(lambda pose: se2.compose(se2.inverse(pose), pose), some_poses(0))
    assert_close(products, np.zeros((64, 3)), digits=14)


def test_between_is_the_second_pose_relative_to_the_first():
    first, second = some_poses(0), some_poses(1)
    expected = np.linalg.inv(matrices(first)) @ matrices(second)
    assert_close(matrices(for_each(se2.between, first, second)), expected, digits=13)


def test_act_is_the_product_of_matrix_and_point():
    poses, points = some_poses(2), np.broadcast_to([0.3, -0.7], (64, 2))
    expected = (matrices(poses) @ [0.3, -0.7, 1])[:, :2]
    assert_close(for_each(se2.act, poses, points), expected, digits=14)


def test_exp_is_the_matrix_exponential():
    twists = some_poses(0)
    expected = [scipy.linalg.expm(wedge(twist)) for twist in twists]
    assert_close(matrices(for_each(se2.exp, twists)), expected, digits=13)


def test_twist_inverts_exp_within_a_full_turn():
    twists = some_poses(0)
    recovered = for_each(lambda twist: se2.twist(se2.exp(twist)), twists)
    assert_close(recovered, twists, digits=13)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.7, 2.0, np.pi, -3.0, 6.0, 6.28])
def test_the_twist_is_accurate_to_rounding(angle):
    expected = [float(value) for value in precise_twist(angle, 0.4, -1.1)]
    actual = se2.twist(jnp.array([angle, 0.4, -1.1]))
    # Near a full turn the chord is short, and its relative error is large.
    chord = 1.0 if abs(angle) < 4 else abs(np.sin(angle / 2))
    scale = np.abs(expected).max()
    np.testing.assert_allclose(actual, expected, rtol=0, atol=2e-15 * scale / chord)


def derivatives(function, orders):
    """Return a program of the derivatives of a function, from the value to an order."""
    functions = [function]
    for _ in range(orders):
        functions.append(jax.grad(functions[-1]))
    return jax.jit(lambda x: [function(x) for function in functions])


derivatives_of_twist = derivatives(
    lambda angle: se2.twist(jnp.stack([angle, 0.4, -1.1]))[2], 3
)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.9, 1.9999999, 2.0, np.pi, 5.5])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_derivatives_of_the_twist_are_accurate_to_rounding(angle, order):
    actual = derivatives_of_twist(angle)[order]
    with mpmath.workdps(100):
        near = angle if abs(angle) > 1e-3 else angle + mpmath.mpf(10) ** -25
        expected = mpmath.diff(
            lambda a: precise_twist(a, mpmath.mpf("0.4"), mpmath.mpf("-1.1"))[2],
            mpmath.mpf(near), order, h=mpmath.mpf(10) ** -12,
        )  # fmt: skip
    np.testing.assert_allclose(actual, float(expected), rtol=2e-11, atol=1e-15)


derivatives_of_sinc = derivatives(se2.sinc, 3)


@pytest.mark.parametrize("x", [0.0, 1e-9, 1e-4, 0.5, 0.9999999, 1.0, 1.5, 3.1])
def test_sinc_and_its_derivatives_are_accurate_to_rounding(x):
    for order, actual in enumerate(derivatives_of_sinc(x)):
        with mpmath.workdps(40):
            expected = mpmath.nsum(
                lambda n, k=order: (
                    mpmath.mpf(-1) ** n
                    * mpmath.ff(2 * n, k)
                    * (mpmath.mpf(x) ** (2 * n - k) if 2 * n >= k else 0)
                    / mpmath.factorial(2 * n + 1)
                ),
                [0, 30],
            )
        assert abs(float(actual) - float(expected)) < 2e-15


def test_the_twist_of_example_2_1():
    angle = jnp.arccos(0.866)  # rounded as in the text
    assert_close(se2.twist(jnp.stack([angle, *jnp.array([2.0, 1.0])]))[1:],
                 [2.2159, 0.4534], digits=4)  # fmt: skip


def test_the_pole_of_example_2_1():
    pole = se2.pole(jnp.array([jnp.pi / 6, 2.0, 1.0]))
    assert_close(pole, [1 - 1 / (2 * np.tan(np.pi / 12)), 0.5 + 1 / np.tan(np.pi / 12)])


def test_the_displacement_of_example_2_2():
    pose = se2.exp(jnp.pi / 4 * jnp.ones(3))
    assert_close(pose, [np.pi / 4, np.sqrt(2) - 1, 1.0])


def test_the_pole_is_the_fixed_point_of_a_displacement():
    poses = some_poses(3)[1:]
    poles = for_each(se2.pole, poses)
    scale = 1 + np.abs(poles).max(axis=1, keepdims=True)
    assert_close(for_each(se2.act, poses, poles) / scale, poles / scale, digits=13)


def test_the_pole_of_a_translation_is_infinite():
    assert np.all(np.isinf(se2.pole(jnp.array([0.0, 1.0, 2.0]))))
    assert np.all(np.isinf(se2.pole(jnp.zeros(3))))


def test_the_adjoint_is_conjugation():
    poses, twists = some_poses(0), some_poses(1)
    adjoints = for_each(se2.adjoint, poses)
    for pose, twist, adjoint in zip(poses, twists, adjoints, strict=True):
        transformed = matrix(pose) @ wedge(twist) @ np.linalg.inv(matrix(pose))
        assert_close(adjoint @ twist, unwedge(transformed), digits=13)


def test_the_adjoint_of_equation_3_23():
    pose = jnp.array([0.4, 1.0, 2.0])
    expected = np.block([[1, np.zeros((1, 2))], [np.array([[2.0], [-1.0]]), np.eye(2)]])
    expected[1:, 1:] = matrix(pose)[:2, :2]
    assert_close(se2.adjoint(pose), expected)


def test_power_does_not_depend_on_the_frame_of_reference():
    wrench, twists = np.array([0.7, -1.3, 2.1]), some_poses(1)

    def power(pose, twist):
        return se2.transform_wrench(pose, wrench) @ (se2.adjoint(pose) @ twist)

    assert_close(for_each(power, some_poses(0), twists), twists @ wrench)


def test_wrenches_are_transformed_by_equation_3_60():
    pose = jnp.array([0.4, 1.0, 2.0])
    rotation = matrix(pose)[:2, :2]
    expected = np.eye(3)
    expected[0, 1:] = np.array([-2.0, 1.0]) @ rotation
    expected[1:, 1:] = rotation
    wrench = jnp.array([0.7, -1.3, 2.1])
    assert_close(se2.transform_wrench(pose, wrench), expected @ wrench)


def test_the_transformed_stiffness_gives_the_transformed_wrench():
    stiffness = some_stiffness(0)

    def actual_and_expected(pose, twist):
        moved = se2.transform_stiffness(pose, stiffness) @ (se2.adjoint(pose) @ twist)
        return jnp.stack([moved, se2.transform_wrench(pose, stiffness @ twist)])

    wrenches = for_each(actual_and_expected, some_poses(0), some_poses(1))
    assert_close(wrenches[:, 0], wrenches[:, 1], digits=11)
