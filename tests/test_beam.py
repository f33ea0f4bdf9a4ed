"""The exact planar beam, against closed forms, published numbers and finite elements."""

import json
import pathlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from scipy.optimize import brentq

import twistorjax as tj


pytestmark = pytest.mark.slow

REFERENCE = json.loads(
    (pathlib.Path(__file__).parent / "reference" / "beams.json").read_text()
)
LAWS = [
    pytest.param("linear", marks=pytest.mark.long),
    "saint-venant-kirchhoff",  # the linear one is a part of it
]
SOFT = tj.Material(modulus=3.45e9, poisson=0.3)
bend = jax.jit(tj.flexures.beam_under_load)


def slender(thickness=1e-4, **settings):
    """E I and L are one, and it hardly stretches."""
    unit = tj.Material(modulus=1.0, poisson=0.3)
    settings = {"shear_factor": None, "steps": 12, **settings}
    width = 12 / thickness**3
    return tj.flexures.Beam(
        unit, length=1.0, thickness=thickness, width=width, **settings
    )


def leaf(law="linear", **settings):
    settings = {"length": 10e-3, "thickness": 1e-3, "width": 5e-3, **settings}
    return tj.flexures.Beam(SOFT, law=law, steps=8, **settings)


def under_tip_force(beam, force):
    """A dead force on the end section: its moment about the middle follows the tip."""

    def gap(moment):
        tip = bend(beam, jnp.array([moment, *force])).line[-1]
        return moment - (tip[1] * force[1] - tip[2] * force[0])

    size = float(beam.length) * np.abs(force).max()
    moment = brentq(gap, -size, size, xtol=1e-13 * size, rtol=1e-14)
    return bend(beam, jnp.array([moment, *force]))


@pytest.mark.parametrize("row", REFERENCE["elastica_tip_force"]["rows"])
def test_a_cantilever_is_the_elastica(row, validated):
    force, across, along, angle = row
    tip = under_tip_force(slender(), np.array([0.0, force])).line[-1]
    actual = jnp.array([tip[2], 0.5 - tip[1], tip[0]])
    assert_close(actual, np.array([across, along, angle]), digits=8)
    exact = [across, along, angle]
    what = f"tip under P L²/E I = {force:g}"
    validated("Exact beams", what, actual, exact, "the elastica, by elliptic integrals")


def test_a_cantilever_that_stretches_is_the_published_one(validated):
    given = REFERENCE["extensible_cantilever_SI"]
    metal = tj.Material(modulus=given["E"], poisson=0.3)
    beam = tj.flexures.Beam(
        *(metal,),
        length=given["L"], thickness=given["h"], width=given["b"],
        shear_factor=None,
    )  # fmt: skip
    force = 3 * given["E"] * given["b"] * given["h"] ** 3 / 12 / given["L"] ** 2
    tip = under_tip_force(beam, np.array([0.0, -force])).line[-1]
    actual = jnp.array([tip[1] - given["L"] / 2, tip[2]])
    exact = [given["ux"], given["uy"]]
    np.testing.assert_allclose(actual, exact, rtol=1e-9)
    oracle = "a published benchmark of large deflections"
    validated("Exact beams", "tip of one that stretches", actual, exact, oracle)


@pytest.mark.parametrize("row", REFERENCE["fixed_guided_leaf"]["rows"])
def test_a_guided_leaf_shortens(row):
    across, force, along = row
    beam = slender()

    def turn(moment):
        return float(bend(beam, jnp.array([moment, 0.0, force])).pose[0])

    moment = brentq(turn, -force, force, xtol=1e-14)
    _, x, y = bend(beam, jnp.array([moment, 0.0, force])).pose
    np.testing.assert_allclose([y, -x], [across, along], rtol=3e-8)


