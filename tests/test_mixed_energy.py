"""Mixed energies, surrogates of beams, and validity ranges."""

import json
import pathlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, mostly_slow
from numpy.polynomial import Polynomial
from scipy.optimize import minimize_scalar, OptimizeResult

import twistorjax as tj
from twistorjax.energies.evaluation import polynomial_derivatives
from twistorjax.geometry import se2, twistors


REFERENCE = json.loads(
    (pathlib.Path(__file__).parent / "reference" / "beams.json").read_text()
)
UNIT = tj.Material(modulus=1.0, poisson=0.3)
RIGID = 1e6  # shear factor of a beam with almost no shear deformation


def beam(thickness=0.1, **settings):
    """A beam of unit length and unit bending stiffness."""
    return tj.flexures.Beam(
        UNIT, length=1.0, thickness=thickness, width=12 / thickness**3, **settings
    )


@pytest.fixture(scope="module")
def leaf():
    return tj.flexures.surrogate(beam(), rotation=0.81, order=6)


def mixed_potential(rotation, transverse, force):
    """A mixed potential W that is cubic in the axial force."""
    return (
        rotation**2 / 2
        + 6 * transverse**2
        + force * (0.6 * transverse**2 - rotation**2 / 12)
        - force**2 * (0.01 + transverse**2 / 70)
        + 2e-3 * force**3 * (1 + rotation**2)
    )


TERMS = {
    (2, 0, 0): 0.5, (0, 2, 0): 6.0, (0, 2, 1): 0.6, (2, 0, 1): -1 / 12,
    (0, 0, 2): -0.01, (0, 2, 2): -1 / 70, (0, 0, 3): 2e-3, (2, 0, 3): 2e-3,
}  # fmt: skip


def cubic_energy(length=1.0, force=1.0):
    """The same potential, with a reference length and a reference force."""
    coefficients = [value * length**y * force**n for (_, y, n), value in TERMS.items()]
    return tj.energies.MixedEnergy(coefficients, list(TERMS), length=length, force=force)


@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.1, 0.9)])
def test_energy_is_the_maximum_over_the_axial_force(scales):
    energy = cubic_energy(*scales)
    for twist in ([0.5, 0.003, 0.2], [-0.3, -0.01, 0.1]):
        rotation, axial, transverse = twist

        def negative(force, rotation=rotation, axial=axial, transverse=transverse):
            return -(force * axial + mixed_potential(rotation, transverse, force))

        best = minimize_scalar(negative, bounds=(-0.9, 0.9), options={"xatol": 1e-12})
        assert isinstance(best, OptimizeResult)
        pose = se2.exp(jnp.array(twist))
        np.testing.assert_allclose(energy(pose), -best.fun, rtol=1e-12)
        axial_force = jax.grad(lambda twist: energy(se2.exp(twist)))(jnp.array(twist))[1]
        np.testing.assert_allclose(axial_force, best.x, rtol=1e-6)


