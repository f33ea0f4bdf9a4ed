"""Contours of flexures against integrals and exact beams."""

import itertools
import pathlib
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from helpers import assert_close, for_each, mostly_slow
from test_compilation import count_programs

import twistorjax as tj
from twistorjax import flexures


STEEL = tj.Material(modulus=210e9, poisson=0.3)
LENGTH, WIDTH = 20e-3, 10e-3
RIGHT = np.pi / 2
PAGE = pathlib.Path(__file__).parents[1] / "notebooks" / "manual" / "contours.md"

Sizes = dict[str, Any]

FILLETED = {"length": LENGTH, "thickness": 0.5e-3, "fillet": 2e-3}
NOTCH = {"length": LENGTH, "web": 0.5e-3, "depth": 4e-3}
V_NOTCH = {"length": LENGTH, "web": 0.5e-3, "radius": 5e-3, "angle": RIGHT}
REINFORCED = {
    "length": LENGTH,
    "thickness": 0.5e-3,
    "reinforced_length": 14e-3,
    "reinforced_thickness": 3e-3,
}


# The contours, written down a second time: the thickness at a distance from the middle,
# and the distances at which it has a kink or a step.
def filleted_contour(length, thickness, fillet):
    def contour(x):
        into = max(x - (length / 2 - fillet), 0.0)
        return thickness + 2 * (fillet - np.sqrt(max(fillet**2 - into**2, 0.0)))

    return contour, [length / 2 - fillet]


def elliptical_contour(length, web, depth):
    def contour(x):
        return web + 2 * depth * (1 - np.cos(np.arcsin(min(2 * x / length, 1.0))))

    return contour, []


def parabolic_contour(length, web, depth):
    return lambda x: web + 8 * depth * x**2 / length**2, []


def v_contour(length, web, radius, angle):
    joint = radius * np.cos(angle / 2)
    height = radius * (1 - np.sin(angle / 2))

    def contour(x):
        if x < joint:
            return web + 2 * (radius - np.sqrt(radius**2 - x**2))
        return web + 2 * (height + (x - joint) / np.tan(angle / 2))

    return contour, [joint]


def reinforced_contour(length, thickness, reinforced_length, reinforced_thickness):
    step = reinforced_length / 2
    return lambda x: reinforced_thickness if x < step else thickness, [step]


CONTOURS = {
    "filleted leaf": (
        flexures.filleted_leaf,
        flexures.filleted_leaf_profile,
        filleted_contour,
        FILLETED,
    ),
    "elliptical notch": (
        flexures.elliptical_notch,
        flexures.elliptical_notch_profile,
        elliptical_contour,
        NOTCH,
    ),
    "parabolic notch": (
        flexures.parabolic_notch,
        flexures.power_law_notch_profile,
        parabolic_contour,
        NOTCH,
    ),
    "V-notch": (flexures.v_notch, flexures.v_notch_profile, v_contour, V_NOTCH),
    "reinforced leaf": (
        flexures.reinforced_leaf,
        flexures.reinforced_leaf_profile,
        reinforced_contour,
        REINFORCED,
    ),
}
CASES = pytest.mark.parametrize("name", CONTOURS)
OTHERS = ["elliptical notch", "parabolic notch", "V-notch"]


def integrals(contour, joints, length=LENGTH):
    """Integrate 12 / h^3, 1 / h, and 12 x^2 / h^3 over the length."""
    limits = [0.0, *joints, length / 2]

    def integral(function):
        parts = [
            scipy.integrate.quad(function, low, high, epsabs=0, epsrel=1e-12, limit=400)
            for low, high in itertools.pairwise(limits)
        ]
        return 2 * sum(part[0] for part in parts)

    return np.array(
        [
            integral(lambda x: 12 / contour(x) ** 3),
            integral(lambda x: 1 / contour(x)),
            integral(lambda x: 12 * x**2 / contour(x) ** 3),
        ]
    )


def diagonal(energy):
    assert_close(energy.stiffness, np.diag(np.diagonal(energy.stiffness)))
    return np.diagonal(energy.stiffness)


