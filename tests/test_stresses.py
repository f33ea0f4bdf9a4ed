"""Stresses in hinges whose dimensions are known."""

import json
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mostly_slow, value_and_slopes, with_value

import twistorjax as tj
from twistorjax import flexures
from twistorjax.energies.dilation import dilated
from twistorjax.energies.stress_model import Strengths
from twistorjax.flexures.beams.stress_models import MechanismStress, SectionStress


STEEL = tj.Material(modulus=210e9, poisson=0.3, expansion=12e-6, strength=400e6)
STRONG = tj.Material(
    modulus=210e9,
    poisson=0.3,
    strength=600e6,
    ultimate_strength=800e6,
    endurance_limit=300e6,
)
SIZES: dict[str, Any] = {"length": 50e-3, "thickness": 0.5e-3, "width": 10e-3}
LEAF = flexures.linear_leaf(STEEL, **SIZES)
PUSH = tj.Load("block", moment=0.04, force=(1.0, 0.5))


def reported(solution) -> tj.Stresses:
    """Return the stresses that a solution reports."""
    assert solution.stresses is not None
    return solution.stresses


def cantilever(energy, **settings):
    """Return a block at the end of a flexure of 50 mm that is clamped at a wall."""
    bodies = [tj.Body("wall"), tj.Body("block", (0.0, 25e-3, 0.0), 0.1, 1e-4)]
    hinge = tj.Hinge("flexure", "wall", "block", energy, at=(0, 0, 0), **settings)
    return tj.Mechanism(bodies, [hinge], fixed=["wall"])


@pytest.fixture(scope="module")
def surrogate():
    return tj.surrogate(flexures.Beam(STEEL, **SIZES), rotation=0.3, force=30.0)


def test_the_stress_of_a_leaf_is_that_at_its_clamped_end():
    """The load is so small that the equations are those of the undeformed leaf."""
    mechanism, small = cantilever(LEAF), 1e-5
    moment, axial, transverse = 0.04 * small, 20.0 * small, 0.5 * small
    load = tj.Load("block", moment=moment, force=(axial, transverse))
    found = tj.stresses(mechanism, tj.equilibrium(mechanism, loads=[load]))
    clamped = moment + transverse * SIZES["length"]
    area = SIZES["width"] * SIZES["thickness"]
    expected = 6 * clamped / (area * SIZES["thickness"]) + axial / area
    np.testing.assert_allclose(found.of("flexure"), expected, rtol=1e-4)


def test_the_stress_of_a_notch_is_notch_stress():
    sizes: dict[str, Any] = {"hole": 3e-3, "web": 0.25e-3, "width": 20e-3}
    mechanism = cantilever(flexures.notch(STEEL, **sizes))
    pushed = tj.equilibrium(mechanism, loads=[tj.Load("block", moment=0.01)])

    @jax.jit
    def stress(poses):
        return flexures.notch_stress(mechanism.wrench_of("flexure", poses), **sizes)

    expected = stress(pushed.poses)
    np.testing.assert_allclose(reported(pushed).of("flexure"), expected, rtol=1e-6)


def check_stress_of_a_surrogate(beam, surrogate):
    """The oracle finds the load of the exact beam at the displacement of the hinge."""
    mechanism = cantilever(surrogate)
    pushed = tj.equilibrium(mechanism, loads=[PUSH])
    pose = jax.jit(lambda poses: mechanism.displacement_of("flexure", poses))
    exact = flexures.beam_at_pose(beam, pose(pushed.poses))
    expected = flexures.largest_stress(exact)
    assert float(expected) > 5e7
    np.testing.assert_allclose(reported(pushed).of("flexure"), expected, rtol=2e-3)


def test_the_stress_of_a_surrogate_is_that_of_the_deformed_beam(surrogate):
    check_stress_of_a_surrogate(flexures.Beam(STEEL, **SIZES), surrogate)


@pytest.mark.slow
def test_the_stress_of_a_curved_surrogate_is_that_of_the_deformed_beam():
    curved = flexures.Beam(STEEL, **SIZES, curvature=8.0)
    check_stress_of_a_surrogate(curved, tj.surrogate(curved, rotation=0.3, force=30.0))


