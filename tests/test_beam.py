"""Exact planar beams against closed forms, published numbers and finite elements."""

import json
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, mostly_slow
from scipy.optimize import brentq

import twistorjax as tj
from twistorjax.flexures.beams.beam import Law


REFERENCE = json.loads(
    (pathlib.Path(__file__).parent / "reference" / "beams.json").read_text()
)
LAWS = ["linear", "saint-venant-kirchhoff"]
POLYMER = tj.Material(modulus=3.45e9, poisson=0.3)
beam_under_load = jax.jit(tj.flexures.beam_under_load)
beams_under_loads = jax.jit(jax.vmap(tj.flexures.beam_under_load, (None, 0)))
beams_at_poses = jax.jit(jax.vmap(tj.flexures.beam_at_pose, (None, 0)))


def slender(thickness=1e-4, **settings):
    """Return a beam with E I = 1 and L = 1 that is almost inextensible."""
    unit = tj.Material(modulus=1.0, poisson=0.3)
    settings = {"shear_factor": None, "steps": 12, **settings}
    width = 12 / thickness**3
    return tj.flexures.Beam(
        unit, length=1.0, thickness=thickness, width=width, **settings
    )


def leaf(law: Law = "linear", **settings):
    """Return a leaf with a length of ten thicknesses."""
    settings = {"length": 10e-3, "thickness": 1e-3, "width": 5e-3, **settings}
    return tj.flexures.Beam(POLYMER, law=law, steps=8, **settings)


def end_under_tip_force(beam, force):
    """Return the pose of the end section of a beam under a force there.

    The moment of the force about the origin of frame a depends on the position of the
    end section, and is found by iteration.
    """

    def end(moment):
        return np.asarray(beam_under_load(beam, [moment, *force]).centerline)[-1]

    def residual(moment):
        tip = end(moment)
        return moment - (tip[1] * force[1] - tip[2] * force[0])

    size = float(beam.length) * np.abs(force).max()
    moment = brentq(residual, -size, size, xtol=1e-13 * size, rtol=1e-14)  # pyright: ignore[reportArgumentType]
    return end(moment)


@pytest.mark.parametrize("row", REFERENCE["elastica_tip_force"]["rows"])
def test_a_cantilever_under_a_tip_force_is_the_elastica(row, validated):
    force, across, along, angle = row
    tip = end_under_tip_force(slender(), np.array([0.0, force]))
    actual = np.array([tip[2], 0.5 - tip[1], tip[0]])
    assert_close(actual, np.array([across, along, angle]), digits=8)
    exact = [across, along, angle]
    what = f"tip under P L²/E I = {force:g}"
    validated("Exact beams", what, actual, exact, "the elastica, by elliptic integrals")


def test_an_extensible_cantilever_is_the_published_one(validated):
    given = REFERENCE["extensible_cantilever_SI"]
    metal = tj.Material(modulus=given["E"], poisson=0.3)
    beam = tj.flexures.Beam(
        metal, length=given["L"], thickness=given["h"], width=given["b"],
        shear_factor=None,
    )  # fmt: skip
    force = 3 * given["E"] * given["b"] * given["h"] ** 3 / 12 / given["L"] ** 2
    tip = end_under_tip_force(beam, np.array([0.0, -force]))
    actual = np.array([tip[1] - given["L"] / 2, tip[2]])
    exact = [given["ux"], given["uy"]]
    np.testing.assert_allclose(actual, exact, rtol=1e-9)
    oracle = "a published benchmark of large deflections"
    validated("Exact beams", "tip of an extensible cantilever", actual, exact, oracle)


@pytest.mark.parametrize("row", REFERENCE["fixed_guided_leaf"]["rows"])
def test_a_leaf_that_is_displaced_without_rotation_shortens(row):
    across, force, along = row
    beam = slender()

    def rotation(moment):
        return np.asarray(beam_under_load(beam, [moment, 0.0, force]).pose)[0]

    moment = brentq(rotation, -force, force, xtol=1e-14)
    _, x, y = np.asarray(beam_under_load(beam, [moment, 0.0, force]).pose)
    np.testing.assert_allclose([y, -x], [across, along], rtol=3e-8)


@jax.jit
def energy_and_wrench(beam, pose):
    energy = tj.flexures.ExactBeam(beam)
    return energy(pose), energy.wrench(pose)