@CASES
@pytest.mark.parametrize("scale", [1e-4, 0.04, 1.0])
def test_the_stiffness_is_the_integral_of_a_beam(name, scale):
    """The smallest thickness is up to a tenth of the length."""
    energy, _, contour, sizes = CONTOURS[name]
    thinnest = "web" if "web" in sizes else "thickness"
    limit = {"V-notch": 1e-3, "reinforced leaf": 0.6e-3}.get(name, 2e-3)
    sizes = {**sizes, thinnest: scale * limit}
    bending, axial, transverse = integrals(*contour(**sizes))
    scale = 210e9 * WIDTH
    found = diagonal(energy(STEEL, width=WIDTH, **sizes))
    expected = scale / np.array([bending, axial, transverse])
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    found = diagonal(energy(STEEL, width=WIDTH, theory="timoshenko", **sizes))
    expected[2] = scale / (transverse + 2 * 1.3 * 6 / 5 * axial)
    np.testing.assert_allclose(found, expected, rtol=1e-10)


@jax.jit
def beam_stiffness(beam):
    """Return the stiffness of an undeformed beam."""
    compliance = jax.jacfwd(lambda load: flexures.beam_under_load(beam, load).pose)
    return jnp.linalg.inv(compliance(jnp.zeros(3)))


@pytest.mark.parametrize(
    "name", mostly_slow(["filleted leaf", "reinforced leaf", *OTHERS], fast=2)
)
def test_the_stiffness_is_that_of_an_exact_beam(name):
    """The transition of the reinforced leaf changes the axial stiffness by 1 %."""
    energy, profile, _, sizes = CONTOURS[name]
    settings = {"length": LENGTH, "thickness": profile(**sizes), "width": WIDTH}
    beam = flexures.Beam(STEEL, shear_factor=None, steps=96, **settings)
    found = np.diagonal(beam_stiffness(beam))
    exact = diagonal(energy(STEEL, width=WIDTH, **sizes))
    tolerances = [1e-6, 1e-6, 1e-6]
    if name == "reinforced leaf":
        tolerances = [2e-5, 0.011, 2e-4]
        assert abs(exact[1] / found[1] - 1) > 0.01
    np.testing.assert_array_less(np.abs(found / exact - 1), tolerances)


@CASES
def test_the_profile_is_the_contour(name):
    _, profile, contour, sizes = CONTOURS[name]
    if name == "reinforced leaf":
        sizes = {**sizes, "transition": 1e-9}
    positions = np.linspace(-1, 1, 102) * LENGTH / 2
    thickness, _ = contour(**{k: sizes[k] for k in sizes if k != "transition"})
    found = for_each(profile(**sizes), positions)
    expected = [thickness(abs(x)) for x in positions]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@CASES
def test_a_profile_has_derivatives_by_all_dimensions(name):
    """Against central differences, and without NaN at the ends and at the joints."""
    _, profile, contour, sizes = CONTOURS[name]
    middle, end = 0.0, LENGTH / 2
    special = np.array([-end, middle, end, *contour(**sizes)[1]])
    regular = np.linspace(-0.93, 0.87, 37) * end
    if name == "parabolic notch":
        sizes = {**sizes, "exponent": 3.0}
    names, values = list(sizes), np.array(list(sizes.values()))

    def thickness(values, positions):
        return jax.vmap(profile(**dict(zip(names, values, strict=True))))(positions)

    @jax.jit
    def derivatives(values):
        first = jax.jacrev(thickness)
        second = jax.jacfwd(first)(values, special)
        return first(values, special), second, first(values, regular)

    at_special, second, found = map(np.asarray, derivatives(values))
    assert np.all(np.isfinite(at_special))
    assert np.all(np.isfinite(second))
    steps = 1e-6 * np.diag(values)
    changed = np.concatenate([values + steps, values - steps])
    ahead, behind = np.split(for_each(lambda each: thickness(each, regular), changed), 2)
    for index, value in enumerate(values):
        expected = (ahead - behind)[index] / (2e-6 * value)
        scale = np.max(np.abs(found[:, index]))
        np.testing.assert_allclose(found[:, index], expected, atol=1e-5 * scale + 1e-8)


@CASES
def test_the_stiffness_has_derivatives_by_all_dimensions(name):
    energy, _, _, sizes = CONTOURS[name]
    names, values = list(sizes), np.array(list(sizes.values()))

    def logarithms(values):
        sizes = dict(zip(names, values, strict=True))
        return jnp.log(jnp.diag(energy(STEEL, width=WIDTH, **sizes).stiffness))

    @jax.jit
    def derivatives_and_values(values, changed):
        return jax.jacrev(logarithms)(values), jax.vmap(logarithms)(changed)

    steps = 1e-5 * np.diag(values)
    changed = np.concatenate([values + steps, values - steps])
    found, changes = map(np.asarray, derivatives_and_values(values, changed))
    ahead, behind = np.split(changes, 2)
    expected = (ahead - behind).T / 2e-5
    np.testing.assert_allclose(found * values, expected, atol=1e-7)


