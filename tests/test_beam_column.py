"""The energy of a leaf as a beam-column, against closed forms and the elastica."""

import json
import pathlib
from functools import partial
from typing import TypedDict

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, with_value
from scipy.optimize import minimize_scalar

import twistorjax as tj
from twistorjax.geometry.twistors import Displacement


REFERENCE = json.loads(
    (pathlib.Path(__file__).parent / "reference" / "beams.json").read_text()
)


class Size(TypedDict):
    length: float
    thickness: float
    width: float


UNIT = tj.Material(modulus=1.0, poisson=0.3)
AXIAL = 30_000  # E A L^2 / (E I) of the reference values
UP = np.pi / 2


THICKNESS = np.sqrt(12 / AXIAL)


def unit_leaf(thickness=THICKNESS, **settings):
    """A leaf of unit length and unit bending stiffness."""
    size = {"length": 1.0, "thickness": thickness, "width": 12 / thickness**3}
    return tj.flexures.leaf(UNIT, **size, **settings)


LEAF = unit_leaf()
tangent_stiffness = jax.jit(lambda pose: LEAF.tangent_stiffness(pose))


def guided_stiffness(p):
    """Transverse stiffness of a beam-column with parallel ends; EI/L^3."""
    k = np.sqrt(complex(p))
    return (p / (1 - 2 / k * np.tanh(k / 2))).real


def cantilever_stiffness(p):
    """Transverse stiffness of a clamped beam-column at its free end; EI/L^3."""
    k = np.sqrt(complex(p))
    return (p / (1 - np.tanh(k) / k)).real


@pytest.mark.parametrize("p", [-38.0, -0.95 * np.pi**2, -1.0, 1e-3, 10.0, 80.0, 1e3])
def test_transverse_stiffness_under_an_axial_force(p):
    stretched = jnp.array([0.0, p / AXIAL, 0.0])
    transverse = np.asarray(tangent_stiffness(stretched))[2, 2]
    np.testing.assert_allclose(transverse, guided_stiffness(p), rtol=1e-9)


def column(*energies, height=1.0, **body):
    """A table on leaves along y, side by side."""
    hinges = [
        tj.Hinge(f"leaf {k}", "base", "table", energy, at=(UP, 0.0, height / 2))
        for k, energy in enumerate(energies)
    ]
    table = tj.Body("table", pose=(0.0, 0.0, height), **body)
    return tj.Mechanism([tj.Body("base"), table], hinges, fixed=["base"])


@pytest.mark.parametrize("p", [-2.3, 0.1, 20.0])
def test_cantilever_under_an_axial_force(p):
    """Its end rotates, so the rotational stiffness and the force arm count as well."""
    loads = [tj.Load("table", force=(0.0, p))]
    mechanism = column(LEAF)
    small = tj.linearize(
        mechanism, about=tj.equilibrium(mechanism, loads=loads), loads=loads
    )
    compliance = small(loads=[tj.Load("table", force=(1.0, 0.0))]).displacement("table")
    # The exact beam is stretched by p / AXIAL.
    np.testing.assert_allclose(1 / compliance[1], cantilever_stiffness(p), rtol=3e-3)
    slender = column(unit_leaf(1e-4))
    small = tj.linearize(slender, about=tj.equilibrium(slender, loads=loads), loads=loads)
    compliance = small(loads=[tj.Load("table", force=(1.0, 0.0))]).displacement("table")
    np.testing.assert_allclose(1 / compliance[1], cantilever_stiffness(p), rtol=1e-7)


