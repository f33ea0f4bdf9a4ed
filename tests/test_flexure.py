"""Stiffnesses of leaves and notches against integrals, listings and published values."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.integrate
from helpers import assert_close

import twistorjax as tj


ALUMINIUM = tj.Material(modulus=69e9, poisson=0.33)
SOFT = tj.Material(modulus=0.05 * 69e9, poisson=0.3)


def diagonal(energy):
    assert_close(energy.stiffness, np.diag(np.diagonal(energy.stiffness)))
    return np.diagonal(energy.stiffness)


def beam_notch(web, hole=3e-3, width=0.02, modulus=69e9):
    """Rotation, axial and transverse stiffness of a neck, by quadrature."""
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


def test_leaf_of_the_four_bar():
    leaf = tj.flexures.leaf(SOFT, length=0.01, thickness=0.001, width=0.005)
    assert_close(diagonal(leaf), [0.14375, 1.725e6, 17250.0])


def test_leaf_has_the_compliance_of_a_cantilever_at_its_tip():
    """From the middle to the tip: L / EI, L^2 / 2 EI, L^3 / 3 EI."""
    length, bending = 0.03, 69e9 * 0.01 * 0.0005**3 / 12
    leaf = tj.flexures.leaf(ALUMINIUM, length=length, thickness=0.0005, width=0.01)
    tip = jnp.array([0.0, -length / 2, 0.0])  # the middle, seen from the tip
    compliance = np.linalg.inv(tj.geometry.se2.transform_stiffness(tip, leaf.stiffness))
    expected = [length / bending, length**2 / 2 / bending, length**3 / 3 / bending]
    np.testing.assert_allclose(
        [compliance[0, 0], compliance[0, 2], compliance[2, 2]], expected, rtol=1e-12
    )


def test_leaf_that_shears_has_the_compliance_of_timoshenko():
    sizes = {"length": 0.01, "thickness": 0.002, "width": 0.005}
    shear = 5 / 6 * 69e9 / (2 * 1.33) * 0.002 * 0.005
    bending = 69e9 * 0.005 * 0.002**3 / 12
    expected = 1 / (0.01**3 / (12 * bending) + 0.01 / shear)
    assert_close(
        diagonal(tj.flexures.leaf(ALUMINIUM, theory="timoshenko", **sizes))[2] / expected,
        1.0,
    )


@pytest.mark.parametrize(("theory", "share"), [("euler-bernoulli", 0.1),
                                               ("timoshenko", 0.25)])  # fmt: skip
def test_leaf_refuses_to_be_stout(theory, share):
    tj.flexures.leaf(SOFT, length=3e-3, thickness=share * 3e-3, width=1e-3, theory=theory)
    with pytest.raises(ValueError, match=f"holds to {share}: take a thinner or longer"):
        tj.flexures.leaf(
            SOFT, length=1e-2, thickness=1.001 * share * 1e-2, width=1, theory=theory
        )


def test_notch_of_the_stage():
    """The values printed in section 6.2.2, and the listing's to all digits."""
    notch = diagonal(tj.flexures.notch(ALUMINIUM, hole=3e-3, web=0.25e-3, width=0.02))
    expected = [2.50965124679121, 158837017.472332, 16607476.7591281]
    np.testing.assert_allclose(notch, expected, rtol=1e-14)
    np.testing.assert_allclose(notch, [2.5096, 1.588e8, 1.661e7], rtol=3e-4)


@pytest.mark.parametrize("share", [0.01, 0.0833, 0.2, 0.25])
def test_paros_and_weisbord_integrate_the_beam_exactly(share):
    web = share * 3e-3
    notch = tj.flexures.notch(
        ALUMINIUM, hole=3e-3, web=web, width=0.02, formula="paros-weisbord"
    )
    np.testing.assert_allclose(diagonal(notch), beam_notch(web), rtol=1e-9)