def test_small_fillets_and_short_reinforcements_leave_a_leaf():
    leaf: Sizes = {"length": LENGTH, "thickness": 0.5e-3}
    exact = diagonal(flexures.linear_leaf(STEEL, width=WIDTH, **leaf))
    filleted = flexures.filleted_leaf(STEEL, width=WIDTH, fillet=1e-9, **leaf)
    np.testing.assert_allclose(diagonal(filleted), exact, rtol=1e-6)
    reinforced: Sizes = {"reinforced_length": 1e-11, "reinforced_thickness": 5e-3}
    energy = flexures.reinforced_leaf(STEEL, width=WIDTH, **leaf, **reinforced)
    np.testing.assert_allclose(diagonal(energy), exact, rtol=1e-8)
    same: Sizes = {"reinforced_length": 7e-3, "reinforced_thickness": 0.5e-3}
    energy = flexures.reinforced_leaf(STEEL, width=WIDTH, **leaf, **same)
    np.testing.assert_allclose(diagonal(energy), exact, rtol=1e-14)


def test_four_contours_are_a_circular_notch():
    """An ellipse with equal semi-axes, the largest fillets, and a V without an angle."""
    hole, web = 3e-3, 0.25e-3
    circle = flexures.notch(
        STEEL, hole=hole, web=web, width=WIDTH, formula="paros-weisbord"
    )
    shared: Sizes = {"length": hole, "width": WIDTH}
    for energy in (
        flexures.elliptical_notch(STEEL, web=web, depth=hole / 2, **shared),
        flexures.filleted_leaf(STEEL, thickness=web, fillet=hole / 2, **shared),
        flexures.v_notch(STEEL, web=web, radius=hole / 2, angle=1e-9, **shared),
    ):
        np.testing.assert_allclose(diagonal(energy), diagonal(circle), rtol=1e-8)
    positions = np.linspace(-0.5, 0.5, 51) * hole
    exact = for_each(flexures.notch_profile(hole=hole, web=web), positions)
    for profile in (
        flexures.elliptical_notch_profile(length=hole, web=web, depth=hole / 2),
        flexures.filleted_leaf_profile(length=hole, thickness=web, fillet=hole / 2),
    ):
        np.testing.assert_allclose(for_each(profile, positions), exact, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "wrong", "message"),
    [
        ("filleted leaf", {"fillet": 10.01e-3}, "`fillet / length` is 0.5005, but must"),
        ("filleted leaf", {"thickness": 2.01e-3}, "'euler-bernoulli' is valid up to 0.1"),
        ("filleted leaf", {"fillet": 0.0}, "`fillet` is 0, but must be positive"),
        ("elliptical notch", {"depth": 10.1e-3}, "`depth / length` is 0.505, but"),
        ("elliptical notch", {"depth": 0.02e-3}, "For a shallower notch, use `leaf`"),
        ("elliptical notch", {"web": 2.01e-3}, "`web / length` is 0.1005, but"),
        ("parabolic notch", {"web": 2.01e-3}, "`web / length` is 0.1005, but"),
        ("V-notch", {"web": 1.01e-3}, r"`web / \(2 radius\)` is 0.101, but"),
        ("V-notch", {"angle": 2.7}, "`angle` is 2.7, but must be from 0 to 5/6 pi"),
        ("V-notch", {"radius": 15e-3}, r"`2 radius cos\(angle / 2\) / length` is 1.06"),
        ("reinforced leaf", {"reinforced_length": 21e-3}, "must be positive"),
        ("reinforced leaf", {"reinforced_thickness": 0.4e-3}, "is the thick one"),
        ("reinforced leaf", {"thickness": 0.7e-3}, r"reinforced_length\)` is 0.116"),
    ],
)
def test_dimensions_out_of_range_raise_an_error_or_give_nan(name, wrong, message):
    energy, _, _, sizes = CONTOURS[name]
    with pytest.raises(ValueError, match=message):
        energy(STEEL, width=WIDTH, **{**sizes, **wrong})
    ((changed, value),) = wrong.items()
    designs = np.array([value, sizes[changed]])

    @jax.vmap
    def stiffness(value):
        design = {**sizes, changed: value}
        return jnp.diag(energy(STEEL, width=WIDTH, **design).stiffness)

    finite = np.isfinite(jax.jit(stiffness)(designs))
    assert np.all(finite[1]) and not np.any(finite[0])


