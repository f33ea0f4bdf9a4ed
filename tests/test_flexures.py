"""Stiffness and stress of leaves and notches against integrals and published values."""

from typing import TypedDict

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.integrate
from helpers import assert_close

import twistorjax as tj
from twistorjax.geometry import se2


ALUMINUM = tj.Material(modulus=69e9, poisson=0.33)
POLYMER = tj.Material(modulus=0.05 * 69e9, poisson=0.3)


class Sizes(TypedDict):
    """Sizes of a leaf; m."""

    length: float
    thickness: float
    width: float


def diagonal(energy):
    """Return the diagonal of a stiffness without coupling."""
    assert_close(energy.stiffness, np.diag(np.diagonal(energy.stiffness)))
    return np.diagonal(energy.stiffness)


def neck_stiffness(web, hole=3e-3, width=0.02, modulus=69e9):
    """Integrate the rotational, axial and transverse stiffness of a neck as a beam."""
    radius = hole / 2

    def integral(power, moment):
        def integrand(phi):
            x = radius * np.sin(phi)
            height = web + 2 * radius * (1 - np.cos(phi))
            return x**moment * height**power * radius * np.cos(phi)

        options = {"points": [0.05, 0.2], "limit": 500, "epsabs": 0, "epsrel": 1e-12}
        return 2 * scipy.integrate.quad(integrand, 0, np.pi / 2, **options)[0]

    scale = modulus * width
    return (
        scale / (12 * integral(-3, 0)),
        scale / integral(-1, 0),
        scale / (12 * integral(-3, 2)),
    )


def test_the_stiffness_of_the_leaf_of_the_four_bar():
    leaf = tj.flexures.linear_leaf(POLYMER, length=0.01, thickness=0.001, width=0.005)
    assert_close(diagonal(leaf), [0.14375, 1.725e6, 17250.0])


def test_a_leaf_has_the_compliance_of_a_cantilever_at_its_tip():
    """The compliances at the tip are L / EI, L^2 / 2 EI and L^3 / 3 EI."""
    length, bending = 0.03, 69e9 * 0.01 * 0.0005**3 / 12
    leaf = tj.flexures.linear_leaf(ALUMINUM, length=length, thickness=0.0005, width=0.01)
    tip = jnp.array([0.0, -length / 2, 0.0])  # pose of the middle relative to the tip
    compliance = np.linalg.inv(se2.transform_stiffness(tip, leaf.stiffness))
    expected = [length / bending, length**2 / 2 / bending, length**3 / 3 / bending]
    np.testing.assert_allclose(
        [compliance[0, 0], compliance[0, 2], compliance[2, 2]], expected, rtol=1e-12
    )


def test_a_leaf_with_shear_has_the_transverse_compliance_of_timoshenko():
    sizes: Sizes = {"length": 0.01, "thickness": 0.002, "width": 0.005}
    shear = 5 / 6 * 69e9 / (2 * 1.33) * 0.002 * 0.005
    bending = 69e9 * 0.005 * 0.002**3 / 12
    expected = 1 / (0.01**3 / (12 * bending) + 0.01 / shear)
    assert_close(
        diagonal(tj.flexures.linear_leaf(ALUMINUM, theory="timoshenko", **sizes))[2]
        / expected,
        1.0,
    )


@pytest.mark.parametrize(("theory", "limit"), [("euler-bernoulli", 0.1),
                                               ("timoshenko", 0.25)])  # fmt: skip
def test_a_leaf_that_is_too_thick_raises_an_error(theory, limit):
    tj.flexures.linear_leaf(
        POLYMER, length=3e-3, thickness=limit * 3e-3, width=1e-3, theory=theory
    )
    with pytest.raises(ValueError, match=f"is valid up to {limit}. Use a thinner"):
        tj.flexures.linear_leaf(
            POLYMER, length=1e-2, thickness=1.001 * limit * 1e-2, width=1, theory=theory
        )


def test_the_stiffness_of_the_notch_of_the_stage():
    """The values are those of the listing, and rounded those of section 6.2.2."""
    notch = diagonal(tj.flexures.notch(ALUMINUM, hole=3e-3, web=0.25e-3, width=0.02))
    expected = [2.50965124679121, 158837017.472332, 16607476.7591281]
    np.testing.assert_allclose(notch, expected, rtol=1e-14)
    np.testing.assert_allclose(notch, [2.5096, 1.588e8, 1.661e7], rtol=3e-4)


@pytest.mark.parametrize("ratio", [0.01, 0.0833, 0.2, 0.25])
def test_paros_weisbord_is_the_exact_integral_of_a_beam(ratio):
    web = ratio * 3e-3
    notch = tj.flexures.notch(
        ALUMINUM, hole=3e-3, web=web, width=0.02, formula="paros-weisbord"
    )
    np.testing.assert_allclose(diagonal(notch), neck_stiffness(web), rtol=1e-9)