def test_paros_and_weisbord_full_rotation_is_their_published_formula():
    """Their angular compliance, with beta = t / 2 R and gamma = 1 + beta."""
    radius, web, scale = 1.5e-3, 0.25e-3, 69e9 * 0.02
    beta = web / (2 * radius)
    span = 2 * beta + beta**2
    bracket = 1 / (1 + beta) + (3 + 2 * beta + beta**2) / ((1 + beta) * span)
    bracket += 6 * (1 + beta) / span**1.5 * np.arctan(np.sqrt((2 + beta) / beta))
    compliance = 3 / (2 * scale * radius**2) / span * bracket
    notch = tj.flexures.notch(
        ALUMINIUM, hole=3e-3, web=web, width=0.02, formula="paros-weisbord"
    )
    assert_close(diagonal(notch)[0] * compliance, 1.0, digits=10)


def test_paros_and_weisbord_simplified_is_equation_6_2():
    """Evaluated: 2.4907 N m/rad. The text prints 2.4919."""
    simplified = "paros-weisbord-simplified"
    notch = tj.flexures.notch(
        ALUMINIUM, hole=3e-3, web=0.25e-3, width=0.02, formula=simplified
    )
    expected = 2 * 69e9 * 0.02 * 0.25e-3**2.5 / (9 * np.pi * np.sqrt(1.5e-3))
    assert_close(diagonal(notch)[0], expected)
    assert abs(expected - 2.4907) < 5e-5


@pytest.mark.parametrize(("share", "within"), [(1e-4, 0.01), (0.1, 0.23)])
def test_simplified_tends_to_full_for_thin_webs(share, within):
    sizes = {"hole": 3e-3, "web": share * 3e-3, "width": 0.02}
    full = diagonal(tj.flexures.notch(ALUMINIUM, formula="paros-weisbord", **sizes))
    thin = diagonal(
        tj.flexures.notch(ALUMINIUM, formula="paros-weisbord-simplified", **sizes)
    )
    np.testing.assert_allclose(thin, full, rtol=within)


@pytest.mark.parametrize(
    ("formula", "low", "high"),
    [("fitted", 0.05, 0.5), ("paros-weisbord", None, 0.25),
     ("paros-weisbord-simplified", None, 0.1)],
)  # fmt: skip
def test_notch_says_where_its_formula_ends(formula, low, high):
    def notch(share):
        sizes = {"hole": 3e-3, "web": share * 3e-3, "width": 0.02}
        return tj.flexures.notch(ALUMINIUM, formula=formula, **sizes)

    for share in (low, high):
        if share is not None:
            assert np.all(diagonal(notch(share)) > 0)
    for share in (0.999 * (low or -1), 1.001 * high):
        with pytest.raises(ValueError, match=r"`web( / hole)?` is .*, but"):
            notch(share)


def test_a_web_out_of_range_harms_its_own_lane_alone():
    def stiffness(web):
        return tj.flexures.notch(ALUMINIUM, hole=3e-3, web=web, width=0.02).stiffness

    lanes = jax.vmap(stiffness)(jnp.array([1e-6, 0.25e-3]))
    assert np.all(np.isnan(np.diagonal(lanes[0])))
    assert_close(lanes[1], stiffness(0.25e-3))


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
def test_refuses_what_is_no_material(values, message):
    with pytest.raises(ValueError, match=message):
        tj.Material(**values)


def test_outlines_have_the_size_of_the_hinge():
    notch = tj.flexures.notch_outline(hole=3e-3, web=0.25e-3)
    assert_close(np.ptp(notch[:, 0]), 3e-3)
    middle = notch[np.abs(notch[:, 0]) < 2e-4]
    assert 0.125e-3 <= np.abs(middle[:, 1]).min() < 0.14e-3
    leaf = tj.flexures.leaf_outline(length=0.01, thickness=0.001)
    assert_close(np.ptp(leaf, axis=0), [0.01, 0.001])


def chain(count, energy):
    """A cantilever of unit length and stiffness, of so many like hinges."""
    part = 1 / count
    bodies = [tj.Body("0")]
    bodies += [tj.Body(f"{k}", (0.0, k * part, 0.0)) for k in range(1, count + 1)]
    hinges = [
        tj.Hinge(f"h{k}", f"{k}", f"{k + 1}", energy, at=(0.0, (k + 0.5) * part, 0.0))
        for k in range(count)
    ]
    return tj.Mechanism(bodies, hinges, fixed=["0"])