@pytest.mark.parametrize("law", LAWS)
def test_its_wrench_is_the_slope_of_its_energy(law):
    """Castigliano: two ways through the same beam, there by a load, back by a pose."""
    beam = leaf(law)
    bent = bend(beam, jnp.array([0.08, 12.0, -9.0]))
    exact = tj.flexures.ExactBeam(beam)
    np.testing.assert_allclose(exact(bent.pose), bent.energy, rtol=1e-10)
    np.testing.assert_allclose(
        eqx.filter_jit(exact.wrench)(bent.pose), bent.wrench, rtol=1e-8
    )


@pytest.mark.long
def test_derivatives_by_the_geometry_agree_with_differences():
    """Of the energy and of the wrench at one pose, by the thickness."""
    pose = bend(leaf(), jnp.array([0.08, 12.0, -9.0])).pose

    def answers(thickness):
        exact = tj.flexures.ExactBeam(leaf(thickness=thickness))
        return exact(pose), exact.wrench(pose)

    answers = jax.jit(answers)
    _, slopes = jax.jvp(answers, (jnp.asarray(1e-3),), (jnp.ones(()),))
    step = 1e-7
    after, before = answers(1e-3 + step), answers(1e-3 - step)
    for slope, there, here in zip(slopes, after, before, strict=True):
        np.testing.assert_allclose(slope, (there - here) / (2 * step), rtol=1e-6)


def test_finite_elements_of_a_leaf_obey_the_same_material_law(validated):
    """St. Venant-Kirchhoff within some per cent; a linear section is six times worse."""
    folder = pathlib.Path(__file__).parent / "reference"
    trials = tj.energies.read_trials(folder / "fe_leaf.csv")[np.arange(0, 122, 3)]
    size = np.sqrt(np.mean(np.asarray(trials.wrenches) ** 2, axis=0))
    errors = []
    for law in ("saint-venant-kirchhoff", "linear"):
        wrenches = jax.jit(jax.vmap(tj.flexures.ExactBeam(leaf(law)).wrench))(
            trials.poses
        )
        gap = np.asarray(wrenches - trials.wrenches)
        errors.append(np.sqrt(np.mean(gap**2, axis=0)) / size)
    assert np.all(errors[0] < [0.015, 0.045, 0.02])
    assert np.all(errors[1] > 4 * errors[0])
    what = "wrenches of a leaf of t/L = 0.1 to 46° (rms, worst component)"
    oracle = "122 plane finite-element analyses"
    validated("Exact beams", what, 1 + errors[0].max(), 1.0, oracle)


@pytest.mark.parametrize("law", LAWS)
def test_it_is_at_rest_what_beam_theory_says(law):
    exact = tj.flexures.ExactBeam(leaf(law))
    stiffness = jnp.diag(eqx.filter_jit(exact.tangent_stiffness)(jnp.zeros(3)))
    expected = tj.flexures.leaf(
        *(SOFT,), length=10e-3, thickness=1e-3, width=5e-3, theory="timoshenko"
    ).stiffness
    np.testing.assert_allclose(stiffness, jnp.diag(expected), rtol=1e-9)


def test_a_notch_is_a_beam_of_its_own_outline():
    """Against the integrals of Paros and Weisbord, with and without shear."""
    given = REFERENCE["notch_D3mm_h0.25mm_t20mm_E69GPa"]
    metal = tj.Material(modulus=69e9, poisson=0.33)

    height = tj.flexures.notch_profile(hole=3e-3, web=0.25e-3)
    for factor, shear in ((None, "k_shear_1D_EB"), (5 / 6, "k_shear_1D_Timoshenko")):
        beam = tj.flexures.Beam(
            *(metal,),
            length=3e-3, thickness=height, width=20e-3, shear_factor=factor, steps=48,
        )  # fmt: skip
        load = 1e-6 * jnp.diag(jnp.array([1.0, 1e3, 1e3]))
        poses = jax.vmap(
            lambda load, beam=beam: tj.flexures.beam_under_load(beam, load).pose
        )(load)
        stiffness = jnp.diag(load) / jnp.diag(poses)
        expected = [given[name] for name in ("k_rot_1D_beam", "k_ax_1D_beam", shear)]
        np.testing.assert_allclose(stiffness, expected, rtol=1e-5)