def test_potential_is_continued_as_a_parabola_above_the_reference_force():
    """The continuation of a quadratic potential equals it, as do its derivatives."""
    energy = tj.flexures.quartic_leaf(UNIT, length=1.0, thickness=0.1, width=12e3)

    def closed_form(pose):
        rotation, axial, transverse = se2.twist(pose)
        stretch = axial + 3 / 5 * transverse**2 - rotation**2 / 12
        return rotation**2 / 2 + 6 * transverse**2 + 600 * stretch**2

    @jax.jit
    @jax.vmap
    def actual_and_expected(pose):
        functions = energy, closed_form
        return [(function(pose), jax.hessian(function)(pose)) for function in functions]

    poses = np.array([[0.3, 1e-3, 0.2], [0.3, 0.2, 0.1], [0.3, -0.2, 0.1]])
    for actual, expected in zip(*actual_and_expected(poses), strict=True):
        np.testing.assert_allclose(actual, expected, rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize("force", [-1.7, -0.3, 0.9, 1.4])
def test_all_derivatives_of_the_potential_are_those_of_the_parabola(force):
    """Powers of the force above the second are continued by their Taylor polynomials."""
    rotation, transverse = 0.4, 0.2
    of_force = Polynomial([0.0])
    by_rotation = Polynomial([0.0])
    for (i, j, k), value in TERMS.items():
        power = Polynomial.basis(k)
        if abs(force) > 1:
            edge = np.sign(force)
            offset = Polynomial([-edge, 1.0])
            power = sum(power.deriv(m)(edge) * offset**m / (1, 1, 2)[m] for m in range(3))
        of_force += value * rotation**i * transverse**j * power
        by_rotation += value * i * rotation ** max(i - 1, 0) * transverse**j * power
    variables = tuple(map(jnp.array, (rotation, transverse, force)))
    coefficients = jnp.array(list(TERMS.values()))
    for order in range(5):
        orders = (0, 0, order), (1, 0, order)
        actual = polynomial_derivatives(
            tuple(TERMS), orders, coefficients, variables, (2,)
        )
        expected = of_force.deriv(order)(force), by_rotation.deriv(order)(force)
        np.testing.assert_allclose(actual, expected, rtol=1e-13, atol=1e-14)

    def potential(force, order):
        at = (*variables[:2], force)
        return polynomial_derivatives(tuple(TERMS), (order,), coefficients, at, (2,))[0]

    for order in range(4):
        slope = jax.grad(potential)(variables[2], (1, 0, order))
        assert_close(slope, by_rotation.deriv(order + 1)(force))


def test_mixed_energy_needs_an_axial_compliance():
    with pytest.raises(
        ValueError, match=r"powers \(0, 0, 2\) is missing or not negative"
    ):
        tj.energies.MixedEnergy([1.0, 1.0], [(2, 0, 0), (0, 0, 2)], length=1.0, force=1.0)


def cantilever(energy):
    bodies = [tj.Body("wall"), tj.Body("tip", (0.0, 1.0, 0.0), mass=1.0, inertia=0.1)]
    hinge = tj.Hinge("leaf", "wall", "tip", energy, at=(0.0, 0.5, 0.0))
    return tj.Mechanism(bodies, [hinge], fixed=["wall"])


def test_newton_converges_in_few_steps_for_a_very_thin_leaf():
    thickness = 1e-4
    energy = tj.flexures.quartic_leaf(
        UNIT, length=1.0, thickness=thickness, width=12 / thickness**3
    )
    load = tj.Load("tip", (0.0, 0.0, 1.0))
    assert tj.equilibrium(cantilever(energy), loads=[load]).steps < 8


@jax.jit
@jax.vmap
def under_load(load):
    return tj.flexures.beam_under_load(beam(), load, sections=2)


@pytest.mark.parametrize("degrees", mostly_slow([20, 46, 90]))
def test_surrogate_of_a_leaf_equals_the_beam_under_new_loads(degrees, validated):
    """The error is below 0.1 %, and about the reported error."""
    rotation = np.radians(degrees)
    hinge = tj.flexures.surrogate(beam(), rotation=rotation, order=6)
    largest = np.array([rotation + 2, 3.5, 3.5])
    loads = np.random.default_rng(0).uniform(-largest, largest, size=(1500, 3))
    solution = under_load(loads)
    in_range = np.abs(solution.pose[:, 0]) < rotation
    assert np.sum(in_range) > 200
    wrenches = np.asarray(jax.jit(jax.vmap(hinge.wrench))(solution.pose))[in_range]
    exact = np.asarray(solution.wrench)[in_range]
    rms_error = np.sqrt(np.mean((wrenches - exact) ** 2, axis=0))
    error = rms_error / np.sqrt(np.mean(exact**2, axis=0))
    np.testing.assert_array_less(error, 1e-3)
    np.testing.assert_allclose(error, hinge.error, rtol=0.7)
    what = f"wrenches at rotations up to {degrees}°, new loads (rms, worst component)"
    validated("Surrogates of leaves", what, 1 + error.max(), 1.0, "the exact beam")


@pytest.mark.slow
def test_a_surrogate_for_small_forces_equals_the_beam():
    """Its range is larger than the given one, with E I / L^2 = 1."""
    hinge = tj.flexures.surrogate(beam(), rotation=0.5, force=1e-4)
    np.testing.assert_allclose(hinge.force, 0.02, rtol=0.02)
    exact = tj.flexures.beam_under_load(beam(), jnp.array([0.3, 1e-4, -1e-4]))
    error = np.asarray(hinge.wrench(exact.pose) - exact.wrench)
    np.testing.assert_array_less(np.abs(error), 1e-3 * np.array([0.3, 0.01, 0.01]))


@pytest.mark.slow
def test_reference_stiffness_of_a_surrogate_is_that_of_a_timoshenko_beam(leaf):
    expected = tj.flexures.linear_leaf(
        UNIT, length=1.0, thickness=0.1, width=12e3, theory="timoshenko"
    ).stiffness
    np.testing.assert_allclose(leaf.tangent_stiffness(), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_surrogate_of_a_cantilever_is_the_elastica():
    """Rotation, axial and transverse displacement of the tip under P L^2 / E I = 1."""
    hinge = tj.flexures.surrogate(beam(1e-3, shear_factor=RIGID), rotation=0.8, order=6)
    load = tj.Load("tip", (0.0, 0.0, 1.0))
    solution = tj.equilibrium(cantilever(hinge), loads=[load])
    exact = np.array([0.461351949712, -0.0564332362834, 0.3017207738])
    np.testing.assert_allclose(solution.displacement("tip"), exact, rtol=2e-4)


def stage_on_leaves(energy, positions):
    """Return a stage on leaves with the same energy."""
    hinges = [
        tj.Hinge(f"{k}", "ground", "stage", energy, at=position)
        for k, position in enumerate(positions)
    ]
    return tj.Mechanism([tj.Body("ground"), tj.Body("stage")], hinges, fixed=["ground"])


@pytest.mark.slow
@pytest.mark.parametrize("crossing", [0.5, 0.12732200375])
def test_center_shift_of_a_cross_spring_pivot_is_that_of_exact_beams(crossing, validated):
    """If the leaves cross in the middle, the center shift is of second order."""
    given = REFERENCE["cross_spring_pivot_90deg"][f"lambda_{crossing:.11g}"]
    hinge = tj.flexures.surrogate(beam(3e-4, shear_factor=RIGID), rotation=0.81, order=6)
    axes = np.pi / 2 + np.array([1, -1]) * np.pi / 4
    arm = 0.5 - crossing
    positions = [(axis, arm * np.cos(axis), arm * np.sin(axis)) for axis in axes]
    pivot = stage_on_leaves(hinge, positions)
    cases = []
    for degrees, stiffness, *shift in given:
        rotation = np.radians(degrees)
        solution = tj.equilibrium(pivot, drives=[tj.Drive("stage", angle=rotation)])
        actual_stiffness = solution.reaction("stage")[0] / rotation
        np.testing.assert_allclose(actual_stiffness, stiffness, rtol=2e-4)
        actual_shift = solution.displacement("stage")[1:]
        size = float(np.linalg.norm(shift))
        np.testing.assert_allclose(actual_shift, shift, atol=5e-3 * size)
        cases.append((degrees, actual_shift, shift))
    degrees, actual_shift, shift = cases[-1]
    what = (
        f"cross-spring pivot, leaves crossed at {crossing:.3f} of their length, rotation "
        f"{degrees:g}°: center shift"
    )
    validated("Surrogates of leaves", what, actual_shift, shift, "exact beams, by SciPy")


@pytest.mark.slow
def test_a_surrogate_has_the_same_order_and_limits_under_a_gradient():
    def sum_of_coefficients(thickness):
        hinge: Any = tj.flexures.surrogate(beam(thickness), rotation=0.3, error=1e-2)
        return jnp.sum(hinge.energy.coefficients)

    value, _ = jax.value_and_grad(sum_of_coefficients)(5e-4)
    assert float(value) == pytest.approx(float(sum_of_coefficients(5e-4)), rel=1e-9)
    too_exact: Any = {"rotation": 0.8, "error": 1e-9}
    with pytest.raises(ValueError, match="The `error` of 1e-09 is not reached"):
        jax.grad(
            lambda thickness: jnp.max(
                tj.flexures.surrogate(beam(thickness), **too_exact).error
            )
        )(5e-4)


@pytest.mark.release
def test_derivatives_of_a_surrogate_by_the_dimensions_are_difference_quotients():
    """They agree to the error of the fit. The wrench is proportional to the width."""
    pose = jnp.array([0.3, 0.01, 0.1])

    def wrench(thickness, width):
        plate = tj.flexures.Beam(UNIT, length=1.0, thickness=thickness, width=width)
        return tj.flexures.surrogate(plate, rotation=0.8, order=6).energy.wrench(pose)

    @jax.jit
    @jax.vmap
    def directional(sizes, rates):
        return jax.jvp(wrench, tuple(sizes), tuple(rates))

    step = 1e-5
    sizes = jnp.array([[0.1 + step, 1.0], [0.1 - step, 1.0], [0.1, 1.0], [0.1, 2.0]])
    rates = jnp.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    values, slopes = directional(sizes, rates)
    differences = (values[0] - values[1]) / (2 * step)
    np.testing.assert_allclose(slopes[2], differences, rtol=1e-3)
    np.testing.assert_allclose(values[3], 2 * values[2], rtol=1e-9)
    np.testing.assert_allclose(slopes[3], values[2], rtol=1e-9)


@pytest.mark.slow
def test_surrogate_of_a_notch_equals_the_beam():
    plate = tj.Material(modulus=69e9, poisson=0.33)
    neck = tj.flexures.Beam(
        plate,
        length=3e-3,
        thickness=tj.flexures.notch_profile(hole=3e-3, web=0.25e-3),
        width=20e-3,
        steps=48,
    )
    hinge = tj.flexures.surrogate(neck, rotation=0.05)
    solution = tj.flexures.beam_under_load(neck, jnp.array([0.1, 300.0, 200.0]))
    np.testing.assert_allclose(hinge.wrench(solution.pose), solution.wrench, rtol=1e-3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        pytest.param(
            {"rotation": 0.8, "force": 60.0},
            r"force of 60 N: from \d.* N on",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"rotation": 0.8, "error": 1e-12, "order": 6},
            "1e-12 is not reached.*0.0001.* with order 6",
            marks=pytest.mark.slow,
        ),
        ({"rotation": 0.8, "order": 5}, "must be one of"),
        ({"rotation": 7.0}, "`rotation` is 7"),
        ({"rotation": 0.8, "error": 0.0}, "must be positive"),
    ],
)
def test_impossible_surrogate_raises_an_error(settings, message):
    with pytest.raises(ValueError, match=message):
        tj.flexures.surrogate(beam(), **settings)