def test_a_quartic_leaf_bends_as_the_elastica_and_a_chain_to_fourth_order():
    """Under P L^2 / E I = 1: angle, travel along and across; errors at most 0.3 %."""
    exact = np.array([0.461351949712, -0.0564332362834, 0.3017207738])
    unit, thickness = tj.Material(modulus=1.0, poisson=0.3), 1e-2
    errors = []
    for count in (1, 2):
        energy = tj.flexures.quartic_leaf(
            unit, length=1 / count, thickness=thickness, width=12 / thickness**3
        )
        tip = f"{count}"
        load = [tj.Load(tip, (0.0, 0.0, 1.0))]
        moved = tj.equilibrium(chain(count, energy), loads=load).displacement(tip)
        errors.append(np.abs(moved / exact - 1))
    np.testing.assert_array_less(errors[0], 3e-3)
    assert np.log2(errors[0][0] / errors[1][0]) > 3.9
    assert np.all(errors[1] < 3e-4)


def test_a_quartic_leaf_is_at_rest_the_leaf():
    sizes = {"length": 10e-3, "thickness": 0.8e-3, "width": 5e-3}
    soft = tj.Material(modulus=3.45e9, poisson=0.3)
    for theory in ("euler-bernoulli", "timoshenko"):
        curved = tj.flexures.quartic_leaf(soft, theory=theory, **sizes)
        straight = tj.flexures.leaf(soft, theory=theory, **sizes).stiffness
        np.testing.assert_allclose(
            jnp.diag(curved.tangent_stiffness()), jnp.diag(straight), rtol=1e-12
        )


def test_the_stress_of_a_cantilever_is_that_of_its_clamp():
    """6 P L / w t^2 where the tip is pushed across, and P / w t where it is pulled."""
    size = {"length": 0.05, "thickness": 1e-3, "width": 0.01}
    energy = tj.flexures.leaf(ALUMINIUM, **size)
    bodies = [tj.Body("wall"), tj.Body("tip", (0.0, 0.05, 0.0))]
    hinge = tj.Hinge("leaf", "wall", "tip", energy, at=(0.0, 0.025, 0.0))
    beam = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    for force, exact in (
        ((0.0, 0.0, 1e-3), 6 * 1e-3 * 0.05 / (0.01 * 1e-6)),
        ((0.0, 2.0, 0.0), 2.0 / (0.01 * 1e-3)),
    ):
        solution = tj.equilibrium(beam, loads=[tj.Load("tip", force)])
        stress = tj.flexures.leaf_stress(beam.wrench_of("leaf", solution.poses), **size)
        np.testing.assert_allclose(stress, exact, rtol=1e-5)


@pytest.mark.parametrize("web", [1e-9, 1e-5, 2.9e-6, 3.1e-6, 0.25e-3, 1.5e-3])
def test_the_stress_of_a_neck_is_that_of_a_beam_where_it_is_thin(web):
    """Beyond by what is published of necks between holes: (1 + web / hole)^(9/20), bent.

    That is a fit, within two per cent. The formula itself by mpmath, whose digits bear
    the differences of a thin neck.
    """
    size = {"hole": 3e-3, "web": web, "width": 0.02}
    bent = tj.flexures.notch_stress((0.01, 0.0, 0.0), **size) / (
        6 * 0.01 / (0.02 * web**2)
    )
    np.testing.assert_allclose(bent, (1 + web / 3e-3) ** 0.45, rtol=0.02)
    with mpmath.workdps(40):
        ratio = mpmath.mpf(web) / mpmath.mpf(3e-3)
        root, turn = mpmath.sqrt(ratio), mpmath.atan(mpmath.sqrt(ratio))
        exact = 4 * ratio * root / (3 * (root + (ratio - 1) * turn))
        np.testing.assert_allclose(bent, float(exact), rtol=1e-9)
        pulled = tj.flexures.notch_stress((0.0, 5.0, 0.0), **size) / (5.0 / (0.02 * web))
        exact = 2 * (ratio + 1) * root / ((ratio + 1) * turn + root)
        np.testing.assert_allclose(pulled, float(exact), rtol=1e-9)