def test_stressed_resonator(validated, pictured):
    """Residual stress as a misfit: both leaves are too short for their clamps."""
    thickness, mass = 0.01, 3.0
    axial = 12 / thickness**2
    bodies = [tj.Body("walls"), tj.Body("mass", mass=mass, inertia=0.01)]

    def frequency(p):
        hinges = [
            tj.Hinge(name, *ends, unit_leaf(thickness), at=(0.0, x, 0.0),
                     misfit=(0.0, -p / axial, 0.0))
            for name, ends, x in (
                ("left", ("walls", "mass"), -0.5), ("right", ("mass", "walls"), 0.5)
            )
        ]  # fmt: skip
        resonator = tj.Mechanism(bodies, hinges, fixed=["walls"])
        return tj.vibrations(resonator, about=resonator.reference).frequencies[0]

    tensions = np.array([-9.0, -8.0, -5.0, 0.1, 5.0, 10.0, 20.0, 30.0, 40.0])
    found = np.array([frequency(p) for p in tensions])
    exact = np.sqrt([2 * guided_stiffness(p) / mass for p in tensions]) / (2 * np.pi)
    np.testing.assert_allclose(found, exact, rtol=1e-6)
    part = "Vibrations and waves"
    name = "frequency of a mass on two leaves under tension, P up to 40 E I / L²"
    validated(part, name, found, exact, "tanh of the beam column")
    caption = "Frequency of a mass between two leaves, with E I = L = 1 and a mass of 3."
    pictured(
        part, "stressed-resonator", caption, ("tension P L²/E I", "frequency"),
        {"tensioned leaves": (tensions, found)}, {"beam column": (tensions, exact)},
    )  # fmt: skip


@pytest.mark.release
def test_a_guide_buckles_at_the_load_of_euler():
    """Under `equilibrium` and `path`; each leaf bears pi^2 E I / L^2."""
    guide = tj.Mechanism(
        [tj.Body("base"), tj.Body("table", pose=(0.0, 0.0, 1.0))],
        [tj.Hinge(name, "base", "table", LEAF, at=(UP, x, 0.5))
         for name, x in (("left", -20.0), ("right", 20.0))],
        fixed=["base"],
    )  # fmt: skip
    critical = tj.Load("table", force=(0.0, -2 * np.pi**2))
    path = tj.path(guide, loads=[critical], load_factors=(0.0, 1.1))
    (point,) = path.critical_points
    np.testing.assert_allclose(point.load_factor, 1.0, rtol=1e-5)
    tj.equilibrium(guide, loads=[tj.Load("table", force=(0.0, -0.999 * 2 * np.pi**2))])
    with pytest.raises(RuntimeError, match=r"branch point at the fraction 0\.99"):
        tj.equilibrium(guide, loads=[tj.Load("table", force=(0, -1.01 * 2 * np.pi**2))])


@jax.jit
@partial(jax.vmap, in_axes=(None, 0, 0))
def forces_again(leaf, bending, force):
    """Compute axial forces from the axial displacements that they cause."""
    (shortening,) = leaf.potential.derivatives(((0, 0, 1),), bending, (force,))
    return leaf.potential.forces_at(bending, (-shortening,))[0]


@pytest.mark.parametrize("slenderness", [1e3, 1e5, 1e7])
@pytest.mark.parametrize("shear", [False, True])
def test_the_axial_force_is_that_of_its_axial_displacement(slenderness, shear):
    """The axial displacement is an explicit function of the force, and not vice versa.

    Rotations are zero, tiny, and large, because the pole at buckling depends on them.
    """
    leaf = tj.energies.BeamColumn(
        1.0, 1.0, slenderness, slenderness / 3 if shear else None
    )
    random = np.random.default_rng(0)
    radius, phase = random.uniform(0, 1, 3000), random.uniform(0, 2 * np.pi, 3000)
    size = np.repeat([0.0, 1.0, 1.0], 1000) * 10.0 ** random.uniform(-8, 0, 3000)
    size[2000:] = 1.0
    rotation, transverse = 0.8 * size * np.cos(phase), 0.25 * np.sin(phase)
    bending = radius * rotation, radius * transverse
    lowest = -0.999 * np.asarray(leaf.potential.buckling_ratio)
    force = np.where(
        random.uniform(size=3000) < 0.5,
        lowest * random.uniform(0, 1, 3000),
        np.minimum(lowest + 10.0 ** random.uniform(-4, 3, 3000), 0.05 * slenderness),
    )
    found = forces_again(leaf, bending, force)
    np.testing.assert_allclose(found, force, rtol=1e-9, atol=1e-9)


