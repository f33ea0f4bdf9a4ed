"""Curved beams against closed forms, Castigliano's theorem and integration with SciPy."""

import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from helpers import assert_close, mostly_slow

import twistorjax as tj
from twistorjax.energies.validity import WithValidityRange


# A square section with sides of 1 m has the bending stiffness E I = 100 N m^2.
with warnings.catch_warnings():
    warnings.filterwarnings("ignore", "`modulus` is 1200 Pa")
    SOFT = tj.Material(modulus=1200.0, poisson=0.3)
LENGTH, STIFFNESS = 10.0, 100.0
ROUND = 2 * np.pi / LENGTH  # curvature of a beam whose ends meet; 1/m


def curved(curvature, **settings):
    """Return a beam with a square section."""
    settings = {"thickness": 1.0, "width": 1.0, "steps": 12, **settings}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "`length` is 10 m")
        return tj.flexures.Beam(SOFT, length=LENGTH, curvature=curvature, **settings)


def linear(coefficients, position):
    """Return a curvature that changes linearly along the axis; 1/m."""
    return coefficients[0] + coefficients[1] * position


def arc(position):
    """Return the curvature of an arc of 1.2 rad; 1/m."""
    return linear([1.2 / LENGTH, 0.0], position)


def hook(position):
    """Return a curvature that grows along the axis from zero to that of a circle; 1/m."""
    return linear([np.pi / LENGTH / 2, np.pi / LENGTH**2], position)


def sheared(offset, slope, **settings):
    """Return a beam with shear deformation; all of them share compiled programs."""
    curvature = jax.tree_util.Partial(linear, jnp.array([offset, slope]))
    return curved(curvature, shear_factor=2 / 3, **settings)


ARC = sheared(1.2 / LENGTH, 0.0)
HOOK = sheared(np.pi / LENGTH / 2, np.pi / LENGTH**2)


def along_axis(rates, start, curvature):
    """Integrate the angle and position of the undeformed axis, and other quantities.

    Args:
        rates: Function of (position, angle, x, y) that returns the rates of others.
        start: Values of these in the middle of the beam.
        curvature: Curvature of the beam; 1/m.

    Returns:
        Angle, x, y and the others at the two ends; rad, m, m.
    """

    def rate(position, state):
        angle, x, y = state[:3]
        of_axis = [curvature(position), np.cos(angle), np.sin(angle)]
        return np.concatenate([of_axis, rates(position, angle, x, y)])

    state = np.concatenate([np.zeros(3), start])
    return [
        scipy.integrate.solve_ivp(
            rate, (0.0, end), state, method="DOP853", rtol=1e-11, atol=1e-13
        ).y[:, -1]
        for end in (-LENGTH / 2, LENGTH / 2)
    ]


def castigliano(curvature, shear_factor):
    """Return the compliance of the second end of a curved beam, in its middle frame.

    The complementary energy is the integral of the squares of moment, axial force and
    shear force over twice their stiffnesses.
    """
    shear = shear_factor * 1200.0 / 2.6

    def rates(position, angle, x, y):
        cos, sin = np.cos(angle), np.sin(angle)
        moment = np.array([1.0, y, -x])
        axial, across = np.array([0.0, cos, sin]), np.array([0.0, -sin, cos])
        of_unit_wrenches = (
            np.outer(moment, moment) / STIFFNESS
            + np.outer(axial, axial) / 1200.0
            + np.outer(across, across) / shear
        )
        return of_unit_wrenches.ravel()

    first, second = along_axis(rates, np.zeros(9), curvature)
    return (second - first)[3:].reshape(3, 3)


def integrated(curvature, shear_factor, load):
    """Return the pose of frame b under a load (moment, fx, fy), by SciPy; rad, m, m.

    The load is about the origin of frame a and in its axes; N m, N, N.
    """
    first, second = along_axis(lambda *_: np.zeros(0), np.zeros(0), curvature)
    moment, fx, fy = load

    def rate(position, state):
        angle, x, y = state
        cos, sin = np.cos(angle), np.sin(angle)
        stretch = 1 + (cos * fx + sin * fy) / 1200.0
        shear = (cos * fy - sin * fx) / (shear_factor * 1200.0 / 2.6)
        bending = (moment - x * fy + y * fx) / STIFFNESS
        return [
            curvature(position) + bending,
            cos * stretch - sin * shear,
            sin * stretch + cos * shear,
        ]

    span = (-LENGTH / 2, LENGTH / 2)
    solution = scipy.integrate.solve_ivp(
        rate, span, first, method="DOP853", rtol=1e-11, atol=1e-12
    )
    angle, x, y = solution.y[:, -1]
    turn = angle - second[0]
    cos, sin = np.cos(turn), np.sin(turn)
    to_end = np.array([[cos, -sin], [sin, cos]]) @ second[1:]
    return np.array([turn, x - to_end[0], y - to_end[1]])


