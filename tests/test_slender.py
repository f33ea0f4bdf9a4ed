"""Slender flexures and beams distilled to them: exact at the cost of one hinge."""

import json
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from scipy.optimize import minimize_scalar

import twistorjax as tj


pytestmark = pytest.mark.slow

REFERENCE = json.loads(
    (pathlib.Path(__file__).parent / "reference" / "beams.json").read_text()
)
UNIT = tj.Material(modulus=1.0, poisson=0.3)
RIGID = 1e6  # hardly any shear, in the program that has it


def beam(thickness=0.1, **settings):
    """Of unit length and bending stiffness."""
    return tj.flexures.Beam(
        UNIT, length=1.0, thickness=thickness, width=12 / thickness**3, **settings
    )


@pytest.fixture(scope="module")
def leaf():
    return tj.flexures.surrogate(beam(), turn=0.81, order=6)


def mixed(turn, across, tension):
    """A W of the third power in the tension."""
    return (
        turn**2 / 2 + 6 * across**2 + tension * (0.6 * across**2 - turn**2 / 12)
        - tension**2 * (0.01 + across**2 / 70) + 2e-3 * tension**3 * (1 + turn**2)
    )  # fmt: skip


TERMS = {
    (2, 0, 0): 0.5, (0, 2, 0): 6.0, (0, 2, 1): 0.6, (2, 0, 1): -1 / 12,
    (0, 0, 2): -0.01, (0, 2, 2): -1 / 70, (0, 0, 3): 2e-3, (2, 0, 3): 2e-3,
}  # fmt: skip


def cubic(length=1.0, force=1.0):
    """The same, its variables in parts of a length and a force."""
    parts = [value * length**y * force**n for (_, y, n), value in TERMS.items()]
    return tj.energies.MixedEnergy(parts, list(TERMS), length=length, force=force)


@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.1, 0.9)])
def test_the_energy_is_the_largest_over_the_tension(scales):
    energy = cubic(*scales)
    for twist in ([0.5, 0.003, 0.2], [-0.3, -0.01, 0.1]):
        turn, along, across = twist

        def less(tension, turn=turn, along=along, across=across):
            return -(tension * along + mixed(turn, across, tension))

        best = minimize_scalar(less, bounds=(-0.9, 0.9), options={"xatol": 1e-12})
        pose = tj.geometry.se2.exp(jnp.array(twist))
        np.testing.assert_allclose(energy(pose), -best.fun, rtol=1e-12)
        pull = jax.grad(lambda twist: energy(tj.geometry.se2.exp(twist)))(
            jnp.array(twist)
        )[1]
        np.testing.assert_allclose(pull, best.x, rtol=1e-6)


def test_beyond_the_force_it_goes_on_as_a_parabola():
    """Of a W quadratic in the tension nothing is to be seen of it, in any derivative."""
    energy = tj.flexures.quartic_leaf(UNIT, length=1.0, thickness=0.1, width=12e3)

    def plain(pose):
        turn, along, across = tj.geometry.se2.twist(pose)
        longer = along + 3 / 5 * across**2 - turn**2 / 12
        return turn**2 / 2 + 6 * across**2 + 600 * longer**2

    for pose in ([0.3, 1e-3, 0.2], [0.3, 0.2, 0.1], [0.3, -0.2, 0.1]):
        where = jnp.array(pose)
        for one, other in ((energy, plain), (jax.hessian(energy), jax.hessian(plain))):
            np.testing.assert_allclose(one(where), other(where), rtol=1e-11, atol=1e-9)


def test_a_slender_flexure_gives_along_its_axis():
    with pytest.raises(ValueError, match=r"powers \(0, 0, 2\).*missing or not negative"):
        tj.energies.MixedEnergy([1.0, 1.0], [(2, 0, 0), (0, 0, 2)], length=1.0, force=1.0)


def cantilever(energy):
    bodies = [tj.Body("wall"), tj.Body("tip", (0.0, 1.0, 0.0), mass=1.0, inertia=0.1)]
    hinge = tj.Hinge("leaf", "wall", "tip", energy, at=(0.0, 0.5, 0.0))
    return tj.Mechanism(bodies, [hinge], fixed=["wall"])


