"""Sub-mechanisms that act as one hinge: exact energies, surrogates, ready-made ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose as assert_close
from scipy.optimize import minimize

import twistorjax as tj
from twistorjax.flexures import Condensed
from twistorjax.geometry import se2
from twistorjax.plotting.shapes import shapes


STEEL = tj.Material(modulus=210e9, poisson=0.3)
LENGTH, THICKNESS = 20e-3, 0.4e-3
BEAM = tj.flexures.Beam(
    STEEL, length=LENGTH, thickness=THICKNESS, width=10e-3, shear_factor=None
)
BENDING = float(BEAM.rotational_stiffness)  # E I / L; N m/rad
DEGREES_20 = np.radians(20)


QUADRATIC_LEAF = tj.Quadratic(
    tj.flexures.linear_leaf(
        STEEL, length=LENGTH, thickness=THICKNESS, width=10e-3
    ).stiffness
)
RANGED_LEAF = tj.energies.WithValidityRange(
    QUADRATIC_LEAF, 0.5, force=100.0, error=[1e-3] * 3
)


def guide_of_quadratic_leaves(scale=1.0):
    """Build a double parallelogram; the leaves are stiffer by a factor."""
    return tj.flexures.double_parallelogram(
        BEAM, scale * QUADRATIC_LEAF, outer_spacing=20e-3, inner_spacing=12e-3
    )


GUIDE_POSE = jnp.array([2e-4, -4e-6, 2e-3])


@jax.jit
def exact_guide(scale):
    """Return the energy of a guide, its wrench, and the derivative of that by a scale."""

    def wrench(scale):
        return Condensed(guide_of_quadratic_leaves(scale)).wrench(GUIDE_POSE)

    energy = Condensed(guide_of_quadratic_leaves(scale))(GUIDE_POSE)
    return energy, *jax.jvp(wrench, (scale,), (1.0,))


class TestExact:
    def test_it_is_the_smallest_energy_over_the_poses_of_the_inner_body(self):
        part = guide_of_quadratic_leaves()
        rows = np.zeros((3, 3))
        rows[part.mechanism.index("B")] = GUIDE_POSE
        inner = part.mechanism.index("middle")
        units = np.array([1e-3, 1e-5, 1e-3])
        reference = part.mechanism.reference
        energy_and_gradient = jax.jit(
            jax.value_and_grad(lambda rows: part.mechanism.energy(reference + rows))
        )

        def at(values):
            rows[inner] = values * units
            energy, gradient = energy_and_gradient(rows)
            return float(energy), np.asarray(gradient[inner]) * units

        found = minimize(at, np.zeros(3), jac=True, tol=1e-14)
        energy, _, _ = exact_guide(1.0)
        assert_close(energy, found.fun, rtol=1e-9)

    def test_its_wrench_is_the_reaction_of_body_b(self):
        part = guide_of_quadratic_leaves()
        angle, x, y = np.asarray(GUIDE_POSE)
        moved = tj.Drive("B", angle=angle, x=x, y=y)
        reaction = tj.equilibrium(part.mechanism, drives=[moved]).reaction("B")
        moment, force_x, force_y = np.asarray(reaction)
        cos, sin = np.cos(angle), np.sin(angle)
        expected = [moment, cos * force_x + sin * force_y, cos * force_y - sin * force_x]
        _, wrench, _ = exact_guide(1.0)
        assert_close(wrench, expected, rtol=1e-9)

    @pytest.mark.release
    def test_third_derivatives_agree_with_differences_of_the_second_ones(self):
        hessian = jax.hessian(Condensed(guide_of_quadratic_leaves()))
        direction = jnp.array([0.0, 0.0, 1.0])

        @jax.jit
        def hessian_and_derivative(pose):
            return jax.jvp(hessian, (pose,), (direction,))

        step = 1e-6 * direction
        above, _ = hessian_and_derivative(GUIDE_POSE + step)
        below, _ = hessian_and_derivative(GUIDE_POSE - step)
        slope = (above - below) / 2e-6
        _, derivative = hessian_and_derivative(GUIDE_POSE)
        size = jnp.max(jnp.abs(derivative))
        assert_close(derivative / size, slope / size, atol=1e-6)

    def test_a_derivative_by_the_stiffness_agrees_with_differences(self):
        (_, below, _), (_, _, slope), (_, above, _) = map(
            exact_guide, (0.999, 1.0, 1.001)
        )
        difference = np.asarray(above) - np.asarray(below)
        assert_close(slope, difference / 0.002, rtol=1e-6)

    @pytest.mark.release
    def test_a_hinge_with_it_moves_as_the_whole_mechanism(self):
        part = guide_of_quadratic_leaves()
        hinge = tj.Hinge("guide", "A", "B", Condensed(part), at=(0.5, 0.01, 0.02))
        bodies = [tj.Body("A"), tj.Body("B", (0.5, 0.01, 0.02))]
        condensed = tj.Mechanism(bodies, [hinge], fixed=["A"])
        load = jnp.array([0.02, 3.0, 1.0])
        world = jnp.concatenate([load[:1], se2.rotate(jnp.array(0.5), load[1:])])
        of_hinge = tj.equilibrium(condensed, loads=[tj.Load("B", world)])
        angle, *moved = of_hinge.displacement("B")
        x, y = se2.rotate(jnp.array(-0.5), jnp.stack(moved))
        moved = tj.Drive("B", angle=angle, x=x, y=y)
        of_all = tj.equilibrium(part.mechanism, drives=[moved])
        assert_close(of_all.reaction("B"), load, rtol=1e-7)


# The ready-made flexures; the compliant stiffness over E I / L or E I / L^3
FLEXURES = {
    "cross-spring": (
        lambda leaf: tj.flexures.cross_spring_pivot(BEAM, leaf, crossing=0.2),
        0,
        8 * (1 - 3 * 0.2 + 3 * 0.2**2),
    ),
    "cartwheel": (
        lambda leaf: tj.flexures.cartwheel_pivot(BEAM, leaf, hub=2e-3),
        0,
        4 * 1.33,
    ),
    "butterfly": (
        lambda leaf: tj.flexures.butterfly_pivot(BEAM, leaf, radius=5e-3),
        0,
        8 * (1 + 3 * 0.25 + 3 * 0.25**2),
    ),
    "parallelogram": (
        lambda leaf: tj.flexures.parallelogram(BEAM, leaf, spacing=12e-3),
        2,
        24.0,
    ),
    "double parallelogram": (
        lambda leaf: tj.flexures.double_parallelogram(
            BEAM, leaf, outer_spacing=20e-3, inner_spacing=12e-3
        ),
        2,
        12.0,
    ),
    "folded beam": (
        lambda leaf: tj.flexures.folded_beam(
            BEAM, leaf, outer_spacing=20e-3, inner_spacing=12e-3, gap=6e-3
        ),
        2,
        24.0,
    ),
}


@pytest.mark.parametrize("name", FLEXURES)
def test_the_stiffness_of_ready_made_flexures_is_that_of_beam_theory(name):
    """A leaf whose axis passes the center at r resists with 4 E I / L (1 + 3 s + 3 s^2).

    The ratio s is r / L. The leaves are extensible, which the formula neglects.
    """
    build, direction, factor = FLEXURES[name]
    part = build(QUADRATIC_LEAF)
    stiffness = tj.port_compliance(part.mechanism, "B").stiffness[direction, direction]
    unit = BENDING if direction == 0 else BENDING / LENGTH**2
    assert_close(stiffness / unit, factor, rtol=2e-3)


def linkage_of(energy):
    hinge = tj.Hinge("flexure", "A", "B", energy, at=(0, 0, 0))
    return tj.Mechanism([tj.Body("A"), tj.Body("B")], [hinge], fixed=["A"])


@pytest.mark.release
@pytest.mark.parametrize("name", ["cross-spring", "cartwheel", "double parallelogram"])
def test_a_surrogate_agrees_with_the_whole_mechanism(name):
    """Moment, displacement of the center, stiffness, and stress, to 20 degrees."""
    build, direction, _ = FLEXURES[name]
    part = build(tj.surrogate(BEAM, rotation=0.5))
    if direction == 0:
        fast = tj.surrogate(part, rotation=0.36, force=20.0)
        size, key = DEGREES_20, "angle"
    else:
        fast = tj.surrogate(part, displacement=2.1e-3, force=20.0, error=1e-4)
        size, key = 2e-3, "y"

    def solve(mechanism):
        found = []
        for value in (-size, -size / 3, size / 2, size):
            load = tj.Load("B", force=(8.0, 5.0 * (direction == 0)))
            drive = tj.Drive("B", **{key: value})
            found.append(tj.equilibrium(mechanism, drives=[drive], loads=[load]))
        moved = np.stack([solution.displacement("B") for solution in found])
        reactions = np.stack([solution.reaction("B")[direction] for solution in found])
        port = tj.port_compliance(mechanism, "B", about=found[-1])
        stresses = [tj.stresses(mechanism, state).largest.max() for state in found]
        return moved, reactions, np.asarray(port.stiffness), np.array(stresses)

    moved, reactions, stiffness, stresses = solve(part.mechanism)
    fast_moved, fast_reactions, fast_stiffness, fast_stresses = solve(linkage_of(fast))
    assert_close(fast_stresses, stresses, rtol=1e-3)
    assert_close(fast_reactions, reactions, atol=1e-3 * np.max(np.abs(reactions)))
    scale = np.max(np.abs(moved), axis=0)
    scale[0] = fast.rotation  # A guide hardly rotates without a moment.
    assert_close(fast_moved / scale, moved / scale, atol=1e-3)
    units = np.sqrt(np.diag(stiffness))
    scaled = (fast_stiffness - stiffness) / np.outer(units, units)
    assert_close(scaled, np.zeros((3, 3)), atol=1e-3)
    assert isinstance(fast.energy, tj.energies.OneFreedomEnergy)
    assert len(fast.energy.powers) <= 52  # the symmetries have been found


@pytest.mark.release
def test_the_derivative_of_a_surrogate_by_the_geometry_agrees_with_differences():
    pose = jnp.array([0.25, 1.4e-4, 1.8e-5])

    @jax.jit
    def wrench(thickness):
        leaf = tj.flexures.leaf(STEEL, length=LENGTH, thickness=thickness, width=10e-3)
        pivot = tj.flexures.cross_spring_pivot(BEAM, leaf)
        fast = tj.surrogate(pivot, rotation=0.3, force=20.0, order=6)
        return fast.energy.wrench(pose)

    step = 1e-7
    slope = (wrench(THICKNESS + step) - wrench(THICKNESS - step)) / (2 * step)
    assert_close(jax.jacfwd(wrench)(THICKNESS), slope, rtol=1e-4)


class TestRange:
    @pytest.mark.slow
    def test_a_displacement_outside_the_range_is_reported(self):
        guide = FLEXURES["parallelogram"][0](RANGED_LEAF)
        fast = tj.surrogate(guide, displacement=1e-3, force=20.0)
        with pytest.raises(ValueError, match=r"transverse displacement 0\.0015 m"):
            fast(jnp.array([0.0, -1e-4, 1.5e-3]))

    def test_a_hinge_outside_its_range_is_reported(self):
        pivot = FLEXURES["cross-spring"][0](RANGED_LEAF)
        with pytest.raises(ValueError, match="of the loads a hinge is outside"):
            tj.surrogate(pivot, rotation=0.55, force=20.0)

    @pytest.mark.parametrize("name", ["cross-spring", "cartwheel"])
    @pytest.mark.release
    def test_leaves_outside_their_range_are_reported_of_an_exact_energy(self, name):
        """With and without inner bodies; the leaves of a cartwheel rotate by half."""
        leaf = tj.energies.WithValidityRange(
            QUADRATIC_LEAF, rotation=0.1, force=1e9, error=[1e-3, 1e-3, 1e-3]
        )
        mechanism = linkage_of(Condensed(FLEXURES[name][0](leaf)))
        solve = jax.jit(
            lambda angle: tj.equilibrium(
                mechanism, drives=[tj.Drive("B", angle=angle)], throw=False
            )
        )
        limit = 0.1 if name == "cross-spring" else 0.2
        inside, outside = solve(0.99 * limit), solve(1.01 * limit)
        assert tj.result_names(inside.result) == "successful"
        assert tj.result_names(outside.result) == "out_of_range"
        with pytest.raises(ValueError, match="The hinge 'leaf 1': its rotation"):
            Condensed(FLEXURES[name][0](leaf))(jnp.array([1.01 * limit, 0.0, 0.0]))

    @pytest.mark.slow
    def test_the_shares_of_linear_leaves_are_those_in_the_whole_mechanism(self):
        """The leaves of a cartwheel rotate by half."""
        leaf = tj.flexures.linear_leaf(
            STEEL, length=LENGTH, thickness=THICKNESS, width=10e-3
        )
        part = FLEXURES["cartwheel"][0](leaf)
        drives = [tj.Drive("B", angle=0.05)]
        whole = tj.equilibrium(part.mechanism, drives=drives).range_shares
        condensed = tj.equilibrium(linkage_of(Condensed(part)), drives=drives)
        assert whole is not None and condensed.range_shares is not None
        assert_close(condensed.range_shares, [np.max(whole)], rtol=1e-6)

    def test_the_force_follows_from_the_ranges_in_it(self):
        """Within it, the moment of the pivot is that of its leaves in equilibrium."""
        pivot = FLEXURES["cross-spring"][0](RANGED_LEAF)
        fast = tj.surrogate(pivot, rotation=0.2)
        assert_close(fast.force, RANGED_LEAF.force / 2)
        load, drive = tj.Load("B", force=(20.0, 10.0)), tj.Drive("B", angle=0.15)
        whole = tj.equilibrium(pivot.mechanism, loads=[load], drives=[drive])
        wrench = fast.wrench(whole.displacement("B"))
        assert_close(wrench[0], whole.reaction("B")[0], rtol=1e-3)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({}, "Give either `rotation`"),
            ({"rotation": 0.1, "displacement": 1e-3}, "both are given"),
            ({"rotation": 0.1}, "`force` is not given"),
        ],
    )
    def test_ranges_that_are_incomplete(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            tj.surrogate(guide_of_quadratic_leaves(), **arguments)

    @pytest.mark.parametrize(
        ("name", "arguments", "message"),
        [
            ("parallelogram", {"rotation": 0.1}, "along axis 2: give `displacement`"),
            pytest.param(
                "cross-spring",
                {"displacement": 1e-3},
                "along axis 2: give `rotation`",
                marks=pytest.mark.slow,
            ),
        ],
    )
    def test_the_other_direction_is_the_compliant_one(self, name, arguments, message):
        with pytest.raises(ValueError, match=message):
            tj.surrogate(FLEXURES[name][0](RANGED_LEAF), **arguments)

    @pytest.mark.untyped
    def test_other_flexures(self):
        with pytest.raises(ValueError, match=r"must be a `flexures\.Beam`"):
            tj.surrogate(STEEL, rotation=0.1)  # pyright: ignore[reportArgumentType]


class TestErrors:
    def parts(self, **changes):
        energy = tj.flexures.leaf(STEEL, length=LENGTH, thickness=THICKNESS, width=0.01)
        hinge = tj.Hinge("leaf", "A", "B", energy, at=(0, 0, 0), **changes)
        return [tj.Body("A"), tj.Body("B")], [hinge]

    @pytest.mark.parametrize(
        ("fixed", "second", "message"),
        [
            ([], "B", "no body"),
            (["A", "B"], "B", "'A', 'B'"),
            ({"A": ["angle", "x", "y"], "B": ["x"]}, "B", "1 other coordinates"),
            (["A"], "A", "is the fixed body"),
            (["A"], "C", "`second`"),
        ],
    )
    def test_bodies(self, fixed, second, message):
        with pytest.raises(ValueError, match=message):
            tj.SubMechanism(tj.Mechanism(*self.parts(), fixed=fixed), second)

    def test_misfits(self):
        mechanism = tj.Mechanism(*self.parts(misfit=(0.01, 0, 0)), fixed=["A"])
        with pytest.raises(ValueError, match="has a misfit"):
            tj.SubMechanism(mechanism, "B")

    @pytest.mark.parametrize(
        ("build", "message"),
        [
            (
                lambda leaf: tj.flexures.cross_spring_pivot(BEAM, leaf, angle=4.0),
                "`angle`",
            ),
            (
                lambda leaf: tj.flexures.cross_spring_pivot(BEAM, leaf, crossing=2),
                "crossing",
            ),
            (lambda leaf: tj.flexures.cartwheel_pivot(BEAM, leaf, hub=-1e-3), "`hub`"),
            (
                lambda leaf: tj.flexures.butterfly_pivot(BEAM, leaf, radius=0.0),
                "`radius`",
            ),
            (
                lambda leaf: tj.flexures.parallelogram(BEAM, leaf, spacing=0.0),
                "`spacing`",
            ),
            (
                lambda leaf: tj.flexures.double_parallelogram(
                    BEAM, leaf, outer_spacing=0.01, inner_spacing=0.02
                ),
                "below 1",
            ),
        ],
    )
    def test_dimensions_of_ready_made_flexures(self, build, message):
        with pytest.raises(ValueError, match=message):
            build(QUADRATIC_LEAF)

    @pytest.mark.untyped
    def test_a_beam_that_is_not_an_energy(self):
        with pytest.raises(ValueError, match="must be an energy, such as"):
            tj.flexures.parallelogram(BEAM, BEAM, spacing=0.01)  # pyright: ignore[reportArgumentType]

    def test_curved_leaves(self):
        arc = tj.flexures.Beam(
            STEEL, length=LENGTH, thickness=THICKNESS, width=0.01, curvature=1.0
        )
        with pytest.raises(ValueError, match="is curved"):
            tj.flexures.cross_spring_pivot(arc, QUADRATIC_LEAF)


def test_files_keep_condensed_hinges_and_their_outlines(tmp_path):
    pivot = FLEXURES["cross-spring"][0](RANGED_LEAF)
    fast = tj.surrogate(pivot, rotation=0.3, force=20.0)
    hinges = [
        tj.Hinge("exact", "1", "2", Condensed(pivot), at=(0, 0, 0), outline=pivot),
        tj.Hinge("fast", "2", "3", fast, at=(0, 0.05, 0), outline=pivot),
    ]
    bodies = [tj.Body("1"), tj.Body("2"), tj.Body("3")]
    path = tmp_path / "pivots.json"
    tj.io.save_mechanism(tj.Mechanism(bodies, hinges, fixed=["1"]), path)
    loaded = tj.io.load_mechanism(path)
    pose = jnp.array([0.2, 0.0, 0.0])
    for name, energy in (("exact", Condensed(pivot)), ("fast", fast.energy)):
        row = loaded.hinge_names.index(name)
        found = loaded.hinge_assembly.energy_of(row)
        found = getattr(found, "energy", found)
        assert_close(found(pose), energy(pose), rtol=0)
    (first, _) = loaded.hinge_outlines
    assert isinstance(first, tj.SubMechanism)
    assert repr(first) == repr(pivot)
    assert_close(first.mechanism.at, pivot.mechanism.at, rtol=0)


def test_a_drawing_shows_the_leaves_of_a_condensed_hinge():
    pivot = FLEXURES["cartwheel"][0](QUADRATIC_LEAF)
    at = np.array([0.3, 0.01, 0.02])
    hinge = tj.Hinge("pivot", "1", "2", Condensed(pivot), at=at, outline=pivot)
    mechanism = tj.Mechanism([tj.Body("1"), tj.Body("2")], [hinge], fixed=["1"])
    drawn = shapes(mechanism, np.asarray(mechanism.reference))
    assert [shape.kind for shape in drawn].count("hinge") == 4
    (hub,) = [shape for shape in drawn if shape.kind == "body"]
    assert_close(np.mean(hub.corners, axis=0), at[1:], atol=1e-12)
    # By symmetry, the hub rotates by half of a rotation about its center.
    x, y = at[1:] - np.asarray(se2.rotate(jnp.array(0.2), jnp.array(at[1:])))
    drawn = shapes(mechanism, np.array([[0.0, 0.0, 0.0], [0.2, x, y]]))
    (turned,) = [shape for shape in drawn if shape.kind == "body"]
    edge, before = (np.diff(part.corners[:2], axis=0)[0] for part in (turned, hub))
    angle = np.arctan2(before[0] * edge[1] - before[1] * edge[0], before @ edge)
    assert_close(angle, 0.1, rtol=1e-3)