@pytest.mark.parametrize("law", mostly_slow(LAWS))
def test_the_wrench_of_an_exact_beam_is_the_derivative_of_its_energy(law):
    """Castigliano's theorem: the energy at the pose of a load gives this load again."""
    beam = leaf(law)
    solution = beam_under_load(beam, [0.08, 12.0, -9.0])
    energy, wrench = energy_and_wrench(beam, solution.pose)
    np.testing.assert_allclose(energy, solution.energy, rtol=1e-10)
    np.testing.assert_allclose(wrench, solution.wrench, rtol=1e-8)


def test_derivatives_with_respect_to_the_thickness_agree_with_differences():
    """The derivatives are those of the energy and of the wrench at a fixed pose."""
    pose = beam_under_load(leaf(), jnp.array([0.08, 12.0, -9.0])).pose

    def at_pose(thickness):
        return energy_and_wrench(leaf(thickness=thickness), pose)

    @jax.jit
    def with_slopes(thickness):
        return jax.jvp(at_pose, (thickness,), (jnp.ones(()),))

    step = 1e-7
    (_, slopes), (above, _), (below, _) = (
        jax.tree.map(np.asarray, with_slopes(thickness))
        for thickness in (1e-3, 1e-3 + step, 1e-3 - step)
    )
    for slope, high, low in zip(slopes, above, below, strict=True):
        np.testing.assert_allclose(slope, (high - low) / (2 * step), rtol=1e-6)


def errors_from_finite_elements(law):
    """Return errors of the wrenches of a leaf, as fractions of their sizes (rms)."""
    folder = pathlib.Path(__file__).parent / "reference"
    trials = tj.energies.read_trials(folder / "fe_leaf.csv")[np.arange(0, 122, 3)]
    expected = np.asarray(trials.wrenches)
    found = jax.jit(jax.vmap(tj.flexures.ExactBeam(leaf(law)).wrench))(trials.poses)
    errors = np.sqrt(np.mean((np.asarray(found) - expected) ** 2, axis=0))
    return errors / np.sqrt(np.mean(expected**2, axis=0))


def test_a_leaf_has_the_wrenches_of_finite_elements_with_the_same_law(validated):
    errors = errors_from_finite_elements("saint-venant-kirchhoff")
    assert np.all(errors < [0.015, 0.045, 0.02])
    what = "wrenches of a leaf, t/L = 0.1, rotations up to 46° (rms, worst component)"
    oracle = "41 plane finite-element analyses"
    validated("Exact beams", what, 1 + errors.max(), 1.0, oracle)


@pytest.mark.slow
def test_the_errors_of_the_linear_law_are_more_than_four_times_as_large():
    errors = errors_from_finite_elements("saint-venant-kirchhoff")
    assert np.all(errors_from_finite_elements("linear") > 4 * errors)


@pytest.mark.parametrize("law", mostly_slow(LAWS))
def test_the_stiffness_of_an_exact_beam_is_that_of_timoshenko(law):
    energy = tj.flexures.ExactBeam(leaf(law))
    stiffness = np.diag(jax.jit(lambda: energy.tangent_stiffness())())
    expected = tj.flexures.linear_leaf(
        POLYMER, length=10e-3, thickness=1e-3, width=5e-3, theory="timoshenko"
    ).stiffness
    np.testing.assert_allclose(stiffness, np.diag(expected), rtol=1e-9)


def test_a_beam_with_the_profile_of_a_notch_has_the_integrated_stiffness():
    """The reference is the integrals of Paros and Weisbord, with and without shear."""
    given = REFERENCE["notch_D3mm_h0.25mm_t20mm_E69GPa"]
    metal = tj.Material(modulus=69e9, poisson=0.33)

    profile = tj.flexures.notch_profile(hole=3e-3, web=0.25e-3)
    for factor, shear in ((None, "k_shear_1D_EB"), (5 / 6, "k_shear_1D_Timoshenko")):
        beam = tj.flexures.Beam(
            metal, length=3e-3, thickness=profile, width=20e-3, shear_factor=factor,
            steps=48,
        )  # fmt: skip
        load = 1e-6 * np.diag([1.0, 1e3, 1e3])
        stiffness = np.diag(load) / np.diag(beams_under_loads(beam, load).pose)
        expected = [given[name] for name in ("k_rot_1D_beam", "k_ax_1D_beam", shear)]
        np.testing.assert_allclose(stiffness, expected, rtol=1e-5)