def test_the_rotational_stiffness_of_paros_weisbord_is_the_published_formula():
    """It is the angular compliance with beta = t / 2 R and gamma = 1 + beta."""
    radius, web, scale = 1.5e-3, 0.25e-3, 69e9 * 0.02
    beta = web / (2 * radius)
    span = 2 * beta + beta**2
    bracket = 1 / (1 + beta) + (3 + 2 * beta + beta**2) / ((1 + beta) * span)
    bracket += 6 * (1 + beta) / span**1.5 * np.arctan(np.sqrt((2 + beta) / beta))
    compliance = 3 / (2 * scale * radius**2) / span * bracket
    notch = tj.flexures.notch(
        ALUMINUM, hole=3e-3, web=web, width=0.02, formula="paros-weisbord"
    )
    assert_close(diagonal(notch)[0] * compliance, 1.0, digits=10)


def test_the_simplified_rotational_stiffness_is_equation_6_2():
    """Its value is 2.4907 N m/rad; the text prints 2.4919 N m/rad."""
    simplified = "paros-weisbord-simplified"
    notch = tj.flexures.notch(
        ALUMINUM, hole=3e-3, web=0.25e-3, width=0.02, formula=simplified
    )
    expected = 2 * 69e9 * 0.02 * 0.25e-3**2.5 / (9 * np.pi * np.sqrt(1.5e-3))
    assert_close(diagonal(notch)[0], expected)
    assert abs(expected - 2.4907) < 5e-5


@pytest.mark.parametrize(("ratio", "tolerance"), [(1e-4, 0.01), (0.1, 0.23)])
def test_the_simplified_formula_approaches_the_full_one_for_thin_webs(ratio, tolerance):
    sizes = {"hole": 3e-3, "web": ratio * 3e-3, "width": 0.02}
    full = diagonal(tj.flexures.notch(ALUMINUM, formula="paros-weisbord", **sizes))
    simplified = diagonal(
        tj.flexures.notch(ALUMINUM, formula="paros-weisbord-simplified", **sizes)
    )
    np.testing.assert_allclose(simplified, full, rtol=tolerance)


@pytest.mark.parametrize(
    ("formula", "low", "high"),
    [("fitted", 0.05, 0.5), ("paros-weisbord", None, 0.25),
     ("paros-weisbord-simplified", None, 0.1)],
)  # fmt: skip
def test_a_web_outside_the_range_of_the_formula_raises_an_error(formula, low, high):
    def notch(ratio):
        sizes = {"hole": 3e-3, "web": ratio * 3e-3, "width": 0.02}
        return tj.flexures.notch(ALUMINUM, formula=formula, **sizes)

    for ratio in (low, high):
        if ratio is not None:
            assert np.all(diagonal(notch(ratio)) > 0)
    for ratio in (0.999 * (low or -1), 1.001 * high):
        with pytest.raises(ValueError, match=r"`web( / hole)?` is .*, but"):
            notch(ratio)


def test_a_traced_web_out_of_range_gives_nan_for_this_design_only():
    def stiffness(web):
        return tj.flexures.notch(ALUMINUM, hole=3e-3, web=web, width=0.02).stiffness

    designs = jax.vmap(stiffness)(jnp.array([1e-6, 0.25e-3]))
    assert np.all(np.isnan(np.diagonal(designs[0])))
    assert_close(designs[1], stiffness(0.25e-3))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"modulus": -1.0, "poisson": 0.3}, "`modulus` is -1, but must be positive"),
        ({"modulus": 1.0, "poisson": 0.51}, "`poisson` is 0.51, but"),
        ({"modulus": 1.0, "poisson": 0.3, "density": 0.0}, "`density` is 0, but"),
        ({"modulus": np.nan, "poisson": 0.3}, "`modulus` is nan, but"),
        (
            {"modulus": "stiff", "poisson": 0.3},
            "`modulus` is 'stiff', but must be a num",
        ),
    ],
)
@pytest.mark.untyped
def test_invalid_values_of_a_material_raise_an_error(values, message):
    with pytest.raises(ValueError, match=message):
        tj.Material(**values)


def test_outlines_have_the_size_of_the_hinge():
    notch = tj.flexures.notch_outline(hole=3e-3, web=0.25e-3)
    assert_close(np.ptp(notch[:, 0]), 3e-3)
    middle = notch[np.abs(notch[:, 0]) < 2e-4]
    assert 0.125e-3 <= np.abs(middle[:, 1]).min() < 0.14e-3
    leaf = tj.flexures.leaf_outline(length=0.01, thickness=0.001)
    assert_close(np.ptp(leaf, axis=0), [0.01, 0.001])