@pytest.mark.parametrize(
    ("profile", "sizes", "message"),
    [
        (
            flexures.filleted_leaf_profile,
            {**FILLETED, "fillet": 0.1},
            "`fillet / length`",
        ),
        (flexures.power_law_notch_profile, {**NOTCH, "exponent": 1.5}, "from 2 to 16"),
        (flexures.v_notch_profile, {**V_NOTCH, "angle": 3.2}, "must be from 0 to pi"),
        (
            flexures.reinforced_leaf_profile,
            {**REINFORCED, "transition": 7e-3},
            "Use a shorter `transition`",
        ),
    ],
)
def test_profiles_out_of_range_raise_an_error(profile, sizes, message):
    with pytest.raises(ValueError, match=message):
        profile(**sizes)


@pytest.mark.slow
def test_a_contour_is_built_without_a_compiled_program():
    setup = "from test_contours import CONTOURS, STEEL, WIDTH"
    energies = "[c[0](STEEL, width=WIDTH, **c[3]) for c in CONTOURS.values()]"
    profiles = "[c[1](**c[3]) for c in CONTOURS.values()]"
    setup = f"import sys; sys.path.insert(0, 'tests'); {setup}"
    assert count_programs(setup, energies, profiles)[1:] == [[0, 0], [0, 0]]


@pytest.mark.parametrize(
    "name", mostly_slow(["V-notch", "filleted leaf", "reinforced leaf", *OTHERS[:2]])
)
def test_the_largest_stress_of_a_contour_is_that_of_its_worst_section(name):
    """Under a transverse force F on the middle, it is the largest 6 F x / (w h^2)."""
    force = 1e-3  # so small that the displacements are infinitesimal
    _, profile, contour, sizes = CONTOURS[name]
    thickness, joints = contour(**sizes)
    positions = np.append(np.linspace(0, LENGTH / 2, 20001), np.add(joints, 1e-12))
    heights = np.array([thickness(x) for x in positions])
    exact = 6 * force * np.max(positions / heights**2) / WIDTH
    settings = {"length": LENGTH, "thickness": profile(**sizes), "width": WIDTH}
    beam = flexures.Beam(STEEL, steps=96, **settings)
    solution = flexures.beam_under_load(beam, np.array([0.0, 0.0, force]), 201)
    found = flexures.largest_stress(solution)
    assert 0.997 < float(found) / exact < 1 + 1e-6


def test_the_tables_of_the_manual_have_the_numbers_of_the_formulas():
    """With shear, they are those of the exact beam in the other tests."""
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in PAGE.read_text().splitlines()
    ]
    for name, (energy, _, _, sizes) in CONTOURS.items():
        (row,) = [r for r in rows if r[0].startswith(name) and len(r) == 7]
        plain = diagonal(energy(STEEL, width=WIDTH, **sizes))
        exact = diagonal(energy(STEEL, width=WIDTH, theory="timoshenko", **sizes))
        if name == "reinforced leaf":
            exact = exact * np.array([1, 1 - 0.0103, 1])  # of the transition
        for component, scale in enumerate((1, 1e-6, 1e-6)):
            listed = [float(text) for text in row[1 + 2 * component].split(",")]
            expected = scale * np.array([plain[component], exact[component]])
            np.testing.assert_allclose(listed, expected, rtol=6e-4)
            (difference,) = re.findall(r"[\d.]+", row[2 + 2 * component])
            expected = 100 * (plain[component] / exact[component] - 1)
            np.testing.assert_allclose(float(difference), expected, atol=0.06)


def test_a_notch_that_reaches_both_plates_is_not_misplaced():
    """The length of its contour counts, not that of a leaf of the same stiffness."""
    steel = tj.Material(modulus=210e9, poisson=0.3)
    notch = tj.flexures.parabolic_notch(
        steel, length=20e-3, web=0.5e-3, depth=4e-3, width=10e-3
    )

    def plate(y):
        return 1e-3 * np.array([(-10, y), (10, y), (10, y + 4), (-10, y + 4)])

    bodies = [tj.Body("a", outline=plate(-4)), tj.Body("b", outline=plate(20))]
    at = (np.pi / 2, 0.0, 10e-3)
    tj.Mechanism(bodies, [tj.Hinge("h", "a", "b", notch, at=at)], fixed=["a"])