def some_loads(count, rotation, force):
    """Return random loads whose moment alone causes a rotation up to the given one."""
    rng = np.random.default_rng(7)
    moment = rotation * STIFFNESS / LENGTH * rng.uniform(-1, 1, count)
    size, direction = force * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 7, count)
    return np.stack([moment, size * np.cos(direction), size * np.sin(direction)], axis=1)


@pytest.fixture(scope="module")
def under_loads():
    """Compute the states of a beam under several loads."""

    @jax.jit
    def solve(beam, loads):
        return jax.vmap(lambda load: tj.flexures.beam_under_load(beam, load))(loads)

    return lambda beam, loads: solve(beam, jnp.asarray(loads))


@functools.cache
def surrogate(name):
    """Surrogate of a symmetric or of an asymmetric curved beam."""
    beam = {"arc": ARC, "hook": HOOK}[name]
    return tj.flexures.surrogate(beam, rotation=0.8, force=3.0, order=6)


def test_a_moment_unrolls_a_circular_cantilever(under_loads, validated):
    """Its curvature changes by M / E I, from a circle to a half circle and a line."""
    ring = curved(ROUND, shear_factor=None)
    moments = np.pi * np.array([0.0, -10.0, -20.0])
    loads = np.stack([moments, 0 * moments, 0 * moments], axis=1)
    solution = under_loads(ring, loads)
    line = np.asarray(solution.centerline)
    angle, offset = line[:, 0, 0], line[:, -1, 1:] - line[:, 0, 1:]
    cos, sin = np.cos(angle), np.sin(angle)
    tip = np.stack(
        [
            cos * offset[:, 0] + sin * offset[:, 1],
            cos * offset[:, 1] - sin * offset[:, 0],
        ],
        axis=1,
    )
    exact = np.array([[0.0, 0.0], [0.0, 20 / np.pi], [10.0, 0.0]])
    assert_close(tip, exact, digits=10)
    assert_close(solution.energy, moments**2 * LENGTH / STIFFNESS / 2, digits=10)
    what = "tip of a circular cantilever that a moment unrolls to a line"
    validated("Exact beams", what, tip, exact, "the closed form")


@pytest.mark.parametrize("name", ["arc", "hook"])
def test_a_curved_beam_has_the_compliance_of_castigliano(name, under_loads):
    beam, curvature = {"arc": (ARC, arc), "hook": (HOOK, hook)}[name]
    expected = castigliano(curvature, 2 / 3)
    step = 1e-5
    solution = under_loads(beam, step * np.concatenate([np.eye(3), -np.eye(3)]))
    pose = np.asarray(solution.pose)
    found = (pose[:3] - pose[3:]).T / (2 * step)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9)
    assert abs(expected[0, 1]) > 0.1 * np.sqrt(expected[0, 0] * expected[1, 1])
    assert (abs(expected[1, 2]) > 1e-3) == (name == "hook")


