"""Ranges of motion that are limited by stress or by stability."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import value_and_slopes, with_value

import twistorjax as tj
from twistorjax import flexures
from twistorjax.examples import stage


STEEL = tj.Material(modulus=210e9, poisson=0.3)
SIZES: dict[str, Any] = {"length": 50e-3, "thickness": 0.5e-3, "width": 10e-3}
ALLOWABLE = 300e6


def cantilever(energy, **fixed):
    """Return a block at the end of a flexure of 50 mm that is clamped at a wall."""
    bodies = [tj.Body("wall"), tj.Body("block", (0.0, 25e-3, 0.0))]
    hinge = tj.Hinge("flexure", "wall", "block", energy, at=(0, 0, 0))
    return tj.Mechanism(bodies, [hinge], fixed=["wall"], **fixed)


def leaf(thickness=SIZES["thickness"]):
    return flexures.linear_leaf(STEEL, **{**SIZES, "thickness": thickness})


@pytest.mark.slow
def test_the_range_in_pure_bending(validated):
    """A leaf is bent to an arc, up to the rotation 2 stress length / (E thickness).

    Two leaves in the same place are those of a pivot with another geometry. The leaves of
    a cross-spring pivot are bent to arcs at small rotations only. At 300 MPa they carry
    forces as well, and the range is 11 % smaller.
    """
    beam = flexures.Beam(STEEL, **SIZES)
    energy = tj.surrogate(beam, rotation=0.4)
    arc = 2 * ALLOWABLE * SIZES["length"] / (210e9 * SIZES["thickness"])
    hinges = [
        tj.Hinge(name, "wall", "block", energy, at=(0, 0, 0)) for name in ("one", "two")
    ]
    bodies = [tj.Body("wall"), tj.Body("block", (0.0, 25e-3, 0.0))]
    double = tj.Mechanism(bodies, hinges, fixed=["wall"])
    found = tj.range_of_motion(
        double, drives=[tj.Drive("block", angle=0.1)], stress=ALLOWABLE
    )
    rotations = found.displacement("block")[:, 0]
    np.testing.assert_allclose(rotations, [-arc, arc], rtol=1e-3)
    what = "leaf under a moment, largest rotation at 300 MPa (rad)"
    validated("Stresses", what, float(rotations[1]), arc, "arc, 2 σ L / (E t)")
    pivot = flexures.cross_spring_pivot(beam, energy)
    turn = tj.Drive(pivot.second, angle=0.1)
    for stress, ratio in ((ALLOWABLE / 100, 1.0), (ALLOWABLE, 0.8916)):
        found = tj.range_of_motion(pivot.mechanism, drives=[turn], stress=stress)
        expected = ratio * arc * stress / ALLOWABLE
        rotations = found.displacement(pivot.second)[:, 0]
        np.testing.assert_allclose(rotations, [-expected, expected], rtol=2e-3)
    leaf = pivot.mechanism.hinge_names[0]
    pose = pivot.mechanism.displacement_of(
        leaf, found.displacements[1] + pivot.mechanism.reference
    )
    exact = flexures.largest_stress(flexures.beam_at_pose(beam, pose))
    np.testing.assert_allclose(exact, ALLOWABLE, rtol=1e-3)


def test_the_stresses_of_the_stage_are_those_of_its_notches():
    mechanism = stage.microstage()
    moved = tj.equilibrium(mechanism, drives=[tj.Drive("6", x=1.35e-6)])
    found = tj.stresses(mechanism, moved)
    assert found.names == tuple("abcdefg")

    @jax.jit
    def expected(poses):
        wrenches = jnp.stack([mechanism.wrench_of(name, poses) for name in found.names])
        sizes = {"hole": 3e-3, "web": 0.25e-3, "width": 20e-3}
        return jax.vmap(lambda wrench: flexures.notch_stress(wrench, **sizes))(wrenches)

    np.testing.assert_allclose(found.largest, expected(moved.poses), rtol=2e-3)


# Moment at which a leaf has the allowable stress; N m
LARGEST = ALLOWABLE * SIZES["width"] * SIZES["thickness"] ** 2 / 6


def range_under_moments(constant, **settings):
    """Range of motion of a leaf under a moment of 0.01 N m, and a constant one; N m."""
    return tj.range_of_motion(
        cantilever(leaf()),
        loads=[tj.Load("block", moment=0.01)],
        constant_loads=[tj.Load("block", moment=constant)],
        **settings,
    )


def test_a_constant_moment_shifts_the_range_of_a_leaf():
    """Under moments only, stress and rotation are proportional to the moment."""
    found = range_under_moments(0.3 * LARGEST, stress={"flexure": ALLOWABLE})
    expected = np.array([-1.3, 0.7]) * LARGEST / 0.01
    np.testing.assert_allclose(found.factors, expected, rtol=1e-9)
    stresses = np.asarray(found.stresses.largest)
    np.testing.assert_allclose(stresses[:, 0], ALLOWABLE, rtol=1e-9)
    halved = range_under_moments(0.0, stress=ALLOWABLE, safety_factor=2.0)
    expected = np.array([-0.5, 0.5]) * LARGEST / 0.01
    np.testing.assert_allclose(halved.factors, expected, rtol=1e-9)


def buckling_force(mechanism):
    """Axial force at which the stiffness of a cantilever has the determinant zero; N."""

    @jax.jit
    def force_and_determinant(shortening):
        def energy(pose):
            return mechanism.energy(mechanism.reference.at[1].add(pose))

        pose = jnp.array([0.0, -1.0, 0.0]) * shortening
        force, stiffness = -jax.grad(energy)(pose)[1], jax.hessian(energy)(pose)
        return force, jnp.linalg.det(stiffness)

    at = scipy.optimize.brentq(
        lambda shortening: float(force_and_determinant(shortening)[1]),
        0.0,
        2e-6,
        xtol=1e-16,
    )
    return float(force_and_determinant(at)[0])


def test_a_column_ends_where_it_buckles():
    """In tension the stress limits the range, in compression the stability."""
    mechanism = cantilever(flexures.leaf(STEEL, **SIZES))
    pull = tj.Load("block", force=(1.0, 0.0))
    found = tj.range_of_motion(mechanism, loads=[pull], stress=ALLOWABLE)
    critical = buckling_force(mechanism)
    np.testing.assert_array_equal(found.by_stress, [False, True])
    backward, forward = np.asarray(found.factors)
    np.testing.assert_allclose(-backward, critical, rtol=2e-6)
    area = SIZES["width"] * SIZES["thickness"]
    np.testing.assert_allclose(forward, ALLOWABLE * area, rtol=1e-9)
    backward, forward = str(found).splitlines()[1:]
    assert backward.endswith("stability") and forward.endswith("stress in 'flexure'")


def weak_arch(modulus):
    """Two bars of a shallow arch, whose apex a weak leaf supports."""
    half, angle = np.hypot(1.0, 0.3), np.arctan2(0.3, 1.0)
    bar = tj.energies.AxialSpring(modulus / 210e6, length=half)
    soft = tj.Material(modulus=1e-3 * modulus, poisson=0.3)
    support = flexures.linear_leaf(soft, length=1.0, thickness=5e-3, width=10e-3)
    bodies = [tj.Body("wall"), tj.Body("apex", pose=(0.0, 0.0, 0.3))]
    hinges = [
        tj.Hinge("left", "wall", "apex", bar, at=(angle, -0.5, 0.15)),
        tj.Hinge("right", "apex", "wall", bar, at=(-angle, 0.5, 0.15)),
        tj.Hinge("support", "wall", "apex", support, at=(0.0, 0.0, 0.3)),
    ]
    fixed = {"wall": ["angle", "x", "y"], "apex": ["angle"]}
    return tj.Mechanism(bodies, hinges, fixed=fixed)


@pytest.mark.release
def test_derivatives_of_ends_by_stability():
    """Buckling and snapping forces are in proportion to the modulus.

    Two equal columns that are not connected end at a double branch point, and on the
    other side where their sections have the allowable stress. The arch ends at a limit
    point when it is pushed.
    """

    def columns(modulus):
        energy = flexures.leaf(tj.Material(modulus=modulus, poisson=0.3), **SIZES)
        names = ("one", "two")
        bodies = [tj.Body("wall"), *(tj.Body(name, (0.0, 25e-3, 0.0)) for name in names)]
        hinges = [tj.Hinge(name, "wall", name, energy, at=(0, 0, 0)) for name in names]
        pull = [tj.Load(name, force=(1.0, 0.0)) for name in names]
        return tj.Mechanism(bodies, hinges, fixed=["wall"]), pull

    def arch(modulus):
        return weak_arch(modulus), [tj.Load("apex", force=(0.0, -1.0))]

    def logarithms(case, scale):
        mechanism, loads = case(210e9 * scale)
        found = tj.range_of_motion(mechanism, loads=loads, stress=ALLOWABLE, throw=False)
        return jnp.log(jnp.abs(found.factors))

    both = jax.jacrev(partial(logarithms, columns))(1.0)
    np.testing.assert_allclose(both, [1.0, 0.0], atol=1e-5)
    _, forward = jax.jacfwd(partial(logarithms, arch))(1.0)
    np.testing.assert_allclose(forward, 1.0, atol=1e-5)


@pytest.mark.slow
def test_the_stroke_of_an_actuator_against_a_leaf():
    """The actuator is much stiffer than the leaf, so the block moves by its stroke."""
    stiff = tj.Quadratic(np.diag([1e6, 1e9, 1e9]))
    bodies = [tj.Body("wall"), tj.Body("block", (0.0, 25e-3, 0.0))]
    hinges = [
        tj.Hinge("flexure", "wall", "block", leaf(), at=(0, 0, 0)),
        tj.Hinge("actuator", "wall", "block", stiff, at=(0, 25e-3, 0)),
    ]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["wall"])
    stroke = {"actuator": (0.0, 0.0, 1e-4)}
    found = tj.range_of_motion(mechanism, strokes=stroke, stress=ALLOWABLE)
    at_end = tj.equilibrium(
        mechanism.with_strokes({"actuator": (0.0, 0.0, 1e-4 * found.factors[1])})
    )
    stress = tj.stresses(mechanism, found.displacements[1] + mechanism.reference)
    np.testing.assert_allclose(stress.of("flexure"), ALLOWABLE, rtol=1e-6)
    np.testing.assert_allclose(found.displacements[1], at_end.displacements, atol=1e-12)


def test_the_origin_of_a_body_has_no_effect():
    """A force that stabilizes the mechanism may act beside the origin of its body."""

    def ends(origin, direction, stress):
        bodies = [tj.Body("wall"), tj.Body("block", (0.0, origin, 0.0))]
        energy = flexures.leaf(STEEL, **SIZES)
        hinge = tj.Hinge("flexure", "wall", "block", energy, at=(0, 0, 0))
        mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        load = tj.Load("block", force=direction, at=(25e-3 - origin, 0.0))
        found = tj.range_of_motion(mechanism, loads=[load], stress=stress)
        assert np.all(found.by_stress)
        return found.factors

    for direction, stress in (((35.0, 0.4), 200e6), ((30.0, 1.0), 200e6)):
        at_the_hinge, at_the_tip = (ends(x, direction, stress) for x in (0.0, 25e-3))
        np.testing.assert_allclose(at_the_hinge, at_the_tip, rtol=1e-8)


@pytest.mark.slow
def test_the_unit_of_a_stroke_has_no_effect():
    """Stretching one of two leaves rotates the table, without any instability."""
    energy, up = flexures.quartic_leaf(STEEL, **SIZES), np.pi / 2
    hinges = [
        tj.Hinge("left", "wall", "table", energy, at=(up, -40e-3, 25e-3)),
        tj.Hinge("right", "wall", "table", energy, at=(up, 40e-3, 25e-3)),
    ]
    bodies = [tj.Body("wall"), tj.Body("table", (0.0, 0.0, 50e-3))]
    guide = tj.Mechanism(bodies, hinges, fixed=["wall"])
    strokes = []
    for unit in (1e-6, 1e-5, 1e-4):
        found = tj.range_of_motion(
            guide, strokes={"left": (0.0, unit, 0.0)}, stress=ALLOWABLE
        )
        assert np.all(found.by_stress)
        strokes.append(unit * found.factors)
    np.testing.assert_allclose(strokes[1:], strokes[:-1], rtol=1e-8)


@pytest.mark.slow
def test_hinges_without_an_allowable_stress_keep_their_strength():
    strong = tj.Material(modulus=210e9, poisson=0.3, strength=200e6)
    energy = flexures.linear_leaf(strong, **SIZES)
    hinges = [
        tj.Hinge(name, "wall", "block", energy, at=(0, 0, 0)) for name in ("one", "two")
    ]
    bodies = [tj.Body("wall"), tj.Body("block")]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["wall"])
    moment = tj.Load("block", moment=0.01)
    by_strength = tj.range_of_motion(mechanism, loads=[moment])
    for stress in ({"one": 300e6}, {}):
        found = tj.range_of_motion(mechanism, loads=[moment], stress=stress)
        np.testing.assert_allclose(found.factors, by_strength.factors, rtol=1e-9)


def test_a_range_outside_that_of_a_linear_leaf_causes_a_warning():
    with pytest.warns(UserWarning, match="times the one at which its force"):
        range_under_moments(0.0, stress=3e9)


@pytest.mark.slow
def test_derivatives_of_the_range_in_pure_bending():
    """The moment at the ends is stress times width times thickness squared over 6."""

    def ends(at):
        thickness, stress = at
        moment = tj.Load("block", moment=0.01)
        found = tj.range_of_motion(
            cantilever(leaf(thickness)), loads=[moment], stress=stress, throw=False
        )
        return found.factors

    at = np.array([SIZES["thickness"], 1e-3 * ALLOWABLE])
    differentiate = jax.jit(jax.jacfwd(with_value(ends), has_aux=True))
    slopes, factors = differentiate(at)
    expected = np.array([-1.0, 1.0]) * at[1] * SIZES["width"] * at[0] ** 2 / 6 / 0.01
    np.testing.assert_allclose(factors, expected, rtol=1e-9)
    shares = np.asarray(slopes) * at / expected[:, None]
    np.testing.assert_allclose(shares, [[2.0, 1.0]] * 2, rtol=1e-8)


@pytest.mark.release
def test_derivatives_of_the_range():
    def far(at):
        thickness, stress = at
        energy = flexures.quartic_leaf(STEEL, **{**SIZES, "thickness": thickness})
        found = tj.range_of_motion(
            cantilever(energy), loads=[tj.Load("block", force=(0.3, 1.0))], stress=stress
        )
        return jnp.concatenate([found.factors, found.displacement("block")[1]])

    differentiate = jax.jit(partial(value_and_slopes, far))
    at = np.array([SIZES["thickness"], ALLOWABLE])
    _, forward, reverse = differentiate(at)
    for k, scale in enumerate((1e-8, 1e3)):
        step = np.eye(2)[k] * scale
        above, below = (differentiate(each)[0] for each in (at + step, at - step))
        difference = (above - below) / (2 * scale)
        np.testing.assert_allclose(forward[:, k], difference, rtol=2e-5)
        np.testing.assert_allclose(reverse[:, k], forward[:, k], rtol=1e-9)


@pytest.mark.slow
def test_a_batch_of_ranges():
    def factor(thickness):
        sizes = {**SIZES, "thickness": thickness}
        mechanism = cantilever(flexures.leaf(STEEL, **sizes))
        drive = tj.Drive("block", angle=0.01, x=0.0, y=2.5e-4)
        return tj.range_of_motion(mechanism, drives=[drive], stress=ALLOWABLE).factors

    thicknesses = np.array([0.3e-3, 0.5e-3, 0.7e-3])
    batch = jax.vmap(factor)(thicknesses)
    single = [factor(thickness) for thickness in thicknesses]
    np.testing.assert_allclose(batch, single, rtol=1e-9)


def test_failures_are_reported():
    mechanism = cantilever(leaf())
    bend = tj.Load("block", moment=0.01)
    with pytest.raises(ValueError, match="The input is empty"):
        tj.range_of_motion(mechanism, stress=ALLOWABLE)
    with pytest.raises(ValueError, match="No allowable stress is known"):
        tj.range_of_motion(mechanism, loads=[bend])
    with pytest.raises(ValueError, match="No allowable stress is known"):
        tj.range_of_motion(mechanism, loads=[bend], stress={})
    with pytest.raises(ValueError, match="`stress` of the hinge 'flexure' is -1"):
        tj.range_of_motion(mechanism, loads=[bend], stress=-1.0)
    with pytest.raises(
        ValueError, match="names the hinge 'leaf', but the hinges are 'flexure'"
    ):
        tj.range_of_motion(mechanism, loads=[bend], stress={"leaf": 1e6})
    weight = tj.Load("block", moment=0.15)
    with pytest.raises(RuntimeError, match="Without the input, the stress in a hinge"):
        tj.range_of_motion(
            mechanism, loads=[bend], constant_loads=[weight], stress=ALLOWABLE
        )


@pytest.mark.slow
def test_a_load_on_a_fixed_body_has_no_range():
    base = tj.Load("wall", moment=0.01)
    with pytest.raises(RuntimeError, match="The input does not change the stress"):
        tj.range_of_motion(cantilever(leaf()), loads=[base], stress=ALLOWABLE)


@pytest.mark.slow
def test_a_validity_range_that_ends_before_the_stress_is_allowable_is_reported():
    bend = tj.Load("block", moment=0.01)
    narrow = tj.energies.WithValidityRange(leaf(), 0.05, force=1e3, error=[0, 0, 0])
    limited = cantilever(narrow)
    with pytest.raises(RuntimeError, match=r"backward end .* validity range"):
        tj.range_of_motion(limited, loads=[bend], stress=ALLOWABLE)
    failed = tj.range_of_motion(limited, loads=[bend], stress=ALLOWABLE, throw=False)
    assert not np.any(failed.succeeded) and "out_of_range" in str(failed)
