"""Equilibrium paths: von Mises truss, column of rigid links, and tables."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import assert_close, one_slow, value_and_slopes, with_value
from path_helpers import (
    bar,
    BAR_STIFFNESS,
    bars_of_a_truss,
    column,
    column_load,
    parallel_links,
    truss_and_link,
    truss_of,
    unconnected_trusses,
    von_mises_force,
    von_mises_limit_force,
    von_mises_limit_height,
)

import twistorjax as tj
from twistorjax.examples.truss import von_mises_truss
from twistorjax.plotting.shapes import shapes
from twistorjax.solve.continuation import setup as path_setup


PUSH = tj.Load("apex", force=(0.0, -20.0))


def truss(rise=0.3, **stiffness):
    """Truss of von Mises; all of them share programs, also those with unequal bars."""
    return truss_of(bars_of_a_truss(rise=rise, **stiffness), rise)


def forces_of_bars(x, y, rise=0.3):
    """Force of both bars on the apex at a position."""
    total = np.zeros(2)
    for support in (-1.0, 1.0):
        bar = np.array([x - support, y])
        total += BAR_STIFFNESS * (np.hypot(1.0, rise) / np.hypot(*bar) - 1) * bar
    return total


def height_above(level, point):
    return point.pose("apex")[2] - level


def pushed(rise=0.3, size=20.0, until=-10.0, **arguments):
    """Follow the path under a force, at most until the apex is at a height; N, m."""
    level = jax.tree_util.Partial(height_above, jax.device_put(until))
    load = tj.Load("apex", force=(0.0, -size))
    return tj.path(truss(rise), loads=[load], until=level, **arguments)


@pytest.fixture(scope="module")
def snap():
    return pushed()


class TestVonMisesTruss:
    def test_all_points_are_on_the_closed_form(self, snap):
        height = 0.3 + np.asarray(snap.displacement("apex"))[:, 2]
        factors = np.asarray(snap.load_factors)
        assert_close(20 * factors, von_mises_force(height), digits=9)
        assert np.min(height) < -0.35 and factors[0] == 0.0
        assert_close(factors[-1], 1.0)
        assert str(tj.result_names(snap.result)) == "successful"

    def test_both_limit_points(self, snap, validated):
        points = snap.critical_points
        assert [point.kind for point in points] == ["limit", "limit"]
        force, height = von_mises_limit_force(), von_mises_limit_height()
        factors = 20 * np.asarray(points.load_factors)
        assert_close(factors, np.array([force, -force]), digits=10)
        what, oracle = "force at which the truss of von Mises snaps", "the closed form"
        validated("Equilibrium paths", what, factors[0], force, oracle)
        for sign, point in zip((1, -1), points, strict=True):
            assert_close(np.asarray(point.pose("apex"))[2], sign * height, digits=10)
            # Only the height changes; the unit is the characteristic length.
            mode = np.asarray(point.mode)[1]
            assert_close(np.abs(mode), np.array([0.0, 0.0, 1.0]))

    def test_equilibria_between_the_limit_points_are_unstable(self, snap):
        height = np.abs(0.3 + np.asarray(snap.displacement("apex"))[:, 2])
        np.testing.assert_array_equal(snap.stable, height > von_mises_limit_height())

    def test_energy_is_that_of_both_bars(self, snap):
        height = 0.3 + np.asarray(snap.displacement("apex"))[:, 2]
        stretch = np.hypot(1.0, height) - np.hypot(1.0, 0.3)
        assert_close(snap.energies, BAR_STIFFNESS * stretch**2, digits=10)

    def test_the_animation_goes_through_the_points(self, snap):
        animation = tj.animate(truss(), snap)
        draw_frame = animation._func  # pyright: ignore[reportAttributeAccessIssue]
        collections = draw_frame(len(snap.load_factors) - 1)
        animation._draw_was_started = True  # pyright: ignore[reportAttributeAccessIssue]
        assert collections[0].axes.get_title() == "load factor 1.000"

    def test_bars_are_drawn_from_the_supports_to_the_apex(self, snap):
        drawn = shapes(truss(), np.asarray(snap.poses[20]))
        left, right = (each.corners for each in drawn if each.kind == "spring")
        apex = np.asarray(snap.pose("apex"))[20, 1:]
        assert_close(left[[0, -1]], np.stack([[-1.0, 0.0], apex]), digits=12)
        assert_close(right[[0, -1]], np.stack([apex, [1.0, 0.0]]), digits=12)

    def test_the_figure_shows_the_closed_form(self, snap):
        figure = tj.plotting.draw_path(snap, "apex", "y", load=20.0)
        stable, unstable, limits = figure.axes[0].get_lines()
        for line in (stable, unstable, limits):
            down, force = np.asarray(line.get_xydata()).T  # mm, N
            known = np.isfinite(force)
            height = 0.3 + 1e-3 * down[known]
            np.testing.assert_allclose(force[known], von_mises_force(height), rtol=1e-7)
        height = np.abs(0.3 + 1e-3 * np.asarray(unstable.get_xdata()))
        assert np.nanmax(height) < von_mises_limit_height() + 1e-9

    def test_reactions_balance_the_load(self, snap):
        assert_close(
            np.asarray(snap.reaction("wall"))[:, 1:],
            np.outer(snap.load_factors, [0.0, 20.0]),
            digits=9,
        )

    @staticmethod
    def lowered(sideways):
        """Lower the apex, on which a constant force acts sideways; N."""
        return tj.path(
            truss(), drives=[tj.Drive("apex", y=-0.7)], load_factors=(0, 1),
            constant_loads=[tj.Load("apex", force=(sideways, 0.0))],
        )  # fmt: skip

    def test_a_path_of_prescribed_displacements_has_the_same_force(self):
        lowered = self.lowered(0.0)
        height = 0.3 - 0.7 * np.asarray(lowered.load_factors)
        reaction = np.asarray(lowered.reaction("apex"))[:, 2]
        assert_close(reaction, -von_mises_force(height), digits=9)
        assert len(lowered.critical_points) == 0 and np.asarray(lowered.stable).all()

    def test_prescribed_displacements_beside_constant_loads(self):
        """The constant force moves the apex sideways, and changes the reaction."""
        found = self.lowered(50.0)
        down = np.asarray(found.displacement("apex"))[:, 2]
        assert_close(down, -0.7 * np.asarray(found.load_factors))
        places = np.asarray(found.pose("apex"))[:, 1:]
        exact = np.array([forces_of_bars(*place) for place in places])
        assert_close(exact[:, 0], np.full(len(places), -50.0), digits=9)
        reaction = np.asarray(found.reaction("apex"))[:, 2]
        assert_close(reaction, -exact[:, 1], digits=9)

    def test_the_path_ends_where_a_function_changes_its_sign(self):
        flat = pushed(until=0.0, largest_step=0.05)
        assert str(tj.result_names(flat.result)) == "event_occurred"
        assert_close(np.asarray(flat.pose("apex"))[-1, 2], 0.0)
        assert_close(np.asarray(flat.load_factors)[-1], 0.0)
        assert len(flat.critical_points) == 1

    @pytest.mark.slow
    def test_derivatives_of_the_end_by_its_condition_and_by_the_interval(self):
        """The end is where the height, or the load factor, is given."""

        def end(at):
            level, limit = at
            above = jax.tree_util.Partial(height_above, level)
            load = tj.Load("apex", force=(0.0, -20.0))

            def last(until, limits):
                found = tj.path(
                    truss(), loads=[load], until=until, load_factors=limits,
                    largest_step=0.2, max_points=32, max_critical=1, throw=False,
                )  # fmt: skip
                row = found.count - 1
                height = found.pose("apex")[row, 2]
                return found.load_factors[row], height

            return *last(above, (-1.0, 1.0)), *last(None, (-1.0, limit))

        at = jnp.array([0.25, 0.3])
        slopes, (force, _, limit, height) = jax.jacfwd(with_value(end), has_aux=True)(at)
        by_height = jax.grad(von_mises_force)
        assert_close(slopes[0], np.array([by_height(0.25) / 20, 0.0]), digits=8)
        assert_close(slopes[1], np.array([1.0, 0.0]), digits=8)
        assert_close(slopes[2], np.array([0.0, 1.0]), digits=8)
        assert_close(slopes[3], np.array([0.0, 20 / by_height(float(height))]), digits=8)
        assert_close(20 * force, von_mises_force(0.25), digits=8)
        assert_close(limit, 0.3, digits=8)

    def test_a_path_in_the_other_direction(self):
        up = pushed(direction=-1, largest_step=0.025)
        height = 0.3 + np.asarray(up.displacement("apex"))[:, 2]
        factors = np.asarray(up.load_factors)
        assert_close(20 * factors, von_mises_force(height), digits=9)
        assert_close(factors[-1], -1.0)
        assert np.asarray(up.stable).all()

    def test_loads_that_are_too_large_by_a_factor_of_a_thousand(self):
        found = pushed(size=20e3, load_factors=(-1e-3, 1e-3), largest_step=0.03)
        force = von_mises_limit_force()
        factors = 20e3 * np.asarray(found.critical_points.load_factors)
        assert_close(factors, np.array([force, -force]), digits=8)

    @staticmethod
    def with_weight(weight, push=0.0, stroke=0.0):
        """Path of a truss with a weight, by a force or strokes of its bars; N, N, m."""
        stroke = (0.0, -stroke, 0.0)
        return tj.path(
            truss(),
            loads=[tj.Load("apex", force=(0.0, -push))],
            strokes={name: stroke for name in ("left", "right")},
            constant_loads=[tj.Load("apex", force=(0.0, -weight))],
        )

    @pytest.mark.parametrize("height", [0.3, -0.3])
    def test_a_path_begins_at_the_given_poses(self, height):
        """Both states are without forces; the poses of a start are those in the world."""
        start = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]])
        found = pushed(start=start)
        assert_close(np.asarray(found.poses)[0], start, digits=9)

    @pytest.mark.slow
    def test_a_path_from_an_equilibrium_under_constant_loads(self):
        found = self.with_weight(4.0, push=20.0)
        height = 0.3 + found.displacement("apex")[:, 2]
        assert_close(4 + 20 * found.load_factors, von_mises_force(height), digits=8)
        assert_close(found.load_factors[0], 0.0)
        first = scipy.optimize.brentq(lambda h: von_mises_force(h) - 4.0, 0.2, 0.3)
        assert_close(height[0], first, digits=9)

    def test_other_numbers_of_strokes_are_arguments_of_the_same_program(self):
        given = path_setup.changes_by_factor({"left": (0.0, -0.05, 0.0)})
        assert len(list(filter(eqx.is_array, jax.tree.leaves(given)))) == 3

    @pytest.mark.slow
    def test_strokes_that_move_the_ends_of_the_bars_apart(self):
        """A stroke of -d moves the ends of a bar on both bodies along it, by d / 2."""
        found = self.with_weight(2.0, stroke=0.05)
        length = np.hypot(1.0, 0.3)
        along = 1.0 + 0.05 * found.load_factors / length
        height = 0.3 + found.displacement("apex")[:, 2]
        height = height + 0.05 * 0.3 * found.load_factors / length
        stretched = np.hypot(along, height)
        force = -2 * BAR_STIFFNESS * (stretched - length) * height / stretched
        assert_close(force, 2.0 + 0 * force, digits=8)


class TestDerivatives:
    RISES = np.linspace(0.1, 0.35, 6)

    @staticmethod
    def limit_and_last_point(rise):
        """Force and height at the limit point, load factor and height at the end."""
        found = tj.path(von_mises_truss(rise), loads=[PUSH], max_points=100)
        point, row = found.critical_points[0], found.count - 1
        limit = [20 * point.load_factor, point.pose("apex")[2]]
        return jnp.stack([*limit, found.load_factors[row], found.poses[row, 1, 2]])

    def first_limit(self, rise):
        return self.limit_and_last_point(rise)[:2]

    @staticmethod
    def closed_form(rise):
        return jnp.stack([von_mises_limit_force(rise), von_mises_limit_height(rise)])

    @pytest.fixture(scope="class")
    @classmethod
    def batch(cls):
        """Both points of a batch of trusses, and their derivatives by the rise."""
        differentiate = partial(value_and_slopes, cls.limit_and_last_point)
        return jax.jit(jax.vmap(differentiate))(jnp.asarray(cls.RISES))

    @pytest.mark.slow
    def test_derivatives_of_a_limit_point(self, batch, validated):
        _, _, reverse = batch
        found = reverse[:, :2]
        exact = jax.vmap(jax.jacrev(self.closed_form))(self.RISES)
        assert_close(found, exact, digits=10)
        what = "derivatives of the snap force and its displacement by the rise"
        assert self.RISES[4] == pytest.approx(0.3)
        validated("Equilibrium paths", what, found[4], exact[4], "the closed form")

    @pytest.mark.release
    def test_first_and_second_derivatives_of_a_limit_point(self):
        exact = jax.jacfwd(self.closed_form)
        forward = jax.jit(jax.jacfwd(self.first_limit))
        assert_close(forward(0.3), exact(0.3), digits=10)
        second = jax.jit(jax.jacfwd(jax.jacrev(self.first_limit)))
        assert_close(second(0.3), jax.jacfwd(exact)(0.3), digits=9)

    @pytest.mark.slow
    def test_a_batch_of_trusses(self, batch):
        assert_close(batch[0][:, :2], jax.vmap(self.closed_form)(self.RISES), digits=9)

    @pytest.mark.slow
    def test_the_last_point_stays_at_its_load_factor(self, batch):
        def residual(height, rise):
            return von_mises_force(height, rise) - 20.0

        last, *by_mode = (each[:, 2:] for each in batch)
        slope = jax.vmap(jax.grad(residual, argnums=(0, 1)))
        by_height, by_rise = slope(last[:, 1], jnp.asarray(self.RISES))
        assert_close(last[:, 0], np.ones(6))
        assert_close(residual(last[:, 1], self.RISES), np.zeros(6), digits=9)
        for slopes in by_mode:
            assert_close(slopes[:, 0], np.zeros(6))
            assert_close(slopes[:, 1], -by_rise / by_height, digits=9)


class TestSteepTruss:
    """A truss that is higher than wide leaves its axis of symmetry before it snaps."""

    RISE, SIZE = 3.0, 2000.0

    def snap(self, **stiffness):
        push = [tj.Load("apex", force=(0.0, -self.SIZE))]
        return tj.path(truss(self.RISE, **stiffness), loads=push, largest_step=0.04)

    def test_both_branches_of_a_symmetric_mechanism(self):
        symmetric = self.snap()
        first = symmetric.critical_points[0]
        assert first.kind == "branch"
        # There the stiffness against a lateral force vanishes: l^3 = L (l^2 - 1).
        natural = np.hypot(1.0, self.RISE)
        length = np.max(np.roots([1.0, -natural, 0.0, natural]).real)
        height = np.sqrt(length**2 - 1)
        assert_close(first.pose("apex")[1:], np.array([0.0, height]), digits=9)
        load = forces_of_bars(0.0, height, self.RISE)[1]
        assert_close(self.SIZE * first.load_factor, load, digits=9)
        sides = [
            pushed(
                self.RISE, self.SIZE, 1.0, largest_step=0.05, start=first, direction=side
            )
            for side in (1, -1)
        ]
        for side, found in zip((1, -1), sides, strict=True):
            x, y = np.asarray(found.pose("apex"))[1:, 1:].T
            assert np.all(side * x > 0)
            places = zip(x, y, strict=True)
            exact = np.array([forces_of_bars(*place, self.RISE) for place in places])
            loads = self.SIZE * np.asarray(found.load_factors)[1:]
            expected = np.stack([0 * loads, loads], axis=1)
            np.testing.assert_allclose(exact, expected, atol=1e-6)
        assert_close(sides[0].energies[-1], sides[1].energies[-1], digits=9)

    @pytest.mark.parametrize("imperfection", [3e-6, 1e-9])
    def test_branch_points_of_a_nearly_symmetric_truss(self, imperfection):
        """Their loads are those of the mean stiffness, to first order."""
        exact = self.snap().critical_points
        found = self.snap(right=BAR_STIFFNESS * (1 + imperfection)).critical_points
        branches = np.asarray(exact.is_branch)
        np.testing.assert_array_equal(found.is_branch, branches)
        before, after = np.asarray(exact.load_factors), np.asarray(found.load_factors)
        expected = before[branches] * (1 + imperfection / 2)
        np.testing.assert_allclose(after[branches], expected, rtol=1e-8)


@pytest.mark.slow
class TestColumn:
    COUNT = 6

    @pytest.fixture(scope="class")
    @classmethod
    def straight(cls):
        return tj.path(
            column(), loads=[column_load()], load_factors=(0, 30), largest_step=0.3
        )

    def test_branch_points_are_the_buckling_loads(self, straight, validated):
        """Eigenvalues of inextensible links with small rotations."""
        count = self.COUNT
        springs = 2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
        springs[-1, -1] = 1.0
        exact = count * np.linalg.eigvalsh(springs)
        points = straight.critical_points
        assert np.asarray(points.is_branch).all()
        np.testing.assert_allclose(points.load_factors, exact, rtol=1e-8)
        what, oracle = "six buckling loads of a column of links", "an eigenvalue problem"
        validated("Equilibrium paths", what, points.load_factors, exact, oracle)
        np.testing.assert_array_equal(straight.negative_eigenvalues[-1], self.COUNT)

    @pytest.mark.parametrize("side", [1, -1])
    def test_the_buckled_column_is_followed_to_both_sides(self, straight, side):
        """Minimum of the energy of inextensible links; each spring has k (1 - cos)."""
        buckled = tj.path(
            column(),
            loads=[column_load()],
            start=straight.critical_points[0],
            direction=side,
            load_factors=(0, 0.8),
        )
        assert buckled.stable[1:].all()
        top = f"link {self.COUNT - 1}"
        assert side * float(buckled.displacement(top)[-1, 1]) > 0.3

        def energy(angles):
            bends = np.diff(angles, prepend=0.0)
            return np.sum(1 - np.cos(bends)) + 0.8 * np.mean(np.cos(angles))

        start = -side * np.linspace(0.1, 1.0, self.COUNT)
        angles = scipy.optimize.minimize(energy, start, tol=1e-12).x
        names = [f"link {k}" for k in range(self.COUNT)]
        found = np.array([buckled.displacement(name)[-1, 0] for name in names])
        np.testing.assert_allclose(found, angles, rtol=2e-4)


def repeated(points):
    """Return the load factors of critical points, each as often as it occurs."""
    return np.repeat(np.asarray(points.load_factors), np.asarray(points.multiplicities))


class TestEqualBucklingLoads:
    """Links that buckle independently, so that several eigenvalues vanish at once."""

    @staticmethod
    def straight(*loads):
        """Path of four links; those whose loads are not given do not buckle; N."""
        links, forces = parallel_links([*loads, *(4 - len(loads)) * [9.0]])
        return links, {"loads": forces, "load_factors": (0.0, 2.0)}

    @pytest.mark.parametrize(
        "loads",
        [
            (1.0, 1.0),
            (1.0, 1.0 + 1e-9),
            (1.0, 1.0003),
            (1.0, 1.03),
            (1.0, 1.001, 1.002),
            (1.0, 1.0, 1.5),
            (1.0, 1.0, 1.0, 1.0),
        ],
    )
    def test_all_buckling_loads_are_found(self, loads):
        links, arguments = self.straight(*loads)
        found = tj.path(links, **arguments)
        points = found.critical_points
        assert np.asarray(points.is_branch).all()
        np.testing.assert_allclose(repeated(points), loads, rtol=1e-8)
        below = np.searchsorted(loads, np.asarray(found.load_factors))
        np.testing.assert_array_equal(found.negative_eigenvalues, below)

    @pytest.mark.parametrize(
        "loads", one_slow([(1.1, 1.102, 1.101), (1.0, 1.0, 9.0), (1.1, 1.12, 1.11)])
    )
    def test_eigenvalues_that_cross_each_other(self, loads):
        """Under other forces, they decrease at other rates."""
        links, forces = parallel_links(loads, forces=(2.0, 1.0, 3.0))
        points = tj.path(links, loads=forces, load_factors=(0.0, 2.0)).critical_points
        expected = sorted(load for load in loads if load < 2)
        np.testing.assert_allclose(repeated(points), expected, rtol=1e-8)

    @pytest.mark.parametrize("regained", one_slow([1.01, 0.98]))
    def test_a_link_that_becomes_stable_while_another_buckles(self, regained):
        """The number of unstable links is the same before and behind both points.

        A stiff bar pulls the upper end of each link down. With the force P and the length
        l of the bar, whose foot is at the depth d below that of the link, the stiffness
        against the rotation of the link is `1 - P d / l`.
        """
        depth, stiffness = 3.0, 1e7
        length = depth + 1.0
        critical = length / depth

        def force(factor):
            """Let the first link buckle at 1, the second one from 0.3 to `regained`."""
            inside = (factor - 0.3) * (regained - factor)
            rises = 1 + 0.8 * inside / (0.3 * regained)
            return critical * jnp.stack([factor, rises])

        bodies = [tj.Body("base"), *(tj.Body(f"link {k}", (0.0, k, 0.0)) for k in (0, 1))]
        springs = tj.Quadratic(np.diag([1.0, 1.0, 1.0]))
        hinges = [
            tj.Hinge(f"{k}", "base", f"link {k}", springs, (np.pi / 2, k, 0.0))
            for k in (0, 1)
        ]
        for k in (0, 1):
            foot, end = np.array([k, -depth]), np.array([k, 1.0])
            hinges.append(bar(f"bar {k}", "base", f"link {k}", foot, end, stiffness))
        fixed = {"base": ["angle", "x", "y"], "link 0": ["x", "y"], "link 1": ["x", "y"]}

        def strokes(factor):
            extensions = -force(factor) / stiffness
            return {f"bar {k}": jnp.stack([0.0, extensions[k], 0.0]) for k in (0, 1)}

        mechanism = tj.Mechanism(bodies, hinges, fixed=fixed)
        found = tj.path(mechanism, strokes=strokes, load_factors=(0.0, 2.0))
        expected = sorted([0.3, 1.0, regained])
        assert_close(found.critical_points.load_factors, expected, digits=6)

    @pytest.mark.parametrize("loads", one_slow([(1.0, 1.03, 5.0), (1.0, 5.0, 5.0)]))
    def test_follower_loads_on_a_link_that_does_not_buckle(self, loads):
        links, forces = parallel_links(loads)
        follower = tj.Load("link 2", force=(0.1, 0.0), at=(0.0, 0.5), follower=True)
        found = tj.path(
            links, loads=forces, constant_loads=[follower], load_factors=(0.0, 2.0)
        )
        expected = [load for load in loads if load < 2]
        assert_close(found.critical_points.load_factors, expected, digits=8)

    @pytest.mark.parametrize("turns", [(1, 0), (0, -1), (1, -1)])
    def test_branches_of_a_double_branch_point(self, turns, validated, pictured):
        """A link of the buckling load 1 is at the angle a where the factor is a / sin a.

        Either link buckles, or both of them.
        """
        links, arguments = self.straight(1.0, 1.0, 1.5)
        (first, _) = tj.path(links, **arguments).critical_points
        assert int(np.asarray(first.multiplicity)) == 2 and "branch, 2-fold" in repr(
            first
        )
        direction = {f"link {k}": (turn, 0.0, 0.0) for k, turn in enumerate(turns)}
        branch = tj.path(links, **arguments, start=first, direction=direction)
        angles = np.asarray(branch.displacements)[1:, 1:3, 0]
        np.testing.assert_array_equal(np.sign(angles), np.tile(turns, (len(angles), 1)))
        expected = angles / np.sinc(angles / np.pi)
        factors = np.asarray(branch.load_factors)[1:, None]
        np.testing.assert_allclose(factors * angles, expected, atol=1e-9)
        name = f"branch {turns} of a double branch point"
        validated(
            "Equilibrium paths", name, factors * angles, expected, "the closed form"
        )
        turned = angles[:, np.argmax(np.abs(turns))]
        exact = np.linspace(0.2, 1.0, 6) * turned[-1]
        which = {(1, 0): "the first turns", (0, -1): "the second turns"}
        pictured(
            "Equilibrium paths",
            "double-branch-point",
            "Two links that buckle at the same load: either of them turns, or both do.",
            ("angle (rad)", "load over the buckling load"),
            {which.get(turns, "both turn (dashed)"): (turned, factors)},
            {"closed form": (exact, exact / np.sin(exact))},
        )

    def test_a_direction_that_is_no_branch(self):
        links, arguments = self.straight(1.0, 1.0, 1.5)
        (first, _) = tj.path(links, **arguments).critical_points
        with pytest.raises(ValueError, match="no mode in which they move"):
            tj.path(
                links, **arguments, start=first, direction={"link 2": (1.0, 0.0, 0.0)}
            )
        with pytest.raises(ValueError, match="`start` is no branch point"):
            tj.path(links, **arguments, direction={"link 2": (1.0, 0.0, 0.0)})

    @pytest.mark.release
    def test_derivatives_by_a_common_stiffness(self):
        def factors(stiffness):
            scale = jnp.array([1.0, 1.0, 1.5, 9.0])
            links, arguments = self.straight(*(stiffness * scale))
            return tj.path(links, max_points=40, **arguments).critical_points.load_factors

        slopes = jax.jit(jax.jacrev(factors))(1.0)
        assert_close(slopes[:2], np.array([1.0, 1.5]), digits=9)


@pytest.mark.release
def test_both_columns_of_a_table_buckle():
    """Two links of length a with a spring k between them buckle at 2 k / a."""
    stiff, side = tj.Quadratic(np.diag([0.0, 1e7, 1e7])), np.pi / 2
    middle = tj.Quadratic(np.diag([0.5, 1e7, 1e7]))
    bodies, hinges = [tj.Body("base"), tj.Body("table", pose=(0.0, 0.0, 2.0))], []
    for x in (-1.0, 1.0):
        lower, upper = f"lower {x}", f"upper {x}"
        bodies += [tj.Body(lower, pose=(0.0, x, 0.5)), tj.Body(upper, pose=(0, x, 1.5))]
        ends, springs = ("base", lower, upper, "table"), (stiff, middle, stiff)
        hinges += [
            tj.Hinge(f"{x} {k}", ends[k], ends[k + 1], springs[k], at=(side, x, float(k)))
            for k in range(3)
        ]
    fixed = {"base": ["angle", "x", "y"], "table": ["angle", "x"]}
    table = tj.Mechanism(bodies, hinges, fixed=fixed)
    press = [tj.Load("table", force=(0.0, -2.0))]
    (point,) = tj.path(table, loads=press, load_factors=(0.0, 1.3)).critical_points
    assert point.kind == "branch" and int(np.asarray(point.multiplicity)) == 2
    np.testing.assert_allclose(point.load_factor, 1.0, rtol=1e-6)


@pytest.mark.slow
def test_a_truss_whose_apex_is_driven_has_a_path_without_free_coordinates():
    truss = truss_of(bars_of_a_truss(), apex=("angle", "x"))
    driven = [tj.Drive("apex", y=-0.65)]
    found = tj.path(truss, drives=driven, load_factors=(0.0, 1.0))
    heights = 0.3 - 0.65 * np.asarray(found.load_factors)
    reaction = np.asarray(found.reaction("apex"))[:, 2]
    assert_close(-reaction, von_mises_force(heights), digits=9)


class TestLimitPoints:
    @pytest.mark.parametrize(
        "rises", one_slow([(0.3, 0.44, 0.17), (0.3, 0.3), (0.3, 0.2)])
    )
    def test_trusses_snap_at_a_multiple_limit_point(self, rises):
        trusses, loads = unconnected_trusses(*rises)
        points = tj.path(trusses, loads=loads).critical_points
        assert [point.kind for point in points] == ["limit", "limit"]
        np.testing.assert_array_equal(points.multiplicities, 2 * [len(rises)])
        force = von_mises_limit_force() / 20
        assert_close(points.load_factors, np.array([force, -force]), digits=9)

    @pytest.mark.parametrize("share", one_slow([0.999, 0.9999]))
    def test_a_link_that_buckles_close_to_the_limit_point_of_a_truss(self, share):
        """It becomes stable again on the way back, and buckles once more at the end."""
        force = float(von_mises_limit_force())
        mechanism, loads = truss_and_link(share / 2, 2 * force)
        found = tj.path(mechanism, loads=loads)
        points, link = found.critical_points, share / 2
        kinds = ["branch", "limit", "branch", "limit", "branch"]
        assert [point.kind for point in points] == kinds
        assert_close(points.load_factors, [link, 0.5, link, -0.5, link], digits=8)

    @pytest.mark.parametrize("largest_step", one_slow([0.3, 0.1]))
    def test_limit_points_that_are_closer_than_a_step(self, largest_step):
        """A spring below the apex makes the truss almost monostable."""
        stiffness, size = 87.0, 60.0
        foot, apex = np.array([0.0, -1e3]), np.array([0.0, 0.3])
        spring = bar("spring", "wall", "apex", foot, apex, stiffness)
        supported = truss_of([*bars_of_a_truss(), spring])
        push = [tj.Load("apex", force=(0.0, -size))]
        found = tj.path(supported, loads=push, largest_step=largest_step)

        def force(height):
            return von_mises_force(height) + stiffness * (0.3 - height)

        heights = [
            scipy.optimize.brentq(jax.grad(force), *ends, xtol=1e-13)
            for ends in ((0.0, 0.3), (-0.3, 0.0))
        ]
        exact = np.array([force(height) / size for height in heights])
        assert 0 < exact[0] - exact[1] < 1e-3
        assert_close(found.critical_points.load_factors, exact, digits=9)
        assert int(np.sum(~np.asarray(found.stable))) > 0


@pytest.mark.slow
def test_follower_load_on_a_single_link_has_no_limit_point():
    """The moment of a follower force about the spring does not depend on the rotation."""
    load = tj.Load("link 0", force=(0.1, 0.0), at=(0.0, 0.5), follower=True)
    found = tj.path(column(1), loads=[load], load_factors=(-1, 5))
    angle = np.asarray(found.displacement("link 0")[:, 0])
    # The energy of the twistor has the moment k sin(angle).
    np.testing.assert_allclose(np.sin(angle), -0.1 * found.load_factors, rtol=1e-5)
    assert len(found.critical_points) == 0
    assert set(np.asarray(found.negative_eigenvalues)) == {0}


@pytest.mark.release
def test_pins_instead_of_stiff_hinges():
    """A link on a pin with a rotational spring, pulled by a force on its end."""
    spring = tj.Quadratic(np.diag([1.0, 0.0, 0.0]), coordinates="twist")
    mechanism = tj.Mechanism(
        [tj.Body("base"), tj.Body("link", pose=(0.0, 0.0, 0.5))],
        [tj.Hinge("spring", "base", "link", spring, at=(0.0, 0.0, 0.0))],
        fixed=["base"],
    )
    pin = tj.Pin("pin", "base", "link", at=(0.0, 0.0))
    load = tj.Load("link", force=(-0.1, -2.0), at=(0.0, 0.5))
    found = tj.path(mechanism, loads=[load], constraints=[pin])
    angle = np.asarray(found.displacement("link")[:, 0])
    moment = found.load_factors * (0.1 * np.cos(angle) + 2.0 * np.sin(angle))
    assert_close(moment, angle, digits=8)
    assert_close(found.constraint_force("pin")[-1], np.array([0.1, 2.0]), digits=8)
    assert found.stable.all()


def test_a_path_is_printed_and_converted_to_a_table(snap):
    lines = repr(snap).splitlines()
    assert lines[0].startswith("successful: ") and "load factor 0 to 1" in lines[0]
    assert lines[2].split() == ["limit", "0.49749585", "y", "of", "'apex'"]
    table = snap.to_xarray()
    assert table.load_factor.dims == ("point",) and table.y.attrs["units"] == "m"
    np.testing.assert_array_equal(table.energy, snap.energies)