def test_newton_takes_a_leaf_as_fast_however_thin_it_is():
    thickness = 1e-4
    energy = tj.flexures.quartic_leaf(
        UNIT, length=1.0, thickness=thickness, width=12 / thickness**3
    )
    load = tj.Load("tip", (0.0, 0.0, 1.0))
    assert tj.equilibrium(cantilever(energy), loads=[load]).steps < 8


@pytest.mark.parametrize("degrees", [20, 46, 90])
def test_a_distilled_leaf_is_the_beam_under_fresh_loads(degrees, validated):
    """Under 0.1 %, and what it says of its own error."""
    turn = np.radians(degrees)
    hinge = tj.flexures.surrogate(beam(), turn=turn, order=6)
    spread = np.array([turn + 2, 3.5, 3.5])
    loads = np.random.default_rng(0).uniform(-spread, spread, size=(1500, 3))
    bent = jax.jit(
        jax.vmap(lambda load: tj.flexures.beam_under_load(beam(), load, places=2))
    )(loads)
    there = np.abs(bent.pose[:, 0]) < turn
    assert np.sum(there) > 200
    wrenches = jax.vmap(hinge.wrench)(bent.pose[there])
    gap = jnp.sqrt(jnp.mean((wrenches - bent.wrench[there]) ** 2, axis=0))
    error = gap / jnp.sqrt(jnp.mean(bent.wrench[there] ** 2, axis=0))
    np.testing.assert_array_less(error, 1e-3)
    np.testing.assert_allclose(error, hinge.error, rtol=0.7)
    what = f"wrenches to {degrees}°, at fresh loads (rms, worst component)"
    validated("Distilled leaves", what, 1 + error.max(), 1.0, "the exact beam")


def test_at_rest_it_is_the_beam_of_the_textbook(leaf):
    expected = tj.flexures.leaf(
        UNIT, length=1.0, thickness=0.1, width=12e3, theory="timoshenko"
    ).stiffness
    np.testing.assert_allclose(leaf.tangent_stiffness(), expected, rtol=1e-9, atol=1e-9)


def test_one_distilled_leaf_is_the_elastica():
    """Under P L^2 / E I = 1: turn, and travel along and across."""
    hinge = tj.flexures.surrogate(beam(1e-3, shear_factor=RIGID), turn=0.8, order=6)
    load = tj.Load("tip", (0.0, 0.0, 1.0))
    moved = tj.equilibrium(cantilever(hinge), loads=[load]).displacement("tip")
    exact = np.array([0.461351949712, -0.0564332362834, 0.3017207738])
    np.testing.assert_allclose(moved, exact, rtol=2e-4)


def gather_constraints(energy, places):
    """A stage on two leaves."""
    hinges = [
        tj.Hinge(f"{k}", "ground", "stage", energy, at=place)
        for k, place in enumerate(places)
    ]
    return tj.Mechanism([tj.Body("ground"), tj.Body("stage")], hinges, fixed=["ground"])


def test_a_parallelogram_sinks_and_tilts_as_it_must(validated):
    given = REFERENCE["parallelogram_w0.3_k33_30000"]["rows"]
    hinge = tj.flexures.surrogate(
        beam(np.sqrt(12 / 30000), shear_factor=RIGID), turn=0.2, order=6
    )
    stage = gather_constraints(hinge, [(0.0, -0.5, -0.3), (0.0, -0.5, 0.3)])
    for travel, force, sinking, tilt, _ in given:
        answer = tj.equilibrium(stage, drives=[tj.Drive("stage", y=travel)])
        seen = [answer.reaction("stage")[2], *answer.displacement("stage")[1::-1]]
        np.testing.assert_allclose(seen, [force, sinking, tilt], rtol=2e-3)
    seen, exact = np.array(seen) / [force, sinking, tilt], np.ones(3)
    what = f"parallelogram pushed by {travel:g} L: force, sinking, tilt"
    validated("Distilled leaves", what, seen, exact, "exact beams, by SciPy")


