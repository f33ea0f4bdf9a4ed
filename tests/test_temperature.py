"""Changes of temperature, strokes of actuators, and weights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import assert_close, mostly_slow, with_value

import twistorjax as tj
from twistorjax.examples import stage
from twistorjax.examples.warm_stage import thermal_drift
from twistorjax.flexures.beams.stress_models import BeamStress
from twistorjax.geometry import se2


STEEL = tj.Material(210e9, poisson=0.3, expansion=12e-6)
LENGTH, THICKNESS, WIDTH, SPACING = 0.05, 0.5e-3, 0.01, 0.04
LEAF = tj.flexures.leaf(STEEL, length=LENGTH, thickness=THICKNESS, width=WIDTH)
GROWTH = tj.Expansion(STEEL, length=LENGTH)
AREA = THICKNESS * WIDTH


def guide(offset=0.0, expansion=STEEL.expansion):
    """Return a table on two parallel leaves; its origin may be anywhere."""
    bodies = [
        tj.Body("base", (0.0, 0.01, -0.02), expansion=expansion),
        tj.Body("table", (0.3, offset, LENGTH + offset), expansion=expansion),
    ]
    hinges = [
        tj.Hinge(
            name, "base", "table", LEAF, (np.pi / 2, x, LENGTH / 2), expansion=GROWTH
        )
        for name, x in (("left", -SPACING / 2), ("right", SPACING / 2))
    ]
    return tj.Mechanism(bodies, hinges, fixed=["base"])


wrench_of = {
    name: jax.jit(lambda mechanism, found, name=name: mechanism.wrench_of(name, found))
    for name in ("left", "right", "leaf", "piezo")
}


@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_one_material_at_one_temperature_only_scales(offset):
    change = 40.0
    mechanism = guide(offset)
    warm = mechanism.at_temperature(change)
    found = tj.equilibrium(warm)
    strain = 12e-6 * change
    origins = np.asarray(mechanism.reference)[:, 1:]
    expected = strain * (origins[1] - origins[0])
    np.testing.assert_allclose(found.displacement("table"), [0.0, *expected], atol=1e-17)
    for name in ("left", "right"):
        wrench = np.asarray(wrench_of[name](warm, found))
        largest = 1e-12 * 210e9 * strain * AREA
        assert np.all(np.abs(wrench[1:]) < largest)
        assert abs(wrench[0]) < largest * LENGTH


@pytest.mark.slow
def test_gain_does_not_depend_on_a_uniform_temperature():
    """The travel grows with the stage, whose hinges have larger dimensions as well."""
    scale = 1 + 23.6e-6 * 50.0
    cold = thermal_drift(0.0)
    warm = thermal_drift(50.0, travel=scale * stage.TRAVEL)
    assert_close(cold.gain, stage.amplification(stage.microstage()).gain, digits=10)
    assert_close(warm.gain / cold.gain, 1.0, digits=12)
    place, moved = np.asarray(stage.microstage().reference)[3], np.asarray(warm.output)
    np.testing.assert_allclose(moved[1:], (scale - 1) * place[1:], atol=1e-17)
    assert abs(moved[0]) < 1e-15


def surrogate_guide(scale):
    """Return a table on a surrogate and a sum of energies, with scaled dimensions."""
    size = scale * np.array([LENGTH, THICKNESS, WIDTH])
    dimensions = dict(zip(("length", "thickness", "width"), size, strict=True))
    beam = tj.flexures.Beam(STEEL, **dimensions)
    energies = {
        "left": tj.flexures.surrogate(beam, rotation=0.1),
        "right": tj.flexures.leaf(STEEL, **dimensions)
        + 2.0 * tj.flexures.quartic_leaf(STEEL, **dimensions),
    }
    growth = tj.Expansion(STEEL, length=scale * LENGTH)
    bodies = [
        tj.Body("base", expansion=STEEL.expansion),
        tj.Body("table", (0.0, 0.0, scale * LENGTH), expansion=STEEL.expansion),
    ]
    hinges = [
        tj.Hinge(
            name, "base", "table", energies[name],
            (np.pi / 2, scale * x, scale * LENGTH / 2), expansion=growth,
        )
        for name, x in (("left", -SPACING / 2), ("right", SPACING / 2))
    ]  # fmt: skip
    return tj.Mechanism(bodies, hinges, fixed=["base"])


@pytest.mark.release
def test_a_warm_mechanism_is_one_with_larger_dimensions():
    """Surrogates, sums, and multiples have the energies of their new dimensions."""
    scale = 1 + 12e-6 * 300.0
    warm, larger = surrogate_guide(1.0).at_temperature(300.0), surrogate_guide(scale)
    load = [tj.Load("table", force=(2.0, -3.0), moment=0.01)]
    found, expected = (
        tj.equilibrium(mechanism, loads=load) for mechanism in (warm, larger)
    )
    np.testing.assert_allclose(
        found.pose("table"), expected.pose("table"), rtol=1e-9, atol=1e-12
    )
    for name in ("left", "right"):
        wrench, exact = warm.wrench_of(name, found), larger.wrench_of(name, expected)
        # Frame b of the warm leaf keeps its distance from the end that is on body B.
        exact = exact.at[0].add(-exact[2] * (scale - 1) * LENGTH / 2)
        np.testing.assert_allclose(wrench, exact, rtol=1e-6, atol=1e-9)


def warm_leaf_energy(displacement, change):
    """Energy of the two leaves, between clamped ends, one of which has grown."""
    angle, x, y = displacement
    total, strain = 0.0, 12e-6 * change
    larger = tj.flexures.leaf(
        STEEL,
        length=(1 + strain) * LENGTH,
        thickness=(1 + strain) * THICKNESS,
        width=(1 + strain) * WIDTH,
    )
    for energy, position, growth in (
        (larger, -SPACING / 2, strain * LENGTH), (LEAF, SPACING / 2, 0.0)
    ):  # fmt: skip
        frame = jnp.array([np.pi / 2, position, LENGTH / 2])
        c, s = jnp.cos(angle), jnp.sin(angle)
        px, py = position, -LENGTH / 2  # from the origin of the table
        moved = jnp.stack(
            [frame[0] + angle, x + c * px - s * py, y + LENGTH + s * px + c * py]
        )
        # Frames at the middle move apart by half the growth each.
        a = frame + growth / 2 * jnp.array([0.0, 0.0, 1.0])
        b = moved - growth / 2 * jnp.stack([0.0 * s, -s, c])
        total += energy(se2.between(a, b))
    return total


def test_one_warm_leaf_tilts_the_table():
    change = 30.0
    mechanism = guide(expansion=None)
    warm = mechanism.at_temperature(0.0, hinges={"left": change})
    found = tj.equilibrium(warm)
    first_order = -12e-6 * change * LENGTH / SPACING
    displacement = np.asarray(found.displacement("table"))
    assert_close(displacement[0], first_order, digits=2)
    scale = np.array([1e-3, 1e-5, 1e-5])

    @jax.jit
    def derivatives(free):
        def value(free):
            return warm_leaf_energy(scale * free, change)

        return *jax.value_and_grad(value)(free), jax.hessian(value)(free)

    best = scipy.optimize.minimize(
        lambda free: derivatives(free)[:2], displacement / scale * 1.05, jac=True,
        hess=lambda free: derivatives(free)[2],
        method="trust-exact", options={"gtol": 1e-14},
    )  # fmt: skip

    # The origin of the table of the test is the middle of its leaves.
    @jax.jit
    def middle(pose):
        place = jnp.array([0.0, 0.0, LENGTH])
        return se2.compose(pose, se2.between(mechanism.reference[1], place)) - place

    np.testing.assert_allclose(
        middle(found.pose("table")), scale * best.x, rtol=1e-8, atol=1e-15
    )


def cantilever(elements):
    """Return a chain of leaves, 6 m long and 0.4 m deep, clamped at the left."""
    size = 6.0 / elements
    leaf = tj.Quadratic(np.diag([1.0 / size, 1e6 / size, 12.0 / size**3]))
    growth = tj.Expansion(1.2e-5, length=size)
    bodies = [tj.Body(str(k), (0.0, k * size, 0.0)) for k in range(elements + 1)]
    hinges = [
        tj.Hinge(
            str(k), str(k), str(k + 1), leaf, (0.0, (k + 0.5) * size, 0.0),
            expansion=growth,
        )
        for k in range(elements)
    ]  # fmt: skip
    return tj.Mechanism(bodies, hinges, fixed=["0"])


@pytest.mark.parametrize(
    ("share", "deflection"), [(lambda x: 1.0, 10.80e-3), (lambda x: x, 3.600e-3)]
)
def test_a_gradient_of_the_temperature_bends_a_cantilever(share, deflection):
    """A difference of 20 K over the depth; deflections alpha dT L^2 / (2 h) and / (6 h).

    The beam bends away from its warmer side.
    """
    elements = 20
    gradients = {
        str(k): share((k + 0.5) / elements) * 20.0 / 0.4 for k in range(elements)
    }
    found = tj.equilibrium(cantilever(elements).at_temperature(0.0, gradients=gradients))
    end = np.asarray(found.displacement(str(elements)))
    assert_close(end[2], -deflection, digits=4)


# A difference of 20 K over the thickness of a leaf: natural curvature, and turn of the
# ends of a free leaf
CURVATURE = 12e-6 * 20.0 / THICKNESS
TURN = CURVATURE * LENGTH
BENDING = 210e9 * WIDTH * THICKNESS**3 / 12  # N m^2
BEAM = tj.flexures.Beam(STEEL, length=LENGTH, thickness=THICKNESS, width=WIDTH)


def bent_leaf(energy, fixed):
    """Return a leaf along x with a gradient of the temperature."""
    hinge = tj.Hinge(
        "leaf", "wall", "tip", energy, (0.0, LENGTH / 2, 0.0), expansion=GROWTH
    )
    bodies = [tj.Body("wall"), tj.Body("tip", (0.0, LENGTH, 0.0))]
    mechanism = tj.Mechanism(bodies, [hinge], fixed=fixed)
    return mechanism.at_temperature(0.0, gradients={"leaf": 20.0 / THICKNESS})


QUARTIC = tj.flexures.quartic_leaf(STEEL, length=LENGTH, thickness=THICKNESS, width=WIDTH)


@pytest.mark.parametrize(
    "energy",
    mostly_slow([LEAF, QUARTIC, 0.3 * LEAF + 0.7 * QUARTIC]),
    ids=["leaf", "quartic", "sum"],
)
def test_a_gradient_loads_a_clamped_leaf_by_a_moment_only(energy):
    """M = E I alpha g, without a force, and the stress is E alpha g t / 2."""
    warm = bent_leaf(energy, ["wall", "tip"])
    found = tj.equilibrium(warm)
    wrench = np.asarray(wrench_of["leaf"](warm, found))
    assert_close(wrench[0] / (BENDING * CURVATURE), 1.0, digits=12)
    assert np.all(np.abs(wrench[1:]) < 1e-12 * 210e9 * AREA)
    stored = BENDING * CURVATURE**2 * LENGTH / 2
    energy_of = jax.jit(lambda mechanism, found: mechanism.energy_of("leaf", found))
    assert_close(np.asarray(energy_of(warm, found)) / stored, 1.0, digits=12)
    assert_close(np.asarray(found.energy) / stored, 1.0, digits=12)
    stress = 210e9 * CURVATURE * THICKNESS / 2
    found_stress = np.asarray(tj.stresses(warm, found).largest)
    assert_close(found_stress / stress, [1.0], digits=9)


def test_a_gradient_bends_a_free_leaf_to_an_arc():
    """Its end approaches the wall by L - sin(a) / k, and it is free of stress."""
    warm = bent_leaf(QUARTIC, ["wall"])
    found = tj.equilibrium(warm)
    x, y = np.sin(TURN) / CURVATURE - LENGTH, -(1 - np.cos(TURN)) / CURVATURE
    ratios = np.asarray(found.displacement("tip")) / np.array([-TURN, x, y])
    np.testing.assert_allclose(ratios, 1.0, rtol=3e-4)
    stored = BENDING * CURVATURE**2 * LENGTH / 2
    assert abs(found.energy) < 1e-4 * stored
    (stress,) = np.asarray(tj.stresses(warm, found).largest)
    assert stress < 1e-6 * 210e9 * CURVATURE * THICKNESS


def test_tension_of_a_clamped_leaf_does_not_act_on_its_natural_curvature():
    """A straight leaf has the stress N / A + E alpha g t / 2, though N bends an arc."""
    model = BeamStress.of(BEAM)
    energy = tj.energies.WithValidityRange(
        QUARTIC, 1.0, 1e4, 3 * [1e-3], stress_model=model
    )
    warm = bent_leaf(energy, ["wall", "tip"])
    stretched = np.array(warm.reference)
    stretched[1, 1] += 1e-4 * LENGTH  # N = 12 E I / L^2
    stress = 210e9 * (1e-4 + CURVATURE * THICKNESS / 2)
    found_stress = np.asarray(tj.stresses(warm, stretched).largest)
    assert_close(found_stress / stress, [1.0], digits=9)


@pytest.mark.release
def test_a_gradient_bends_a_curved_chain_as_one_arc():
    """A ring segment of 1 rad in two segments: clamped, E I alpha g; free, an arc."""
    curvature = 1.0 / LENGTH
    beam = tj.flexures.Beam(
        STEEL, length=LENGTH, thickness=THICKNESS, width=WIDTH,
        curvature=lambda position: curvature + 0 * position,
    )  # fmt: skip
    ends = [
        (side / 2, LENGTH * np.sin(side / 2), LENGTH * (1 - np.cos(side / 2)))
        for side in (-1, 1)
    ]
    bodies = [tj.Body("wall", ends[0]), tj.Body("tip", ends[1])]
    flexure = tj.flexures.chain("c", beam, "wall", "tip", (0, 0, 0), segments=2)
    gradients = {hinge.name: 20.0 / THICKNESS for hinge in flexure.hinges}

    def equilibrium(fixed):
        mechanism = tj.Mechanism([*bodies, *flexure.bodies], flexure.hinges, fixed)
        warm = mechanism.at_temperature(0.0, gradients=gradients)
        return warm, tj.equilibrium(warm)

    warm, found = equilibrium(["wall", "tip"])
    for name in gradients:
        wrench = warm.wrench_of(name, found)
        # The stiffness of the surrogates has these errors.
        assert_close(wrench[0] / (BENDING * CURVATURE), 1.0, digits=5)
        assert np.all(np.abs(wrench[1:]) < 1e-4 * BENDING * CURVATURE / LENGTH)
    _, found = equilibrium(["wall"])
    new = curvature - CURVATURE
    turn = new * LENGTH
    arc = jnp.array([turn, np.sin(turn) / new, (1 - np.cos(turn)) / new])
    exact = se2.compose(jnp.array(ends[0]), arc)
    moved = exact - np.array(ends[1])
    np.testing.assert_allclose(found.displacement("tip"), moved, rtol=1e-5)


@pytest.mark.slow
def test_a_gradient_loads_a_clamped_beam_of_any_curvature_by_a_moment_only():
    """Free ends turn about the centroid of the center line, which is not on axis 2."""
    beam = tj.flexures.Beam(
        STEEL, length=LENGTH, thickness=THICKNESS, width=WIDTH,
        curvature=lambda position: 12.0 + 800.0 * position,
    )  # fmt: skip
    energy = tj.surrogate(beam, rotation=0.2, force=2.0)
    growth = tj.flexures.beam_expansion(beam)
    assert growth is not None and abs(growth.centroid[0]) > 1e-3 * LENGTH
    hinge = tj.Hinge("leaf", "wall", "tip", energy, (0.1, 0.0, 0.0), expansion=growth)
    bodies = [tj.Body("wall"), tj.Body("tip")]
    clamped = tj.Mechanism(bodies, [hinge], fixed=["wall", "tip"])
    warm = clamped.at_temperature(0.0, gradients={"leaf": 20.0 / THICKNESS})
    wrench = warm.wrench_of("leaf", warm.reference)
    assert_close(wrench[0] / (BENDING * CURVATURE), 1.0, digits=4)
    assert np.all(np.abs(wrench[1:]) < 1e-3 * BENDING * CURVATURE / LENGTH)


@pytest.mark.slow
def test_a_warm_arch_is_a_larger_one_that_is_compressed():
    """Its ends are not on axis 1: they move apart along their chord, not along axis 1."""
    ends = np.array([[-0.03, -0.01], [0.02, -0.005]])
    growth = tj.Expansion(1e-5, ends=ends)
    assert_close(growth.length, 0.05, digits=15)
    energy = tj.Quadratic(np.diag([2.0, 9e4, 3e4]), "twist", flexure=True)
    cos, sin = np.cos(-0.7), np.sin(-0.7)
    turned = ends @ np.array([[cos, sin], [-sin, cos]])
    tip = ends[1] - turned[0] + turned[1]
    second = (-0.7, *(ends[1] - turned[0]))
    bodies = [
        tj.Body("wall", (0.0, *ends[0])),
        tj.Body("middle", (0.0, *ends[1]), expansion=1e-5),
        tj.Body("tip", (0.0, *tip)),
    ]
    hinges = [
        tj.Hinge("1", "wall", "middle", energy, (0, 0, 0), expansion=growth),
        tj.Hinge("2", "middle", "tip", energy, second, expansion=growth),
    ]
    clamped = tj.Mechanism(bodies, hinges, fixed=["wall", "tip"])
    warm = tj.equilibrium(clamped.at_temperature(100.0))
    scale = 1 + 1e-3
    closing = -1e-3 / scale * (tip - ends[0])
    released = tj.Mechanism(bodies, hinges, fixed=["wall"])
    drive = tj.Drive("tip", angle=0.0, x=closing[0], y=closing[1])
    cold = tj.equilibrium(released, drives=[drive])
    np.testing.assert_allclose(
        warm.reaction("tip"),
        cold.reaction("tip") * np.array([scale**3, scale**2, scale**2]),
        rtol=1e-9,
    )


def test_only_energies_of_known_dimensions_dilate():
    """A polynomial and the same quadratic energy stay; that of a flexure grows by s^3."""
    stiffness = np.diag([2.0, 100.0, 100.0])
    polynomial = tj.energies.Polynomial(
        [1.0, 50.0, 50.0], [(2, 0, 0), (0, 2, 0), (0, 0, 2)], "twist"
    )

    def limited(energy):
        return tj.energies.WithValidityRange(energy, 1.0, 100.0, 3 * [1e-3])

    tangent_stiffness = jax.jit(lambda energy: energy.tangent_stiffness())
    quadratic = tj.Quadratic(stiffness, "twist")
    flexure = tj.Quadratic(stiffness, "twist", flexure=True)
    for energy, factor in (
        (polynomial, 1.0), (quadratic, 1.0), (limited(quadratic), 1.0),
        (quadratic + 0.5 * quadratic, 1.5), (flexure, 1.1**3), (limited(flexure), 1.1**3),
    ):  # fmt: skip
        hinge = tj.Hinge(
            "h",
            "wall",
            "block",
            energy,
            (0, 0, 0),
            expansion=tj.Expansion(1e-3, length=1),
        )
        bodies = [tj.Body("wall"), tj.Body("block")]
        warm = tj.Mechanism(bodies, [hinge], ["wall"]).at_temperature(100.0)
        found = warm.hinge_assembly.energy_of(0)
        stiffness = np.asarray(tangent_stiffness(found))
        assert_close(stiffness[0, 0] / 2.0, factor, digits=12)
        if isinstance(found, tj.energies.WithValidityRange):
            assert_close(found.force, 100.0 * factor ** (2 / 3), digits=12)


@pytest.mark.slow
def test_drift_per_kelvin_is_a_derivative():
    def height(change):
        mechanism = guide(expansion=None)
        warm = mechanism.at_temperature(change, hinges={"left": 2 * change})
        return tj.equilibrium(warm).displacement("table")

    differentiate, step = jax.jacrev(with_value(height), has_aux=True), 1e-2
    drift, _ = differentiate(0.0)
    difference = (differentiate(step)[1] - differentiate(-step)[1]) / (2 * step)
    np.testing.assert_allclose(drift, difference, rtol=1e-6, atol=1e-15)
    assert_close(drift[0], -12e-6 * LENGTH / SPACING, digits=6)


PIN = tj.Pin("joint", "A", "B", at=(0.15, 0.0))
RAIL = tj.Slider("joint", "A", "B", at=(np.pi / 2, 0.15, 0.0))


def jointed(of_a, of_b):
    """Return two bodies on a spring, with origins at x = 0 and x = 50 mm."""
    spring = tj.Quadratic(jnp.diag(jnp.array([1.0, 10.0, 10.0])))
    bodies = [
        tj.Body("A", expansion=of_a),
        tj.Body("B", (0.0, 0.05, 0.0), mass=1.0, inertia=1.0, expansion=of_b),
    ]
    hinge = tj.Hinge("spring", "A", "B", spring, at=(0.0, 0.02, 0.0))
    return tj.Mechanism(bodies, [hinge], fixed=["A"])


@pytest.mark.parametrize("joint", [PIN, RAIL])
def test_a_joint_moves_with_the_expansion_of_both_bodies(joint):
    warm = jointed(1e-5, 2e-5).at_temperature(30.0).at_temperature(20.0)
    moved = tj.equilibrium(warm, constraints=[joint]).displacement("B")[1]
    np.testing.assert_allclose(moved, (0.15 * 1e-5 - 0.1 * 2e-5) * 50.0, rtol=1e-3)
    alike = jointed(1e-5, 1e-5).at_temperature(50.0)
    scaled = tj.equilibrium(alike, constraints=[joint])
    np.testing.assert_allclose(scaled.displacement("B")[1], 0.05e-5 * 50.0, rtol=1e-9)
    assert np.all(np.abs(scaled.constraint_force("joint")) < 1e-12)


def test_a_joint_does_not_move_with_a_temperature_that_changes():
    body = jointed(1e-5, 1e-5)
    with pytest.raises(ValueError, match=r"'joint' is on the body 'A'.*`at_temperature`"):
        tj.path(body, temperature=5.0, constraints=[PIN])
    with pytest.raises(ValueError, match=r"'joint' is on the body 'A'.*`at_temperature`"):
        tj.simulate(body, [0.0, 1.0], temperature=lambda t: 5.0 * t, constraints=[PIN])


def test_expansions_are_saved(tmp_path):
    file = tmp_path / "guide.json"
    mechanism = guide()
    tj.io.save_mechanism(mechanism, file)
    loaded = tj.io.load_mechanism(file)
    for before, after in zip(
        jax.tree.leaves(mechanism.at_temperature(3.0)),
        jax.tree.leaves(loaded.at_temperature(3.0)),
        strict=True,
    ):
        np.testing.assert_array_equal(before, after)
    with pytest.raises(ValueError, match="has been expanded by `at_temperature`"):
        tj.io.save_mechanism(mechanism.at_temperature(3.0), file)


def stage_on_piezo(stiffness=1e6):
    """Return a block on a spring that a piezo stack drives."""
    stack = tj.flexures.piezo_stack(
        free_stroke=15e-6, blocking_force=800.0, length=18e-3, width=5e-3
    )
    spring = tj.Quadratic(np.diag([1e3, stiffness, 1e6]))
    hinges = [
        tj.Hinge("piezo", "base", "block", stack, (0.0, -0.01, 0.0)),
        tj.Hinge("spring", "block", "base", spring, (0.0, 0.01, 0.0)),
    ]
    return tj.Mechanism([tj.Body("base"), tj.Body("block")], hinges, fixed=["base"])


def test_stroke_of_a_piezo_stack_against_a_spring():
    """The stroke is x0 kp / (kp + k), on the load line of the stack."""
    stiff, spring = 800.0 / 15e-6, 1e6
    mechanism = stage_on_piezo(spring)

    def displaced(stroke):
        moved = mechanism.with_strokes({"piezo": (0.0, stroke, 0.0)})
        found = tj.equilibrium(moved, throw=False)
        displacement = found.displacement("block")[1]
        return displacement, (displacement, moved.wrench_of("piezo", found)[1])

    differentiate = jax.jit(jax.grad(displaced, has_aux=True))
    gain, (moved, force) = map(np.asarray, differentiate(15e-6))
    stroke = 15e-6 * stiff / (stiff + spring)
    assert_close(moved / stroke, 1.0, digits=10)
    assert_close(-force, 800.0 * (1 - stroke / 15e-6), digits=10)
    assert_close(gain, stiff / (stiff + spring), digits=10)


def test_linear_response_to_strokes_is_the_derivative_at_a_loaded_equilibrium():
    mechanism = stage_on_piezo().with_strokes({"piezo": (0.0, 10e-6, 1e-6)})
    state = tj.equilibrium(mechanism)
    change = {"piezo": (1e-6, 2e-6, -1e-6), "spring": (0.0, 1e-6, 0.0)}
    linear = tj.linearize(mechanism, about=state)(strokes=change)

    def displaced(share):
        strokes = {name: share * np.array(stroke) for name, stroke in change.items()}
        moved = mechanism.with_strokes(strokes)
        return np.asarray(tj.equilibrium(moved, start=state).displacements)

    difference = (displaced(0.1) - displaced(-0.1)) / 0.1
    found, scale = np.asarray(linear.displacements), 1e-6
    np.testing.assert_allclose(found / scale, difference / 2 / scale, atol=1e-6)


def test_weights_hang_a_mechanism_from_its_springs():
    spring = tj.Quadratic(np.diag([2.0, 50.0, 80.0]))
    hinge = tj.Hinge("h", "wall", "mass", spring, (0, 0, 0))
    bodies = [tj.Body("wall"), tj.Body("mass", mass=2.0, inertia=0.5)]
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    found = tj.equilibrium(mechanism, loads=tj.weights(mechanism, gravity=(0.0, -9.81)))
    assert_close(found.displacement("mass"), [0.0, 0.0, -2.0 * 9.81 / 80.0])
    assert len(tj.weights(mechanism)) == 1
    assert_close(np.asarray(found.reaction("wall"))[2], 2.0 * 9.81)
    with pytest.raises(ValueError, match="'table' can move, but has no `mass`"):
        tj.weights(guide())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: guide().at_temperature(np.nan), "`change` is nan, but must be finite"),
        (
            lambda: guide().at_temperature(1.0, bodies={"lid": 1.0}),
            "`bodies` names the body 'lid', but the bodies are 'base', 'table'",
        ),
        (
            lambda: guide().with_strokes({"piezo": (0, 0, 0)}),
            "`strokes` names the hinge 'piezo', but the hinges are 'left', 'right'",
        ),
        (
            lambda: tj.Expansion(tj.Material(1.0, 0.3), length=1.0),
            "The material has no `expansion`",
        ),
        (lambda: tj.Expansion(1e-6, length=0.0), "`length` is 0, but must be positive"),
        (lambda: tj.Expansion(1e-6), "either the `length`"),
        (lambda: tj.Expansion(1e-6, length=1, arc_length=2), "is straight. Give the"),
        (lambda: tj.Expansion(1e-6, ends=[(0.1, 0.2)]), "the positions .x, y. of both"),
        (
            lambda: tj.io.exudyn_script(guide().at_temperature(1.0)),
            "The mechanism has misfits, but the springs of the script",
        ),
    ],
)
def test_invalid_changes_are_reported(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_parts_that_cannot_expand_are_reported():
    hinge = tj.Hinge("leaf", "base", "table", LEAF, (np.pi / 2, 0.0, LENGTH / 2))
    bodies = [tj.Body("base"), tj.Body("table", (0.0, 0.0, LENGTH))]
    rigid = tj.Mechanism(bodies, [hinge], fixed=["base"])
    with pytest.raises(ValueError, match="No body and no hinge has an `expansion`"):
        rigid.at_temperature(1.0)
    with pytest.raises(ValueError, match="'leaf' has no `expansion`"):
        rigid.at_temperature(0.0, gradients={"leaf": 1.0})
    bodies[1] = tj.Body("table", (0.0, 0.0, LENGTH), expansion=12e-6)
    warm = tj.Mechanism(bodies, [hinge], fixed=["base"])
    message = "'table' would expand by -1.2 times its size, but thermal strains must be"
    missing = "'leaf' is a flexure without an `expansion`"
    with (
        pytest.warns(UserWarning, match=missing),
        pytest.raises(ValueError, match=message),
    ):
        warm.at_temperature(-1e5)
    with pytest.warns(UserWarning, match=missing) as found:
        warm.at_temperature(1.0)
    assert found[0].filename == __file__