ROD = tj.Mechanism(
    [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))],
    [tj.Hinge("rod", "a", "b", LEAF, at=(0.0, 0.5, 0.0))],
    fixed={"a": ["angle", "x", "y"], "b": ["angle", "y"]},
)


def pressed(share, **settings):
    """Equilibrium of a clamped leaf under a share of its buckling load."""
    force = -share * 4 * np.pi**2, 0.0
    return tj.equilibrium(ROD, loads=[tj.Load("b", force=force)], **settings)


def test_a_clamped_leaf_is_out_of_range_above_its_buckling_load():
    assert bool(pressed(0.99).succeeded)
    beyond = pressed(1.01, throw=False)
    assert tj.result_names(beyond.result) == "out_of_range"
    with pytest.raises(ValueError, match="All bodies are fixed or driven"):
        tj.buckling(ROD, drives=[tj.Drive("b", x=-1e-3)])


@pytest.mark.slow
def test_a_clamped_leaf_has_no_mode_of_buckling_within_its_range():
    with pytest.raises(RuntimeError, match=r"hinge 'rod'.*axial forces above -39\.44 N"):
        pressed(1.01)
    load = [tj.Load("b", force=(-1.0, 0.0))]
    with pytest.warns(UserWarning, match=r"up to the load factor 39\.4.* hinge 'rod'"):
        buckled = tj.buckling(ROD, loads=load)
    assert np.isinf(np.asarray(buckled.load_factors)).all()
    assert "no mode buckles within the validity ranges" in repr(buckled)


@pytest.mark.parametrize(
    ("pose", "text"),
    [
        ([0.81, 0.03, 0.0], "its rotation is 0.81 rad"),
        ([0.0, -0.04, 0.26], r"transverse displacement / 0\.25 m"),
        ([0.0, 0.051, 0.0], "elongations up to 0.05 m"),
        ([0.0, -0.0014, 0.0], "axial forces above -39"),
        ([0.1, -0.4, 0.0], "axial forces above -33"),
    ],
)
def test_its_range_ends_where_it_is_inaccurate(pose, text):
    with pytest.raises(ValueError, match=text):
        LEAF.wrench(jnp.array(pose))


def test_cantilever_under_a_transverse_force():
    """Published elastica of Mattiasson (1981), for rotations up to 0.46 rad."""
    mechanism = column(unit_leaf(1e-3))
    for force, across, along, angle in REFERENCE["elastica_tip_force"]["rows"][:2]:
        load = tj.Load("table", force=(-force, 0.0))
        found = tj.equilibrium(mechanism, loads=[load]).displacement("table")
        np.testing.assert_allclose(found, [angle, -across, -along], rtol=2e-4)


def test_parallelogram():
    """Shortening, and lengthwise stiffness of the displaced stage."""
    guide = tj.Mechanism(
        [tj.Body("ground"), tj.Body("table")],
        [tj.Hinge(f"{y}", "ground", "table", LEAF, at=(0.0, -0.5, y))
         for y in (-0.3, 0.3)],
        fixed=["ground"],
    )  # fmt: skip
    rows = REFERENCE["parallelogram_w0.3_k33_30000"]["rows"]
    for across, force, along, angle, stiffness in rows:
        drives = [tj.Drive("table", y=across)]
        at_rest, pulled, pushed = (
            tj.equilibrium(guide, loads=[tj.Load("table", force=(n, 0.0))], drives=drives)
            for n in (0.0, 5.0, -5.0)
        )
        assert_close(at_rest.reaction("table")[2] / force, 1.0, digits=4)
        found = at_rest.displacement("table")[:2] / np.array([angle, along])
        np.testing.assert_allclose(found, 1.0, rtol=1e-2)
        elongation = pulled.displacement("table")[1] - pushed.displacement("table")[1]
        np.testing.assert_allclose(10 / elongation, stiffness, rtol=1e-2)