@pytest.mark.parametrize(
    ("create", "profile", "sizes"),
    [
        (
            flexures.filleted_leaf,
            flexures.filleted_leaf_profile,
            {"thickness": 0.5e-3, "fillet": 2e-3},
        ),
        (
            flexures.elliptical_notch,
            flexures.elliptical_notch_profile,
            {"web": 0.5e-3, "depth": 4e-3},
        ),
    ],
)
def test_the_stress_of_a_contour_is_that_of_a_beam(create, profile, sizes):
    length, width = 20e-3, 10e-3
    mechanism = cantilever(create(STEEL, length=length, width=width, **sizes))
    beam = flexures.Beam(
        STEEL, length=length, width=width, thickness=profile(length=length, **sizes)
    )
    moment, axial, transverse = 1e-6, 5e-4, 1e-4
    load = tj.Load("block", moment=moment, force=(axial, transverse))
    found = reported(tj.equilibrium(mechanism, loads=[load])).of("flexure")
    about_frame = jnp.array([moment + 25e-3 * transverse, axial, transverse])
    expected = flexures.largest_stress(flexures.beam_under_load(beam, about_frame))
    np.testing.assert_allclose(found, expected, rtol=1e-3)


@pytest.mark.slow
def test_flexures_in_parallel_share_the_wrench():
    """Under twice the load, two equal leaves have the stress of one of them."""
    one = reported(tj.equilibrium(cantilever(LEAF), loads=[PUSH]))
    for energy in (2.0 * LEAF, LEAF + LEAF):
        both = reported(tj.equilibrium(cantilever(energy), loads=[PUSH, PUSH]))
        assert both.names == ("flexure",)
        np.testing.assert_allclose(both.largest, one.largest, rtol=1e-9)


def test_a_clamped_warm_leaf_has_the_thermal_stress():
    expansion = tj.Expansion(STEEL, length=SIZES["length"])
    bodies = [tj.Body("wall"), tj.Body("block", (0.0, 25e-3, 0.0))]
    hinge = tj.Hinge("leaf", "wall", "block", LEAF, at=(0, 0, 0), expansion=expansion)
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall", "block"])
    warm = mechanism.at_temperature(5.0)
    found = tj.stresses(warm, warm.reference).of("leaf")
    np.testing.assert_allclose(found, 210e9 * 12e-6 * 5.0, rtol=2e-4)


def test_stresses_are_reported_if_a_strength_is_given():
    pushed = tj.equilibrium(cantilever(LEAF), loads=[PUSH])
    utilization = float(reported(pushed).utilization[0])
    assert "largest stress over strength: 0.364, 145.5 MPa in 'flexure'" in str(pushed)
    assert float(reported(pushed).safety_factor) == pytest.approx(1 / utilization)
    table = pushed.to_xarray()
    assert table.stress.attrs["units"] == "Pa" and list(table.hinge) == ["flexure"]
    weak = tj.Material(modulus=210e9, poisson=0.3)
    silent = cantilever(flexures.linear_leaf(weak, **SIZES))
    unknown = tj.equilibrium(silent, loads=[PUSH])
    assert unknown.stresses is None
    found = tj.stresses(silent, unknown)
    assert str(found).splitlines()[1].split() == ["flexure", "145.5", "-"]


@pytest.mark.slow
def test_stresses_along_a_path_and_in_a_motion():
    mechanism = cantilever(STRONG_LEAF)
    path = tj.path(mechanism, loads=[PUSH], load_factors=(0.0, 1.0))
    assert reported(path).largest.shape == (len(path.load_factors), 1)
    last = reported(tj.equilibrium(mechanism, loads=[PUSH]))
    np.testing.assert_allclose(reported(path).largest[-1], last.largest, rtol=1e-8)
    at_points = tj.stresses(mechanism, path)
    np.testing.assert_allclose(at_points.largest, reported(path).largest, rtol=1e-9)
    motion = tj.simulate(mechanism, [0.0, 1e-3, 2e-3], loads=[PUSH])
    in_motion = tj.stresses(mechanism, motion)
    assert in_motion.largest.shape == (3, 1) and float(in_motion.largest[0, 0]) == 0.0
    assert np.all(np.diff(in_motion.largest[:, 0]) > 0)
    largest = f"largest {float(in_motion.largest[-1, 0]) / 1e6:.4g} MPa in"
    assert f"shape (3, 1), the last axis for hinges; {largest}" in repr(in_motion)