def test_surrogate_is_saved_and_loaded_exactly(leaf, tmp_path):
    tj.io.save_energy(leaf, tmp_path / "leaf.json")
    loaded = tj.io.load_energy(tmp_path / "leaf.json")
    assert jax.tree.all(jax.tree.map(jnp.array_equal, leaf, loaded))


LIMITED = tj.energies.WithValidityRange(
    tj.Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0]))),
    rotation=0.1, force=5.0, error=[1e-3, 1e-3, 1e-3],
)  # fmt: skip


def test_poses_out_of_range_raise_an_error_or_return_nan():
    poses = np.array([[0.099, 0.0, 0.0], [0.101, 0.0, 0.0], [0.0, 0.0502, 0.0]])
    inside, rotated, stretched = map(jnp.array, poses)
    assert_close(LIMITED.wrench(inside), LIMITED.energy.wrench(inside), digits=15)
    for pose in (rotated, stretched):
        with pytest.raises(ValueError, match=r"is valid up to 0\.1 rad and 5 N"):
            LIMITED.wrench(pose)
    total = 2.0 * LIMITED + LIMITED.energy
    for function in (LIMITED, LIMITED.wrench, jax.grad(LIMITED), total):
        values = np.asarray(jax.jit(jax.vmap(function))(poses))
        finite = np.isfinite(values.reshape(3, -1)).all(axis=1)
        np.testing.assert_array_equal(finite, [True, False, False])