@pytest.mark.parametrize("crossing", [0.5, 0.12732200375])
def test_the_centre_of_a_cross_spring_pivot_wanders_as_it_must(crossing, validated):
    """At mid-crossing a drive moves nothing else to first order: all is curvature."""
    given = REFERENCE["cross_spring_pivot_90deg"][f"lambda_{crossing:.11g}"]
    hinge = tj.flexures.surrogate(beam(3e-4, shear_factor=RIGID), turn=0.81, order=6)
    axes = np.pi / 2 + np.array([1, -1]) * np.pi / 4
    arm = 0.5 - crossing
    places = [(axis, arm * np.cos(axis), arm * np.sin(axis)) for axis in axes]
    pivot = gather_constraints(hinge, places)
    for degrees, stiffness, *shift in given:
        turn = np.radians(degrees)
        answer = tj.equilibrium(pivot, drives=[tj.Drive("stage", angle=turn)])
        moment = answer.reaction("stage")[0] / turn
        np.testing.assert_allclose(moment, stiffness, rtol=2e-4)
        wandered = answer.displacement("stage")[1:]
        size = np.linalg.norm(shift)
        np.testing.assert_allclose(wandered, shift, atol=5e-3 * size)
    what = f"cross-spring pivot, crossed at {crossing:.3f}, {degrees:g}°: its centre"
    validated("Distilled leaves", what, wandered, shift, "exact beams, by SciPy")


def test_distillation_follows_the_thickness():
    """As differences do, to the error of the fit; and the width is a factor."""
    pose = jnp.array([0.3, 0.01, 0.1])

    def of_sizes(thickness, width):
        plate = tj.flexures.Beam(UNIT, length=1.0, thickness=thickness, width=width)
        return tj.flexures.surrogate(plate, turn=0.8, order=6).energy.wrench(pose)

    @jax.jit
    @jax.vmap
    def along(sizes, rates):
        return jax.jvp(of_sizes, tuple(sizes), tuple(rates))

    step = 1e-5
    sizes = jnp.array([[0.1 + step, 1.0], [0.1 - step, 1.0], [0.1, 1.0], [0.1, 2.0]])
    rates = jnp.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    values, slopes = along(sizes, rates)
    differences = (values[0] - values[1]) / (2 * step)
    np.testing.assert_allclose(slopes[2], differences, rtol=1e-3)
    np.testing.assert_allclose(values[3], 2 * values[2], rtol=1e-9)
    np.testing.assert_allclose(slopes[3], values[2], rtol=1e-9)


@pytest.mark.long
def test_a_notch_is_distilled_like_a_leaf():
    plate = tj.Material(modulus=69e9, poisson=0.33)
    neck = tj.flexures.Beam(
        plate,
        length=3e-3,
        thickness=tj.flexures.notch_profile(hole=3e-3, web=0.25e-3),
        width=20e-3,
        steps=48,
    )
    hinge = tj.flexures.surrogate(neck, turn=0.05)
    bent = tj.flexures.beam_under_load(neck, jnp.array([0.1, 300.0, 200.0]))
    np.testing.assert_allclose(hinge.wrench(bent.pose), bent.wrench, rtol=1e-3)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"turn": 0.8, "force": 60.0}, r"force of 60 N: from \d.* N on some turns"),
        ({"turn": 0.8, "error": 1e-12, "order": 6}, "1e-12 is not met.*order 6 0.0001"),
        ({"turn": 0.8, "order": 5}, "must be one of"),
        ({"turn": 7.0}, "`turn` is 7"),
        ({"turn": 0.8, "error": 0.0}, "must be positive"),
    ],
)
def test_what_cannot_be_distilled_is_told(asked, message):
    with pytest.raises(ValueError, match=message):
        tj.flexures.surrogate(beam(), **asked)


def test_a_distilled_hinge_is_kept_in_a_file(leaf, tmp_path):
    tj.io.save_energy(leaf, tmp_path / "leaf.json")
    again = tj.io.load_energy(tmp_path / "leaf.json")
    assert jax.tree.all(jax.tree.map(jnp.array_equal, leaf, again))


SURE = tj.energies.WithValidityRange(
    tj.Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0]))),
    turn=0.1, force=5.0, error=[1e-3, 1e-3, 1e-3],
)  # fmt: skip