def test_the_derivative_of_the_safety_factor_of_a_leaf():
    """The moment is so small that the stress is proportional to it."""

    def safety(share):
        load = tj.Load("block", moment=1e-6 * share)
        found = tj.equilibrium(cantilever(LEAF), loads=[load], throw=False)
        return reported(found).safety_factor

    slope, value = jax.jit(jax.jacrev(with_value(safety), has_aux=True))(2.0)
    np.testing.assert_allclose(slope, -value / 2, rtol=1e-9)


@pytest.mark.release
def test_derivatives_of_the_safety_factor(surrogate):
    mechanism = cantilever(surrogate)

    def safety(force):
        load = tj.Load("block", moment=0.04, force=(20.0, force))
        return reported(tj.equilibrium(mechanism, loads=[load])).safety_factor

    step = 1e-4
    differentiate = jax.jit(jax.vmap(partial(value_and_slopes, safety)))
    at = jnp.array([0.5, 0.6, 0.5 + step, 0.5 - step])
    batch, *slopes = map(np.asarray, differentiate(at))
    expected = (batch[2] - batch[3]) / (2 * step)
    for slope in slopes:
        np.testing.assert_allclose(slope[0], expected, rtol=1e-6)
    np.testing.assert_allclose(batch[:2], [safety(0.5), safety(0.6)], rtol=1e-10)


@pytest.mark.parametrize("kind", mostly_slow(["surrogate", "linear", "quartic"], 2))
def test_stresses_of_a_saved_mechanism(surrogate, tmp_path, kind):
    quartic = flexures.quartic_leaf(STEEL, **SIZES)
    energies = {"surrogate": surrogate, "linear": LEAF, "quartic": quartic}
    mechanism = cantilever(energies[kind])
    tj.io.save_mechanism(mechanism, tmp_path / "saved.json")
    loaded = tj.io.load_mechanism(tmp_path / "saved.json")
    before, after = (
        reported(tj.equilibrium(each, loads=[PUSH])) for each in (mechanism, loaded)
    )
    np.testing.assert_array_equal(before.largest, after.largest)
    np.testing.assert_array_equal(before.strength, after.strength)


@pytest.fixture(scope="module")
def pivot():
    """Return a surrogate of a pivot of two leaves that cross in their middles."""
    leaf = flexures.linear_leaf(STRONG, **SIZES, coordinates="twist")
    beam = flexures.Beam(STRONG, **SIZES)
    part = flexures.cross_spring_pivot(beam, 2.0 * leaf)  # two leaves in one plane each
    return tj.surrogate(part, rotation=0.3, force=20.0)


def arc_stress(angle):
    """Stress in a leaf that is bent to an arc: E t angle / (2 L); Pa."""
    return 210e9 * SIZES["thickness"] * angle / (2 * SIZES["length"])


@pytest.mark.release
def test_a_surrogate_of_a_pivot_has_a_range_of_motion_and_a_fatigue_life(pivot):
    """A pure rotation bends both leaves to arcs, whose stress is proportional to it."""
    mechanism = cantilever(pivot)
    drives = [tj.Drive("block", angle=0.1)]
    bent = tj.equilibrium(mechanism, drives=drives)
    np.testing.assert_allclose(reported(bent).largest[0], arc_stress(0.1), rtol=1e-6)
    assert reported(bent).strength[0] == 600e6
    found = tj.range_of_motion(mechanism, drives=drives, stress=200e6)
    np.testing.assert_allclose(found.factors, [-1.904762, 1.904762], rtol=1e-6)
    assert np.all(found.by_stress)
    life = tj.fatigue(mechanism, found)
    np.testing.assert_allclose(life.amplitude, [200e6], rtol=1e-6)
    np.testing.assert_allclose(life.utilization, [200 / 300], rtol=1e-5)