def test_equilibrium_out_of_range_raises_an_error():
    mechanism = cantilever(LIMITED)
    loads = [tj.Load("tip", (0.15, 0.0, 0.0))]
    with pytest.raises(RuntimeError, match=r"'leaf': its rotation is 0\.1506 rad"):
        tj.equilibrium(mechanism, loads=loads)
    solution = tj.equilibrium(mechanism, loads=loads, throw=False)
    assert tj.result_names(solution.result) == "out_of_range"
    assert np.all(np.isnan(solution.displacements))
    np.testing.assert_allclose(solution.reached[1, 0], np.arcsin(0.15), rtol=1e-9)
    with pytest.raises(ValueError, match="At `about` a hinge is outside"):
        tj.vibrations(mechanism, about=mechanism.reference + solution.reached)
    with pytest.raises(ValueError, match="At `about` a hinge is outside"):
        tj.linearize(mechanism, about=mechanism.reference + solution.reached)


def test_motion_ends_when_a_hinge_leaves_its_range():
    """Under a constant moment the body swings to twice the angle of equilibrium."""
    times = np.linspace(0.0, 2.0, 9)
    loads = [tj.Load("tip", (0.08, 0.0, 0.0))]
    motion = tj.simulate(cantilever(LIMITED), times, loads=loads, throw=False)
    assert tj.result_names(motion.result) == "out_of_range"
    angles = motion.displacement("tip")[:, 0]
    finite = np.isfinite(angles)
    assert np.all(angles[finite] <= 0.1)
    assert np.all(np.diff(finite.astype(int)) <= 0) and not finite[-1]
    np.testing.assert_allclose(motion.reached, times[finite][-1])