@pytest.mark.parametrize("name", mostly_slow(["hook", "arc"]))
def test_the_surrogate_of_a_curved_beam_has_the_compliance_of_castigliano(name):
    energy, curvature = surrogate(name).energy, {"arc": arc, "hook": hook}[name]
    stiffness = jax.jit(lambda: energy.tangent_stiffness())()
    expected = castigliano(curvature, 2 / 3)
    np.testing.assert_allclose(np.linalg.inv(stiffness), expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(("beam", "curvature"), [(ARC, arc), (HOOK, hook)])
def test_a_curved_beam_under_large_loads_is_the_one_integrated_by_scipy(
    beam, curvature, under_loads
):
    loads = some_loads(6, rotation=2.0, force=8.0)
    exact = np.array([integrated(curvature, 2 / 3, load) for load in loads])
    assert np.abs(exact[:, 0]).max() > 1.5
    solution = under_loads(beam, loads)
    np.testing.assert_allclose(solution.pose, exact, rtol=1e-7, atol=1e-8)
    turn, x, y = exact.T
    moment = loads[:, 0] - x * loads[:, 2] + y * loads[:, 1]
    cos, sin = np.cos(turn), np.sin(turn)
    wrench = [moment, cos * loads[:, 1] + sin * loads[:, 2],
              cos * loads[:, 2] - sin * loads[:, 1]]  # fmt: skip
    np.testing.assert_allclose(solution.wrench.T, wrench, rtol=1e-6, atol=1e-7)


def test_a_number_and_a_constant_function_are_the_same_curvature(under_loads):
    loads = some_loads(3, rotation=1.0, force=4.0)
    number = under_loads(curved(1.2 / LENGTH, shear_factor=2 / 3), loads)
    function = under_loads(ARC, loads)
    straight = under_loads(sheared(0.0, 0.0), loads)
    without = under_loads(curved(None, shear_factor=2 / 3), loads)
    for first, second in ((number, function), (straight, without)):
        for field in ("pose", "wrench", "energy", "centerline", "stress"):
            found, expected = getattr(first, field), getattr(second, field)
            np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


def test_the_mirror_image_of_a_curved_beam_has_mirrored_wrenches(under_loads):
    """The mirror is axis 1; it reverses moments, transverse forces and rotations."""
    mirror = np.array([[-1.0, 1.0, -1.0]])
    loads = some_loads(3, rotation=1.0, force=4.0)
    solution = under_loads(HOOK, loads)
    image = sheared(-np.pi / LENGTH / 2, -np.pi / LENGTH**2)
    mirrored = under_loads(image, mirror * loads)
    for field in ("pose", "wrench"):
        found, expected = getattr(mirrored, field), getattr(solution, field)
        assert_close(found, mirror * expected, digits=11)
    assert_close(mirrored.energy, solution.energy, digits=11)
    assert_close(mirrored.stress, np.asarray(solution.stress)[..., ::-1], digits=9)


def test_the_load_of_a_curved_beam_is_found_at_its_pose(under_loads):
    loads = some_loads(4, rotation=1.0, force=4.0)
    expected = under_loads(HOOK, loads)
    at_pose = jax.jit(jax.vmap(lambda pose: tj.flexures.beam_at_pose(HOOK, pose)))
    found = at_pose(expected.pose)
    np.testing.assert_allclose(found.wrench, expected.wrench, atol=1e-7)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-8)


@pytest.mark.parametrize("name", mostly_slow(["hook", "arc"]))
def test_the_surrogate_of_a_curved_beam_has_its_wrenches(name, under_loads):
    """The poses are those of random loads, which are not used in the fit."""
    energy = surrogate(name)
    assert isinstance(energy, WithValidityRange) and np.max(energy.error) < 1e-4
    solution = under_loads({"arc": ARC, "hook": HOOK}[name], some_loads(60, 0.6, 2.9))
    inside = np.abs(np.asarray(solution.pose)[:, 0]) < 0.8
    assert inside.sum() > 30
    found = jax.jit(jax.vmap(energy.energy.wrench))(solution.pose)
    exact = np.asarray(solution.wrench)[inside]
    difference = np.asarray(found)[inside] - exact
    rms = np.sqrt(np.mean(exact**2, axis=0))
    assert np.all(np.sqrt(np.mean(difference**2, axis=0)) < 1e-4 * rms)
    assert np.all(np.abs(difference) < 1e-3 * rms)


@pytest.mark.parametrize("curvature", [None, 1.2 / LENGTH])
def test_the_bending_factor_scales_the_bending_stiffness_only(curvature, under_loads):
    """A moment rotates 1 / 1.5 as far; the difference of compliances is of bending."""
    step = 1e-5
    found = []
    for factor in (1.0, 1.5, 1e9):
        beam = curved(curvature, shear_factor=2 / 3, bending_factor=factor)
        found.append(np.asarray(under_loads(beam, step * np.eye(3)).pose).T / step)
        rotational = beam.rotational_stiffness
        assert_close(rotational, factor * STIFFNESS / LENGTH, digits=14)
    once, stiffer, rigid = found
    bending = once - rigid
    np.testing.assert_allclose(bending / 1.5, stiffer - rigid, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(stiffer[0, 0], once[0, 0] / 1.5, rtol=1e-5)
    if curvature is None:
        assert_close(stiffer[1, 1], LENGTH / 1200.0, digits=8)
        assert_close(once[1, 1], LENGTH / 1200.0, digits=8)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"curvature": 0.1, "law": "saint-venant-kirchhoff"},
            "`law` is 'saint-venant-kirchhoff', but a curved beam has the law "
            '"linear" only',
        ),
        ({"curvature": np.nan}, "`curvature` is nan, but must be finite"),
        ({"curvature": np.inf}, "`curvature` is inf, but must be finite"),
        ({"curvature": 0.1, "bending_factor": 0.0}, "`bending_factor` is 0, but must be"),
        ({"curvature": None, "bending_factor": -1.0}, "`bending_factor` is -1, but must"),
    ],
)
def test_an_invalid_curvature_or_factor_raises_an_error(settings, message):
    with pytest.raises(ValueError) as error:
        curved(**settings)
    assert message in str(error.value)