@pytest.mark.slow
def test_the_stress_of_a_pivot_is_that_of_its_leaves(pivot, tmp_path):
    """Under forces, in a pivot of other dimensions, and after it was saved."""

    def stress_in(energy, state):
        hinge = tj.Hinge("pivot", "A", "B", energy, at=(0, 0, 0))
        mechanism = tj.Mechanism([tj.Body("A"), tj.Body("B")], [hinge], fixed=["A"])
        return tj.stresses(mechanism, np.stack([np.zeros(3), state])).largest

    state = np.array([0.2, 1e-7, 2e-7])  # forces of 6 N and 7 N
    leaf = flexures.linear_leaf(STRONG, **SIZES, coordinates="twist")
    part = flexures.cross_spring_pivot(flexures.Beam(STRONG, **SIZES), leaf)
    exact = tj.stresses(part.mechanism, np.stack([np.zeros(3), state])).largest
    found = stress_in(pivot, state)
    np.testing.assert_allclose(found, [np.max(exact)], rtol=1e-6)
    larger = dilated(pivot, jnp.array(1.3))
    same = stress_in(larger, state * np.array([1.0, 1.3, 1.3]))
    np.testing.assert_allclose(same, found, rtol=1e-9)
    tj.io.save_energy(pivot, tmp_path / "pivot.json")
    loaded = tj.io.load_energy(tmp_path / "pivot.json")
    np.testing.assert_array_equal(stress_in(loaded, state), found)


def damaged_entries():
    """List invalid numbers in a file of a surrogate or of a leaf."""
    for value in (-1.0, 0.0):
        for entry in ("length", "width", "modulus", "bending_factor", "shear_ratio"):
            yield "beam", (entry,), value
        yield "beam", ("thickness", 7), value
        yield "beam", ("strengths", "static"), value
        yield "leaf", ("thickness",), value
        yield "leaf", ("width",), value
    yield "leaf", ("arm",), -1.0
    yield "leaf", ("ratio",), -1.0


@pytest.mark.parametrize(("kind", "entry", "value"), list(damaged_entries()))
def test_negative_dimensions_in_a_file_are_rejected(
    surrogate, tmp_path, kind, entry, value
):
    path = tmp_path / "energy.json"
    tj.io.save_energy(surrogate if kind == "beam" else LEAF, path)
    content = json.loads(path.read_text())
    owner = content["energy"]["stress_model"]
    for key in entry[:-1]:
        owner = owner[key]
    owner[entry[-1]] = value
    path.write_text(json.dumps(content))
    name = "thickness[7]" if entry == ("thickness", 7) else entry[-1]
    requirement = "zero or positive" if name in ("arm", "ratio") else "positive"
    with pytest.raises(ValueError) as error:
        tj.io.load_energy(path)
    message = f"`{name}` is {value:g}, but must be {requirement} and finite."
    assert str(error.value).startswith(f"{path}: the entry `energy.stress_model")
    assert str(error.value).endswith(message)


@pytest.mark.slow
def test_coefficients_of_another_shape_in_a_file_are_rejected(pivot, tmp_path):
    path = tmp_path / "pivot.json"
    tj.io.save_energy(pivot, path)
    content = json.loads(path.read_text())
    content["energy"]["stress_model"]["coefficients"][1].pop()
    path.write_text(json.dumps(content))
    message = r"coefficients\[1\]` is a list of 5 entries, but must be a list of 6"
    with pytest.raises(ValueError, match=message):
        tj.io.load_energy(path)


def test_stress_models_check_their_values():
    model = LEAF.stress_model
    assert isinstance(model, SectionStress)
    with pytest.raises(ValueError, match="`arm` is -1, but must be zero or positive"):
        replace(model, arm=jnp.asarray(-1.0))
    with pytest.raises(ValueError, match="`ultimate` is 0, but must be positive and"):
        Strengths(ultimate=jnp.asarray(0.0))
    settings: dict[str, Any] = {
        "parts": (model,),
        "coefficients": jnp.zeros((1, 6, 2)),
        "length": jnp.asarray(0.4),
        "force": jnp.asarray(3.0),
        "strengths": Strengths(),
        "freedom": "rotation",
    }
    with pytest.raises(ValueError, match=r"must have the shape \(1, 6, 1\): six rows"):
        MechanismStress(**settings, powers=((0, 0, 0),))
    with pytest.raises(ValueError, match=r"\(0, 0\), but must be 3 whole numbers"):
        MechanismStress(**settings, powers=((0, 0),))
    settings |= {"parts": (), "coefficients": jnp.zeros((0, 6, 1))}
    with pytest.raises(ValueError, match="`parts`, at least one"):
        MechanismStress(**settings, powers=((0, 0, 0),))