def test_a_section_has_no_equilibrium_above_its_largest_moment():
    """With St. Venant-Kirchhoff, M = k - 0.3 (t / L)^2 k^3 has its maximum at 7.03."""
    beam = leaf("saint-venant-kirchhoff")

    def rotation(moment):
        load = [moment * float(beam.rotational_stiffness), 0.0, 0.0]
        return np.asarray(beam_under_load(beam, load).pose)[0]

    for moment in (5.0, 6.9):
        bound = np.sqrt(1 / 0.9) / 0.1
        exact = brentq(lambda k, m=moment: k - 3e-3 * k**3 - m, 0.0, bound)
        assert isinstance(exact, float)
        np.testing.assert_allclose(rotation(moment), exact, rtol=1e-8)
    assert np.isnan(rotation(7.1)) and np.isnan(rotation(8.0))


def test_the_stress_of_a_beam_in_bending_and_in_tension():
    """Bending by M gives M t / 2 I in the outermost fibers, and tension gives P / A."""
    beam = leaf()
    bent = beam_under_load(beam, jnp.array([0.05, 0.0, 0.0]))
    stress = 0.05 * 0.5e-3 / (5e-3 * (1e-3) ** 3 / 12)
    assert_close(bent.stress, np.full((21, 2), [-stress, stress]), digits=12)
    pulled = beam_under_load(beam, jnp.array([0.0, 20.0, 0.0])).stress
    assert_close(pulled, np.full((21, 2), 20.0 / 5e-6), digits=12)
    assert_close(tj.flexures.largest_rotation(beam, stress), 0.05 / 0.14375, digits=12)


def test_the_largest_stress_is_a_magnitude_in_tension_and_in_compression():
    """For a small load it is the stress of a straight beam, 6 M / w t^2 + P / w t."""
    beam, moment, force = leaf(), 1e-5, 0.02
    loads = np.array([[moment, force, 0.0], [moment, -force, 0.0]])
    solutions = beams_under_loads(beam, loads)
    bending, axial = 6 * moment / (5e-3 * 1e-3**2), force / (5e-3 * 1e-3)
    largest = np.asarray(tj.flexures.largest_stress(solutions))
    np.testing.assert_allclose(largest, [bending + axial] * 2, rtol=1e-3)
    compressed = jax.tree.map(lambda array: array[1], solutions)
    np.testing.assert_allclose(compressed.stress.max(), bending - axial, rtol=1e-3)
    assert tj.flexures.largest_stress(compressed) == largest[1]


def test_an_exact_beam_is_a_hinge_of_a_mechanism():
    """The equilibrium of a body at the end of a leaf is the state under a tip force.

    Newton's method needs few steps, also for a thin leaf: 730 without the model of it.
    """
    beam = leaf()
    bodies = [tj.Body("wall"), tj.Body("tip", pose=(0.0, 5e-3, 0.0))]
    hinge = tj.Hinge(
        "leaf", "wall", "tip", tj.flexures.ExactBeam(beam), at=(0.0, 0.0, 0.0)
    )
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    solution = tj.equilibrium(mechanism, loads=[tj.Load("tip", (0.0, 0.0, 8.0))])
    tip = end_under_tip_force(beam, np.array([0.0, 8.0]))
    np.testing.assert_allclose(solution.pose("tip"), tip, rtol=1e-7)
    without_load = tj.equilibrium(mechanism, loads=[tj.Load("tip", (0.0, 0.0, 0.0))])
    np.testing.assert_array_equal(without_load.displacements, 0.0)
    thin = leaf(thickness=0.1e-3)
    hinge = tj.Hinge("leaf", "wall", "tip", tj.flexures.ExactBeam(thin), at=(0, 0, 0))
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    for force in (2.0, 30.0):  # 0.7 and 10 E I / L^2
        load = tj.Load("tip", (0.0, 0.0, force * 4e-3))
        solution = tj.equilibrium(mechanism, loads=[load])
        tip = end_under_tip_force(thin, np.array([0.0, force * 4e-3]))
        np.testing.assert_allclose(solution.pose("tip"), tip, rtol=1e-7)
        assert int(solution.steps) < 60


