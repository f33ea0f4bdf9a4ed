"""Twistors against the geometric algebra of the library `clifford`."""

import clifford
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, some_poses

from twistorjax.geometry import se2, twistors as tc


LAYOUT, BLADES = clifford.Cl(3, 1)
E1, E2, PLUS, MINUS = (BLADES[f"e{k}"] for k in (1, 2, 3, 4))
# The points at infinity and at the origin are e and e*, with e . e* = -1; see
# `twistorjax.geometry.twistors`.
INFINITY = -(PLUS + MINUS) / np.sqrt(2)
ORIGIN = (PLUS - MINUS) / np.sqrt(2)


def multivector(twistor):
    sigma, xi, x1, x2 = map(float, twistor)
    return sigma + xi * E1 * E2 + x1 * E1 * INFINITY + x2 * E2 * INFINITY


def homogeneous(point):
    """Return a point of the homogeneous model: equation 2.40 with e . e* = -1."""
    x, y = map(float, point)
    return x * E1 + y * E2 + (x**2 + y**2) / 2 * INFINITY + ORIGIN


def assert_same(actual, expected):
    np.testing.assert_allclose(actual.value, expected.value, atol=1e-12)


def test_the_basis_vectors_and_the_points_are_null_vectors():
    for null in (INFINITY, ORIGIN, homogeneous([0.3, -0.7])):
        assert (null * null).value == pytest.approx(0)
    assert float((INFINITY | ORIGIN)[()]) == pytest.approx(-1)


def test_the_printed_sign_of_the_basis_reverses_translations():
    infinity = -INFINITY  # equation 2.24: e . e* = 1
    translation = 1 + 0.5 * E1 * infinity  # equation 2.155: by 1 along x
    moved = ~translation * ORIGIN * translation
    assert_same(moved, -1 * E1 - 0.5 * infinity + ORIGIN)  # equation 2.40 at x = -1


def test_the_twistor_is_the_exponential_of_half_the_twist():
    for pose in some_poses(0):
        rotation, along, across = map(float, se2.twist(pose))
        bivector = rotation * E1 * E2 + along * E1 * INFINITY + across * E2 * INFINITY
        power, series = 1 + 0 * E1, 1 + 0 * E1
        for k in range(1, 40):
            power = power * bivector / (2 * k)
            series = series + power
        assert_same(multivector(tc.twistor(pose)), series)


def test_product_is_the_geometric_product():
    for first, second in zip(some_poses(0), some_poses(1), strict=True):
        first, second = tc.twistor(first), tc.twistor(second)
        expected = multivector(first) * multivector(second)
        assert_same(multivector(tc.product(first, second)), expected)


def test_conjugate_is_the_reverse_of_the_multivector():
    for pose in some_poses(0):
        twistor = tc.twistor(pose)
        assert_same(multivector(tc.conjugate(twistor)), ~multivector(twistor))


def test_move_is_the_product_with_a_point_of_the_homogeneous_model():
    point = jnp.array([0.3, -0.7])
    for pose in some_poses(0):
        q = multivector(tc.twistor(pose))
        moved = tc.move(tc.twistor(pose), point)
        assert_same(homogeneous(moved), ~q * homogeneous(point) * q)
        assert_close(moved, se2.act(pose, point))


def test_composition_is_the_product_with_the_first_displacement_on_the_left():
    for outer, inner in zip(some_poses(0), some_poses(1), strict=True):
        total = tc.twistor(se2.compose(outer, inner))
        assert_close(tc.product(tc.twistor(inner), tc.twistor(outer)), total)


def test_pose_inverts_twistor_within_a_full_turn():
    poses = some_poses(0)
    assert_close(jax.vmap(lambda pose: tc.pose(tc.twistor(pose)))(poses), poses)


def test_the_twistor_of_the_inverse_pose_is_the_conjugate():
    for pose in some_poses(0):
        inverse = tc.twistor(se2.inverse(pose))
        assert_close(inverse, tc.conjugate(tc.twistor(pose)))


def test_the_three_ways_of_section_2_7_4_agree():
    root = np.sqrt(3)
    rotation = jnp.array([root / 2, 0.5, 0.0, 0.0])
    expected = jnp.array([root / 2, 0.5, root, 1.0])
    rotation_first = tc.product(rotation, jnp.array([1.0, 0.0, 1.0, root]))
    translation_first = tc.product(jnp.array([1.0, 0.0, 2.0, 0.0]), rotation)
    about_the_pole = tc.twistor(jnp.array([np.pi / 3, 2.0, 2 * root]))
    for twistor in (rotation_first, translation_first, about_the_pole):
        assert_close(twistor, expected)
    assert_close(se2.pole(tc.pose(expected)), jnp.array([-2.0, 2 * root]))


def test_the_printed_order_of_equation_2_159_does_not_give_its_printed_value():
    root = np.sqrt(3)
    printed = (1 + E1 * INFINITY + root * E2 * INFINITY) * (root / 2 + E1 * E2 / 2)
    assert_same(printed, multivector([root / 2, 0.5, 0.0, 2.0]))


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_half_angle_cos_sin_has_the_derivatives_of_cosine_and_sine(order):
    angle = jnp.array(0.8)
    values = jnp.cos(angle / 2), jnp.sin(angle / 2)

    def reused(angle):
        return jnp.stack(tc.half_angle_cos_sin(angle, *values))

    def computed(angle):
        return jnp.stack([jnp.cos(angle / 2), jnp.sin(angle / 2)])

    for _ in range(order):
        reused, computed = jax.jacfwd(reused), jax.jacfwd(computed)
    assert_close(reused(angle), computed(angle), digits=15)


def test_a_displacement_has_the_twist_and_the_twistor_of_its_pose():
    for pose in some_poses(0):
        displacement = tc.Displacement.from_pose(pose)
        assert_close(displacement.twist(), se2.twist(pose))
        assert_close(displacement.strain()[1:] / 2, tc.twistor(pose)[2:])