def cantilever(count, energy):
    """Return a cantilever of unit length that is divided into equal hinges."""
    part = 1 / count
    bodies = [tj.Body("0")]
    bodies += [tj.Body(f"{k}", (0.0, k * part, 0.0)) for k in range(1, count + 1)]
    hinges = [
        tj.Hinge(f"h{k}", f"{k}", f"{k + 1}", energy, at=(0.0, (k + 0.5) * part, 0.0))
        for k in range(count)
    ]
    return tj.Mechanism(bodies, hinges, fixed=["0"])


def test_quartic_leaves_converge_to_the_elastica_with_the_fourth_order():
    """At P L^2 / E I = 1, the errors of angle and displacements are at most 0.3 %."""
    exact = np.array([0.461351949712, -0.0564332362834, 0.3017207738])
    unit, thickness = tj.Material(modulus=1.0, poisson=0.3), 1e-2
    errors = []
    for count in (1, 2):
        energy = tj.flexures.quartic_leaf(
            unit, length=1 / count, thickness=thickness, width=12 / thickness**3
        )
        tip = f"{count}"
        load = [tj.Load(tip, (0.0, 0.0, 1.0))]
        solution = tj.equilibrium(cantilever(count, energy), loads=load)
        errors.append(np.abs(np.asarray(solution.displacement(tip)) / exact - 1))
    np.testing.assert_array_less(errors[0], 3e-3)
    assert np.log2(errors[0][0] / errors[1][0]) > 3.9
    assert np.all(errors[1] < 3e-4)


def test_a_quartic_leaf_has_the_stiffness_of_a_leaf():
    sizes: Sizes = {"length": 10e-3, "thickness": 0.8e-3, "width": 5e-3}
    polymer = tj.Material(modulus=3.45e9, poisson=0.3)
    for theory in ("euler-bernoulli", "timoshenko"):
        quartic = tj.flexures.quartic_leaf(polymer, theory=theory, **sizes)
        expected = tj.flexures.linear_leaf(polymer, theory=theory, **sizes).stiffness
        stiffness = jax.jit(lambda energy=quartic: energy.tangent_stiffness())()
        np.testing.assert_allclose(np.diag(stiffness), np.diag(expected), rtol=1e-12)


def test_the_largest_stress_of_a_cantilever_is_at_its_clamp():
    """It is 6 P L / w t^2 for a transverse force, and P / w t for an axial force."""
    size: Sizes = {"length": 0.05, "thickness": 1e-3, "width": 0.01}
    energy = tj.flexures.linear_leaf(ALUMINUM, **size)
    bodies = [tj.Body("wall"), tj.Body("tip", (0.0, 0.05, 0.0))]
    hinge = tj.Hinge("leaf", "wall", "tip", energy, at=(0.0, 0.025, 0.0))
    beam = tj.Mechanism(bodies, [hinge], fixed=["wall"])

    @jax.jit
    def stress(poses):
        return tj.flexures.leaf_stress(beam.wrench_of("leaf", poses), **size)

    for force, exact in (
        ((0.0, 0.0, 1e-3), 6 * 1e-3 * 0.05 / (0.01 * 1e-6)),
        ((0.0, 2.0, 0.0), 2.0 / (0.01 * 1e-3)),
    ):
        solution = tj.equilibrium(beam, loads=[tj.Load("tip", force)])
        np.testing.assert_allclose(stress(solution.poses), exact, rtol=1e-5)


@pytest.mark.parametrize("web", [1e-9, 1e-5, 2.9e-6, 3.1e-6, 0.25e-3, 1.5e-3])
def test_the_stress_concentration_of_a_neck_is_the_published_one(web):
    """The factor in bending is (1 + web / hole)^(9/20), a published fit to 2 %.

    The formulas are evaluated by mpmath, whose digits allow the small differences of a
    thin neck.
    """
    size = {"hole": 3e-3, "web": web, "width": 0.02}
    bending = tj.flexures.notch_stress((0.01, 0.0, 0.0), **size) / (
        6 * 0.01 / (0.02 * web**2)
    )
    np.testing.assert_allclose(bending, (1 + web / 3e-3) ** 0.45, rtol=0.02)
    with mpmath.workdps(40):
        ratio = mpmath.mpf(web) / mpmath.mpf(3e-3)
        root, angle = mpmath.sqrt(ratio), mpmath.atan(mpmath.sqrt(ratio))
        exact = 4 * ratio * root / (3 * (root + (ratio - 1) * angle))
        np.testing.assert_allclose(bending, float(exact), rtol=1e-9)
        tension = tj.flexures.notch_stress((0.0, 5.0, 0.0), **size) / (5.0 / (0.02 * web))
        exact = 2 * (ratio + 1) * root / ((ratio + 1) * angle + root)
        np.testing.assert_allclose(tension, float(exact), rtol=1e-9)