@pytest.mark.release
def test_a_guide_of_exact_beams_needs_few_steps():
    """Without the rotation of the table, the force is twice that of one beam."""
    thin = leaf(thickness=0.1e-3)
    bodies = [tj.Body("base"), tj.Body("table", pose=(0.0, 10e-3, 0.0))]
    hinges = [
        tj.Hinge(name, "base", "table", tj.flexures.ExactBeam(thin), at=(0.0, 5e-3, y))
        for name, y in (("a", -10e-3), ("b", 10e-3))
    ]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["base"])
    stroke = tj.Drive("table", y=1e-3)
    assert int(tj.equilibrium(mechanism, drives=[stroke]).steps) < 10
    stroke = tj.Drive("table", angle=0.0, y=1e-3)
    found = tj.equilibrium(mechanism, drives=[stroke])
    assert int(found.steps) < 10
    one = tj.flexures.beam_at_pose(thin, found.displacement("table"))
    np.testing.assert_allclose(found.reaction("table")[2], 2 * one.wrench[2], rtol=1e-6)


def test_a_displacement_at_which_no_load_of_a_beam_is_found_is_reported():
    """Also if nothing is free, so that Newton's method has no residual."""
    beam = tj.flexures.ExactBeam(leaf(thickness=0.1e-3))
    bodies = [tj.Body("wall"), tj.Body("tip", pose=(0.0, 5e-3, 0.0))]
    hinge = tj.Hinge("leaf", "wall", "tip", beam, at=(0.0, 0.0, 0.0))
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    stretched = [tj.Drive("tip", angle=0.0, x=0.0, y=3e-3)]
    solution = tj.equilibrium(mechanism, drives=stretched, throw=False)
    assert str(tj.result_names(solution.result)) == "not_finite"
    assert np.all(np.isnan(solution.reactions))


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: leaf(thickness=-1e-3), "`thickness` is -0.001"),
        (lambda: leaf(length=0.0), "`length` is 0"),
        (lambda: leaf("rubber"), "'linear', 'saint-venant-kirchhoff'"),  # pyright: ignore[reportArgumentType]
        (
            lambda: leaf("saint-venant-kirchhoff", shear_factor=None),
            "`shear_factor` is None",
        ),
        (lambda: tj.flexures.largest_rotation(leaf(), -1.0), "`stress` is -1"),
        (lambda: tj.flexures.beam_at_pose(leaf(), [0.1, 0.0]), "(angle, x, y)"),
        (lambda: tj.flexures.beam_at_pose(leaf(), [0.1, np.nan, 0.0]), "has nan"),
        (lambda: tj.flexures.beam_under_load(leaf(), [np.inf, 0.0, 0.0]), "has inf"),
    ],
)
def test_an_invalid_argument_raises_an_error(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert message in str(error.value)


@pytest.mark.parametrize("thickness", [0.1, 0.01, 0.002])
def test_the_load_at_a_pose_is_found_for_any_thickness(thickness):
    """The poses of random loads, with rotations up to 100 degrees, give these loads."""
    leaf = tj.flexures.Beam(POLYMER, length=1.0, thickness=thickness, width=0.1)
    stiffness = float(leaf.rotational_stiffness)
    loads = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 3))
    expected = beams_under_loads(leaf, loads * [1.5, 6.0, 6.0] * stiffness)
    assert np.abs(np.asarray(expected.pose)[:, 0]).max() > 1.7
    actual = beams_at_poses(leaf, expected.pose)
    difference = (np.asarray(actual.wrench) - np.asarray(expected.wrench)) / stiffness
    np.testing.assert_allclose(difference, 0.0, atol=1e-9)


def test_a_pose_and_a_load_may_be_lists():
    """The result is that of arrays, and the load at the pose is the given one."""
    load = [0.1, 2.0, -1.0]
    solution = tj.flexures.beam_under_load(leaf(), load)
    of_array = tj.flexures.beam_under_load(leaf(), jnp.array(load))
    np.testing.assert_array_equal(solution.pose, of_array.pose)
    found = tj.flexures.beam_at_pose(leaf(), [float(entry) for entry in solution.pose])
    np.testing.assert_allclose(found.wrench, solution.wrench, rtol=1e-8, atol=1e-10)