def test_poses_beyond_the_range_are_refused():
    inside, turned, pulled = jnp.array(
        [[0.099, 0.0, 0.0], [0.101, 0.0, 0.0], [0.0, 0.0502, 0.0]]
    )
    assert_close(SURE.wrench(inside), SURE.energy.wrench(inside), digits=15)
    for pose in (turned, pulled):
        with pytest.raises(ValueError, match=r"is known up to 0\.1 rad and 5 N"):
            SURE.wrench(pose)
    doubled = 2.0 * SURE + SURE.energy
    for one in (SURE, SURE.wrench, jax.grad(SURE), doubled):
        values = jax.vmap(one)(jnp.stack([inside, turned, pulled]))
        finite = jnp.isfinite(values.reshape(3, -1)).all(axis=1)
        np.testing.assert_array_equal(finite, [True, False, False])


def test_solves_that_end_beyond_the_range_are_refused():
    mechanism = cantilever(SURE)
    loads = [tj.Load("tip", (0.15, 0.0, 0.0))]
    with pytest.raises(RuntimeError, match=r"'leaf': it is turned by 0\.1506 rad"):
        tj.equilibrium(mechanism, loads=loads)
    answer = tj.equilibrium(mechanism, loads=loads, throw=False)
    assert tj.result_names(answer.result) == "out_of_range"
    assert np.all(np.isnan(answer.displacements))
    np.testing.assert_allclose(answer.reached[1, 0], np.arcsin(0.15), rtol=1e-9)
    with pytest.raises(ValueError, match="`about` displaces a hinge beyond"):
        tj.vibrations(mechanism, about=mechanism.reference + answer.reached)
    with pytest.raises(ValueError, match="`about` displaces a hinge beyond"):
        tj.linearize(mechanism, about=mechanism.reference + answer.reached)


def test_a_motion_ends_where_a_hinge_leaves_its_range():
    """Pushed by a constant moment it swings to twice the angle of rest."""
    times = np.linspace(0.0, 2.0, 9)
    loads = [tj.Load("tip", (0.08, 0.0, 0.0))]
    motion = tj.simulate(cantilever(SURE), times, loads=loads, throw=False)
    assert tj.result_names(motion.result) == "out_of_range"
    angles = motion.displacement("tip")[:, 0]
    kept = np.isfinite(angles)
    assert np.all(angles[kept] <= 0.1)
    assert np.all(np.diff(kept.astype(int)) <= 0) and not kept[-1]
    np.testing.assert_allclose(motion.reached, times[kept][-1])


def test_damping_in_time_resists_the_rate_of_the_tension():
    """Not that by which the ends draw together."""
    energy = tj.flexures.quartic_leaf(UNIT, length=1.0, thickness=0.1, width=12e3)
    twist, rate = jnp.array([0.4, -0.1, 0.2]), jnp.array([0.3, 0.5, -0.7])

    def tension(twist):
        return jax.grad(lambda twist: energy(tj.geometry.se2.exp(twist)))(twist)[1]

    at = tj.geometry.twistors.Displacement.of(tj.geometry.se2.exp(twist))
    resisted = jnp.stack(energy.resisted_rates(at, tuple(rate)))
    stretching = jax.jvp(tension, (twist,), (rate,))[1] / 1200.0
    assert_close(resisted, np.array([0.3, stretching, -0.7]), digits=12)


@pytest.mark.long
def test_damping_in_time_takes_as_much_of_a_large_swing_as_of_a_small_one():
    """Of each period its share; what bending draws together is not stretched."""
    hinge = tj.flexures.surrogate(beam(0.1), turn=0.81, order=6)
    bodies = [tj.Body("wall"), tj.Body("arm", mass=1e-3, inertia=1.0)]
    joint = tj.Hinge("leaf", "wall", "arm", hinge, at=(0.0, 0.0, 0.0), damping=0.01)
    swing = tj.Mechanism(bodies, [joint], fixed=["wall"])
    share = np.pi * float(tj.vibrations(swing).frequencies[0]) * 0.01
    period = 2 * np.pi / np.sqrt(1 - share**2)
    for turn in (0.01, 0.5):
        start = tj.equilibrium(swing, loads=[tj.Load("arm", (turn, 0.0, 0.0))])
        motion = tj.simulate(swing, [0.0, period], start=start)
        first, last = motion.displacement("arm")[:, 0]
        np.testing.assert_allclose(last / first, np.exp(-share * period), rtol=2e-3)