def potential(rotation, across, p, shear=0.0):
    """The potential of the class, written with complex square roots."""
    factor = 1 + (1 / AXIAL - shear) * p if shear else 1.0
    k = np.sqrt(complex(factor * p))
    r = (k / 2 / np.tanh(k / 2)).real - p / 4
    s = 1 / (factor**2 / guided_stiffness(factor * p) + shear)
    a, b = rotation**2, across**2
    quartic = 36 / 175 * b**2 + 9 / 1400 * a * b + a**2 / 480
    value = (r * a + s * b - p**2 / AXIAL) / 2 + 108 / 35 * b**2 + 3 / 10 * a * b
    return value + quartic * p / (1 + 3 / 616 * p)


@pytest.mark.parametrize("theory", ["euler-bernoulli", "timoshenko"])
def test_energy_is_the_maximum_over_the_axial_force(theory):
    """Also in strong compression, close to the pole, and in strong tension."""
    energy = unit_leaf(theory=theory)
    computed = jax.jit(lambda at: (energy.stored_energy(at), energy.axial_force(at)))
    shear = 0.0 if theory == "euler-bernoulli" else 2 * 1.3 * 6 / 5 / AXIAL
    for angle, along, across in [
        (0.3, 0.0, 0.1), (0.5, -0.06, 0.1), (-0.2, 0.04, 0.0), (0.0, -0.001, 1e-3),
        (0.7, 0.03, -0.05), (0.01, -0.02, 0.01), (0.0, 0.04, 0.0),
    ]:  # fmt: skip

        def negative(p, angle=angle, along=along, across=across):
            return -(p * along + potential(angle, across, p, shear))

        found = minimize_scalar(
            negative, bounds=(-39.4, 3000), options={"xatol": 1e-12, "maxiter": 999}
        )
        half = angle / 2
        numbers = angle, np.cos(half), np.sin(half), along / 2, across / 2
        stored, force = computed(Displacement(*map(jnp.asarray, numbers)))
        np.testing.assert_allclose(stored, -found.fun, rtol=1e-9)
        np.testing.assert_allclose(force, found.x, rtol=1e-4, atol=1e-4)


def test_derivatives_of_the_energy():
    """Of the wrench by the pose, and of the energy by the dimensions."""
    pose, step = np.array([0.2, -0.004, 0.05]), 1e-6
    hessian = jax.hessian(lambda pose: LEAF(pose))
    derivatives = jax.jit(jax.jacfwd(with_value(hessian), has_aux=True))
    third = np.asarray(derivatives(pose)[0])
    for k, direction in enumerate(np.eye(3)):
        _, ahead = derivatives(pose + step * direction)
        _, behind = derivatives(pose - step * direction)
        difference = (np.asarray(ahead) - np.asarray(behind)) / (2 * step)
        np.testing.assert_allclose(third[..., k], difference, rtol=1e-6, atol=1e-2)

    @jax.jit
    @jax.value_and_grad
    def energy(thickness):
        leaf = tj.flexures.leaf(UNIT, length=1.0, thickness=thickness, width=1e3)
        return leaf(jnp.asarray(pose))

    difference = float(energy(0.03 + step)[0]) - float(energy(0.03 - step)[0])
    np.testing.assert_allclose(energy(0.03)[1], difference / (2 * step), rtol=1e-7)


@pytest.mark.slow
def test_stress_is_largest_between_the_ends_of_a_compressed_leaf():
    steel = tj.Material(modulus=210e9, poisson=0.3, strength=500e6)
    size: Size = {"length": 50e-3, "thickness": 0.5e-3, "width": 10e-3}
    leaf = tj.flexures.leaf(steel, **size)
    exact = tj.flexures.Beam(steel, **size, shear_factor=None)
    unit = 210e9 * 10e-3 * 0.5e-3**3 / 12 / 50e-3**2  # E I / L^2
    for force in (-20 * unit, 5 * unit):
        loads = [tj.Load("table", force=(0.0, force))]
        mechanism = column(leaf, height=50e-3)
        turned = tj.equilibrium(
            mechanism, loads=loads, drives=[tj.Drive("table", angle=0.1, x=-2.4e-3)]
        )
        pose = mechanism.displacement_of("leaf 0", turned)
        stress = jnp.abs(tj.flexures.beam_at_pose(exact, pose).stress).max(axis=1)
        assert turned.stresses is not None
        np.testing.assert_allclose(turned.stresses.largest[0], stress.max(), rtol=5e-3)
        assert (stress.argmax() in (0, len(stress) - 1)) == (force > 0)