def test_a_section_gives_way_beyond_its_largest_moment():
    """St. Venant-Kirchhoff's is M = k - 0.3 (t / L)^2 k^3, whose top is at 7.03."""
    beam = leaf("saint-venant-kirchhoff")

    def turn(moment):
        return bend(beam, jnp.array([moment * float(beam.bending), 0.0, 0.0])).pose[0]

    for moment in (5.0, 6.9):
        bound = np.sqrt(1 / 0.9) / 0.1
        exact = brentq(lambda k, m=moment: k - 3e-3 * k**3 - m, 0.0, bound)
        np.testing.assert_allclose(turn(moment), exact, rtol=1e-8)
    assert np.isnan(turn(7.1)) and np.isnan(turn(8.0))


def test_stress_is_that_of_a_bent_and_pulled_bar():
    beam = leaf()
    bent = bend(beam, jnp.array([0.05, 0.0, 0.0]))
    fibre = 0.05 * 0.5e-3 / (5e-3 * (1e-3) ** 3 / 12)
    assert_close(bent.stress, np.full((21, 2), [-fibre, fibre]), digits=12)
    pulled = bend(beam, jnp.array([0.0, 20.0, 0.0])).stress
    assert_close(pulled, np.full((21, 2), 20.0 / 5e-6), digits=12)
    assert_close(tj.flexures.largest_rotation(beam, fibre), 0.05 / 0.14375, digits=12)


@pytest.mark.long
def test_it_is_a_hinge_of_a_mechanism():
    """A body on the end of a leaf, pushed: by statics as from end to end."""
    beam = leaf()
    bodies = [tj.Body("wall"), tj.Body("tip", pose=(0.0, 5e-3, 0.0))]
    hinge = tj.Hinge(
        "leaf", "wall", "tip", tj.flexures.ExactBeam(beam), at=(0.0, 0.0, 0.0)
    )
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    solution = tj.equilibrium(mechanism, loads=[tj.Load("tip", (0.0, 0.0, 8.0))])
    tip = under_tip_force(beam, np.array([0.0, 8.0])).line[-1]
    np.testing.assert_allclose(solution.pose("tip"), tip, rtol=1e-7)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: leaf(thickness=-1e-3), "`thickness` is -0.001"),
        (lambda: leaf(length=0.0), "`length` is 0"),
        (lambda: leaf("rubber"), "'linear', 'saint-venant-kirchhoff'"),
        (
            lambda: leaf("saint-venant-kirchhoff", shear_factor=None),
            "`shear_factor` is None",
        ),
        (lambda: tj.flexures.largest_rotation(leaf(), -1.0), "`stress` is -1"),
    ],
)
def test_bad_input_is_told(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert message in str(error.value)


@pytest.mark.parametrize("thickness", [0.1, 0.01, 0.002])
def test_a_pose_is_bent_to_however_thin_the_leaf(thickness):
    """The loads that led there are found again, to turns of 100 degrees."""
    leaf = tj.flexures.Beam(SOFT, length=1.0, thickness=thickness, width=0.1)
    loads = jax.random.uniform(jax.random.key(0), (40, 3), minval=-1.0, maxval=1.0)
    loads = loads * jnp.array([[1.5, 6.0, 6.0]]) * leaf.bending
    bent = jax.vmap(lambda load: tj.flexures.beam_under_load(leaf, load))(loads)
    assert jnp.abs(bent.pose[:, 0]).max() > 1.7
    found = jax.jit(jax.vmap(lambda pose: tj.flexures.beam_at_pose(leaf, pose)))(
        bent.pose
    )
    apart = (found.wrench - bent.wrench) / leaf.bending
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)
