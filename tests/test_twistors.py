"""Twistors against the geometric algebra of the library `clifford`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, for_each, some_poses
from numba.core import config

from twistorjax.geometry import se2, twistors as tc


# Numba would take two seconds to compile a few products of short arrays.
with pytest.MonkeyPatch.context() as monkeypatch:
    monkeypatch.setattr(config, "DISABLE_JIT", 1)
    import clifford

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


def twistors_of(poses):
    return for_each(tc.twistor, poses)


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
    poses = some_poses(0, 16)
    twists = for_each(se2.twist, poses)
    for (rotation, along, across), twistor in zip(
        twists, twistors_of(poses), strict=True
    ):
        bivector = rotation * E1 * E2 + along * E1 * INFINITY + across * E2 * INFINITY
        power, series = 1 + 0 * E1, 1 + 0 * E1
        for k in range(1, 40):
            power = power * bivector / (2 * k)
            series = series + power
        assert_same(multivector(twistor), series)


def test_product_is_the_geometric_product():
    first, second = twistors_of(some_poses(0)), twistors_of(some_poses(1))
    products = for_each(tc.product, first, second)
    for a, b, product in zip(first, second, products, strict=True):
        assert_same(multivector(product), multivector(a) * multivector(b))


def test_conjugate_is_the_reverse_of_the_multivector():
    twistors = twistors_of(some_poses(0))
    for twistor, conjugate in zip(
        twistors, for_each(tc.conjugate, twistors), strict=True
    ):
        assert_same(multivector(conjugate), ~multivector(twistor))


def test_move_is_the_product_with_a_point_of_the_homogeneous_model():
    point = np.array([0.3, -0.7])
    poses = some_poses(0)
    points, twistors = np.broadcast_to(point, (64, 2)), twistors_of(poses)
    moved = for_each(tc.move, twistors, points)
    for twistor, moved_point in zip(twistors, moved, strict=True):
        q = multivector(twistor)
        assert_same(homogeneous(moved_point), ~q * homogeneous(point) * q)
    assert_close(moved, for_each(se2.act, poses, points))


def test_composition_is_the_product_with_the_first_displacement_on_the_left():
    outer, inner = some_poses(0), some_poses(1)
    products = for_each(tc.product, twistors_of(inner), twistors_of(outer))
    assert_close(products, twistors_of(for_each(se2.compose, outer, inner)))


def test_pose_inverts_twistor_within_a_full_turn():
    poses = some_poses(0)
    assert_close(for_each(tc.pose, twistors_of(poses)), poses)


def test_the_twistor_of_the_inverse_pose_is_the_conjugate():
    poses = some_poses(0)
    inverses = twistors_of(for_each(se2.inverse, poses))
    assert_close(inverses, for_each(tc.conjugate, twistors_of(poses)))


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
    derivatives = jax.jit(lambda angle: (reused(angle), computed(angle)))(angle)
    assert_close(*derivatives, digits=15)


def test_a_displacement_has_the_twist_and_the_twistor_of_its_pose():
    def strain(pose):
        displacement = tc.Displacement.from_pose(pose)
        return jnp.stack([displacement.twist(), displacement.strain()])

    poses = some_poses(0)
    strains = for_each(strain, poses)
    assert_close(strains[:, 0], for_each(se2.twist, poses))
    assert_close(strains[:, 1, 1:] / 2, twistors_of(poses)[:, 2:])