def test_proportional_damping_resists_the_rate_of_the_axial_force():
    """It does not resist the axial shortening by bending."""
    energy = tj.flexures.quartic_leaf(UNIT, length=1.0, thickness=0.1, width=12e3)
    twist, rate = jnp.array([0.4, -0.1, 0.2]), jnp.array([0.3, 0.5, -0.7])

    def axial_force(twist):
        return jax.grad(lambda twist: energy(se2.exp(twist)))(twist)[1]

    pose = se2.exp(twist)
    displacement = twistors.Displacement.from_pose(pose)
    resisted = jnp.stack(energy.resisted_rates(displacement, tuple(rate)))
    stretching = jax.jvp(axial_force, (twist,), (rate,))[1] / 1200.0
    assert_close(resisted, np.array([0.3, stretching, -0.7]), digits=12)


@pytest.mark.release
def test_proportional_damping_does_not_depend_on_the_amplitude():
    """The decay in one period is the same for a small and a large oscillation."""
    hinge = tj.flexures.surrogate(beam(0.1), rotation=0.81, order=6)
    bodies = [tj.Body("wall"), tj.Body("arm", mass=1e-3, inertia=1.0)]
    spring = tj.Hinge("leaf", "wall", "arm", hinge, at=(0.0, 0.0, 0.0), damping=0.01)
    oscillator = tj.Mechanism(bodies, [spring], fixed=["wall"])
    ratio = np.pi * float(tj.vibrations(oscillator).frequencies[0]) * 0.01
    period = 2 * np.pi / np.sqrt(1 - ratio**2)
    for moment in (0.01, 0.5):
        start = tj.equilibrium(oscillator, loads=[tj.Load("arm", (moment, 0.0, 0.0))])
        motion = tj.simulate(oscillator, [0.0, period], start=start)
        first, last = motion.displacement("arm")[:, 0]
        np.testing.assert_allclose(last / first, np.exp(-ratio * period), rtol=2e-3)