def test_stress_of_a_thick_leaf_in_compression():
    """Without its shear and its stretch, the bending part would be 12 % too small."""
    steel = tj.Material(modulus=210e9, poisson=0.3, strength=500e6)
    size: Size = {"length": 1.0, "thickness": 0.1, "width": 0.3}
    leaf = tj.flexures.leaf(steel, **size, theory="timoshenko")
    exact = tj.flexures.Beam(steel, **size, shear_factor=5 / 6)
    unit = 210e9 * 0.3 * 0.1**3 / 12
    pose = np.array([0.02, -0.0155, 0.0])
    solution = tj.flexures.beam_at_pose(exact, pose)
    assert -19 < np.asarray(solution.wrench)[1] / unit < -18
    bodies = [tj.Body("a"), tj.Body("b")]
    hinge = tj.Hinge("leaf", "a", "b", leaf, (0.0, 0.0, 0.0))
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["a"])
    (found,) = np.asarray(tj.stresses(mechanism, np.stack([0 * pose, pose])).largest)
    stress = np.abs(np.asarray(solution.stress)).max(axis=1)
    assert 0 < stress.argmax() < len(stress) - 1
    np.testing.assert_allclose(found, stress.max(), rtol=2e-3)


def test_a_thick_leaf_shears():
    """Against the exact beam with the same shear correction factor."""
    thickness = 0.2
    size: Size = {"length": 1.0, "thickness": thickness, "width": 12 / thickness**3}
    exact = tj.flexures.Beam(UNIT, **size, shear_factor=5 / 6)
    energy = unit_leaf(thickness, theory="timoshenko")
    for load in ([0.0, 0.0, 1.0], [0.3, 3.0, -0.5], [0.3, -3.0, 0.5]):
        bent = tj.flexures.beam_under_load(exact, jnp.array(load))
        np.testing.assert_allclose(energy.wrench(bent.pose), bent.wrench, atol=0.02)


def test_an_expanded_leaf_is_a_leaf_of_larger_dimensions():
    growth = jnp.array(1.01)
    for theory in ("euler-bernoulli", "timoshenko"):
        size = {"length": 1.0, "thickness": 0.02, "width": 0.3}
        expanded = tj.flexures.leaf(UNIT, **size, theory=theory).dilated(growth)
        larger = {name: growth * value for name, value in size.items()}
        larger = tj.flexures.leaf(UNIT, **larger, theory=theory)
        pose = jnp.array([0.1, 1e-3, 0.05])
        np.testing.assert_allclose(expanded.wrench(pose), larger.wrench(pose), rtol=1e-12)


def test_bending_is_not_damped_as_a_stretch():
    """A leaf that bends without axial force: its power is that of the bending alone."""
    damping = LEAF.proportional_damping(jnp.array(1e-3))
    angle, across = 0.4, 0.1

    def bent(share):
        """The twist of a leaf without axial force; `share` scales its bending."""
        a, b = (share * angle) ** 2, (share * across) ** 2
        quartic = 36 / 175 * b**2 + 9 / 1400 * a * b + a**2 / 480
        along = a / 12 - 3 / 5 * b - quartic
        scale = (share * angle / 2) / jnp.sin(share * angle / 2)
        return jnp.stack([share * angle, scale * along, scale * share * across])

    @jax.jit
    def resisted():
        twist, rate = jax.jvp(bent, (1.0,), (1.0,))
        at = Displacement.from_pose(tj.geometry.se2.exp(twist))
        return LEAF.resisted_rates(at, tuple(rate))

    np.testing.assert_allclose(resisted(), [angle, 0.0, across], atol=1e-9)
    assert damping.resisted