def test_errors():
    plain = cantilever(tj.Quadratic(LEAF.stiffness))
    with pytest.raises(ValueError, match="The stress is not known in any hinge"):
        tj.stresses(plain, plain.reference)
    known = reported(tj.equilibrium(cantilever(LEAF), loads=[PUSH]))
    with pytest.raises(ValueError, match="names the hinge 'flexur', but the hinges are"):
        known.of("flexur")
    with pytest.raises(ValueError, match="`endurance_limit` is -1"):
        tj.Material(modulus=210e9, poisson=0.3, endurance_limit=-1.0)


STRONG_LEAF = flexures.linear_leaf(STRONG, **SIZES)


def test_the_life_of_a_bent_leaf_follows_the_goodman_relation():
    """A moment M gives the stress 6 M / (w t^2) on one side, and its opposite there."""
    mechanism = cantilever(STRONG_LEAF)
    states = [
        tj.equilibrium(mechanism, loads=[tj.Load("block", moment=moment)])
        for moment in (0.05, 0.0, 0.15)
    ]
    found = tj.fatigue(mechanism, states)
    per_moment = 6 / (SIZES["width"] * SIZES["thickness"] ** 2)
    amplitude = mean = 0.075 * per_moment  # from zero to the largest moment
    np.testing.assert_allclose(found.amplitude, [amplitude], rtol=1e-9)
    np.testing.assert_allclose(found.mean, [mean], rtol=1e-9)
    utilization = amplitude / 300e6 + mean / 800e6
    np.testing.assert_allclose(found.utilization, [utilization], rtol=1e-9)
    np.testing.assert_allclose(found.safety_factor, 1 / utilization, rtol=1e-9)
    assert np.asarray(found.infinite_life).all() and "infinite" in str(found)


@pytest.mark.slow
def test_the_life_along_a_path_is_that_between_its_ends():
    mechanism = cantilever(STRONG_LEAF)
    loads = [tj.Load("block", moment=0.15)]
    path = tj.path(mechanism, loads=loads, load_factors=(0.0, 1.0))
    ends = [mechanism.reference, tj.equilibrium(mechanism, loads=loads)]
    along, between = tj.fatigue(mechanism, path), tj.fatigue(mechanism, ends)
    np.testing.assert_allclose(along.utilization, between.utilization, rtol=1e-8)


def test_a_compressive_mean_stress_does_not_prolong_the_life():
    """The largest range of stress is on the side that is always in compression."""
    mechanism = cantilever(STRONG_LEAF)
    squeezed = [
        tj.equilibrium(mechanism, loads=[tj.Load("block", force=(force, 0.0))])
        for force in (-1.0, -2.5)
    ]
    found = tj.fatigue(mechanism, squeezed)
    area = SIZES["width"] * SIZES["thickness"]
    np.testing.assert_allclose(found.mean, [-1.75 / area], rtol=1e-6)
    np.testing.assert_allclose(found.utilization, [0.75 / area / 300e6], rtol=1e-6)


def test_errors_of_fatigue():
    mechanism = cantilever(LEAF)
    with pytest.raises(ValueError, match="No material has an endurance limit"):
        tj.fatigue(mechanism, [mechanism.reference] * 2)
    strong = cantilever(STRONG_LEAF)
    with pytest.raises(ValueError, match="`cycle` has one state"):
        tj.fatigue(strong, tj.equilibrium(strong, loads=[PUSH]))


@pytest.mark.slow
def test_compiled_batches_have_the_derivatives_of_single_equilibria(surrogate):
    """A compiled program may compute a stress twice with other rounding errors."""
    mechanism = cantilever(surrogate)

    def stress(force):
        load = tj.Load("block", moment=0.04, force=(20.0, force))
        return reported(tj.equilibrium(mechanism, loads=[load], throw=False)).largest[0]

    forces = jnp.linspace(0.5, 0.8, 7)
    slope = jax.grad(stress)
    compiled = jax.jit(jax.vmap(slope))(forces)
    np.testing.assert_allclose(compiled, [slope(f) for f in forces], rtol=1e-9)
