"""Bistable states, linearized buckling, and messages at critical points."""

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, mostly_slow, with_value
from path_helpers import (
    bar,
    BAR_STIFFNESS,
    bars_of_a_truss,
    column,
    column_load,
    parallel_links,
    truss_and_link,
    truss_of,
    von_mises_force,
    von_mises_limit_force,
    von_mises_limit_height,
)
from scipy.optimize import brentq

import twistorjax as tj
from twistorjax.examples.stage import microstage
from twistorjax.examples.truss import von_mises_truss


PUSH = tj.Load("apex", force=(0.0, -20.0))
REVERSE = pytest.param(jax.jacrev, marks=pytest.mark.release)


def supported_truss(rise=0.3, spring=1e-12, foot=(0.0, -10.0)):
    """Truss with a spring from a foot to its apex, by default without any effect; N/m."""
    below = bar("spring", "wall", "apex", np.array(foot), np.array([0.0, rise]), spring)
    return truss_of([*bars_of_a_truss(rise=rise), below], rise)


def switch(truss=None, load=PUSH, lift=0.0, **arguments):
    """Bistability of a truss, on whose apex a constant force may act upward; N."""
    truss = supported_truss() if truss is None else truss
    constant = [tj.Load("apex", force=(0.0, lift))]
    return tj.bistability(
        truss, loads=[load], constant_loads=constant, max_points=150, **arguments
    )


def branch_point_of_a_steep_truss(rise):
    """Force at which the stiffness against a lateral force vanishes; N."""
    natural = np.hypot(1.0, rise)
    length = np.max(np.roots([1.0, -natural, 0.0, natural]).real)
    return float(von_mises_force(np.sqrt(length**2 - 1), rise))


def barrier(rise):
    """Both bars are shortened to the length 1, in the middle between both states."""
    return BAR_STIFFNESS * (jnp.hypot(1.0, rise) - 1) ** 2


class TestBistability:
    def test_states_of_the_von_mises_truss(self):
        found = switch()
        assert bool(found.is_bistable)
        assert_close(found.travel("apex"), np.array([0.0, 0.0, -0.6]), digits=9)
        assert_close(found.barriers, np.full(2, barrier(0.3)), digits=9)
        force = von_mises_limit_force() / 20
        assert_close(found.snap_factors, np.array([force, -force]), digits=9)
        lines = repr(found).splitlines()
        assert lines[0] == "bistable" and "1.9387 J" in lines[2]
        assert_close(found.pose("apex")[2], np.array([0.0, 0.0, -0.3]), digits=9)
        truss = supported_truss()
        second = tj.equilibrium(truss, start=found.poses[2])
        assert_close(second.displacements, found.displacements[2], digits=9)

    def test_a_weight_makes_the_first_barrier_smaller(self):
        """Snap forces shift by the weight, and the energies include its work."""
        found = switch(lift=-2.0)
        plain = float(von_mises_limit_force())
        exact = np.array([plain - 2.0, -plain - 2.0]) / 20
        assert_close(found.snap_factors, exact, digits=9)
        intervals = ((0.2, 0.3), (-0.1, 0.1), (-0.4, -0.3))
        heights = np.array(
            [brentq(lambda h: von_mises_force(h) - 2.0, *ends) for ends in intervals]
        )
        stretch = np.hypot(1.0, heights) - np.hypot(1.0, 0.3)
        energies = BAR_STIFFNESS * stretch**2 + 2.0 * (heights - 0.3)
        assert_close(found.energies, energies, digits=9)
        assert_close(found.travel("apex")[2], heights[2] - heights[0], digits=9)

    def test_a_weight_on_a_lever_does_work_as_the_lever_turns(self):
        """A spring is too weak to hold a lever with a weight upright."""
        weight, length, stiffness = 1.2, 0.5, 0.5  # N, m, N m/rad
        spring = tj.Quadratic(np.diag([stiffness, 1.0, 1.0]), "twist")
        lever = tj.Mechanism(
            [tj.Body("wall"), tj.Body("lever")],
            [tj.Hinge("spring", "wall", "lever", spring, at=(0, 0, 0))],
            fixed=["wall"],
        )

        def moment(angle):
            return stiffness * angle - weight * length * np.sin(angle)

        angle = brentq(moment, 0.5, 2.0)
        found = tj.bistability(
            lever,
            loads=[tj.Load("lever", moment=0.2)],
            constant_loads=[tj.Load("lever", force=(0, -weight), at=(0, length))],
            constraints=[tj.Pin("pivot", "wall", "lever", at=(0.0, 0.0))],
            start=np.array([[0.0, 0.0, 0.0], [-angle, 0.0, 0.0]]),
        )
        exact = weight * length * (1 - np.cos(angle)) - stiffness * angle**2 / 2
        assert_close(found.barriers, np.full(2, exact), digits=9)
        assert_close(found.travel("lever"), np.array([2 * angle, 0.0, 0.0]), digits=9)

    @pytest.mark.parametrize("derivative", mostly_slow([REVERSE, jax.jacfwd]))
    def test_barrier_and_snap_force_have_derivatives(self, derivative):
        def quantities(rise):
            truss = von_mises_truss(rise)
            found = tj.bistability(truss, loads=[PUSH], max_points=100)
            return jnp.stack([found.barriers[0], 20 * found.snap_factors[0]])

        def exact(rise):
            return jnp.stack([barrier(rise), von_mises_limit_force(rise)])

        @jax.jit
        def slopes(rise):
            return derivative(quantities)(rise), jax.jacfwd(exact)(rise)

        assert_close(*slopes(0.3), digits=9)

    def test_a_spring_below_the_apex_makes_the_truss_monostable(self):
        """The slope of the force of the bars is -88 N/m or more."""
        for stiffness, snaps in ((200.0, False), (30.0, True)):
            load = tj.Load("apex", force=(0.0, -200.0))
            found = switch(supported_truss(spring=stiffness), load)
            assert bool(np.isfinite(found.snap_factors[0])) == snaps
            # The spring pushes back with more force than the bars hold with.
            assert not bool(found.is_bistable)
            assert np.isnan(found.energies[2])
            assert ("monostable" in repr(found)) != snaps
            assert ("may show a second state" in repr(found)) != snaps

    def test_a_weight_that_almost_makes_the_truss_monostable(self):
        """The second state is 3 mm from the unstable one."""
        limit = float(von_mises_limit_force())
        lift = limit * (1 - 1e-4)
        found = switch(lift=lift)
        assert bool(found.is_bistable)
        lowest = -float(von_mises_limit_height())
        intervals = ((0.3, 0.5), (lowest, 0.0), (-0.3, lowest))
        heights = np.array(
            [brentq(lambda h: von_mises_force(h) + lift, *ends) for ends in intervals]
        )
        assert 0.002 < heights[1] - heights[2] < 0.004
        travel = np.asarray(found.displacements)[:, 1, 2]
        assert_close(0.3 + travel, heights, digits=9)
        stretch = np.hypot(1.0, heights) - np.hypot(1.0, 0.3)
        energies = BAR_STIFFNESS * stretch**2 - lift * (heights - 0.3)
        assert_close(found.energies, energies, digits=9)
        np.testing.assert_array_equal(found.negative_eigenvalues, [0, 1, 0])
        assert_close(found.snap_factors[1], -1e-4 * limit / 20, digits=9)

    def test_a_steep_truss_moves_to_a_side_before_its_limit_point(self):
        found = switch(supported_truss(3.0), tj.Load("apex", force=(0.0, -4000.0)))
        force = branch_point_of_a_steep_truss(3.0)
        assert bool(found.is_bistable) and found.at_branch.all()
        expected = np.array([force, -force]) / 4000
        np.testing.assert_allclose(found.snap_factors, expected, rtol=1e-8)
        np.testing.assert_array_equal(found.negative_eigenvalues, [0, 1, 0])
        assert "(branch point)" in repr(found) and "barrier at most" in repr(found)

    def test_failures(self):
        with pytest.raises(RuntimeError, match="largest number of points"):
            switch(largest_step=0.005)
        failed = switch(largest_step=0.005, throw=False)
        assert not bool(failed.succeeded) and "max_points_reached" in repr(failed)
        flat = supported_truss(0.0, foot=(-1.0, 0.0))
        with pytest.raises(RuntimeError, match=r"Nothing resists .* y of 'apex'"):
            switch(flat)
        with pytest.raises(ValueError, match="Nothing is multiplied"):
            tj.bistability(von_mises_truss())


class Softened(tj.energies.AbstractEnergy):
    """A rotational stiffness that decreases with the square of the axial force; N."""

    def stored_energy(self, displacement):
        angle, x = displacement.angle, 2 * displacement.x1
        stiffness = 1e6
        force = stiffness * x
        softened = 2.0 - force**2
        return (stiffness * x**2 + softened * angle**2 + 1e6 * displacement.x2**2) / 2


@pytest.mark.slow
@pytest.mark.parametrize("rise", [0.02, 0.003])
def test_a_shallow_truss_is_bistable(rise):
    """Its second state is closer to the first one than a step of the path.

    The bars are straight in between, each shorter by half the square of the rise.
    """
    push = tj.Load("apex", force=(0.0, -2 * von_mises_limit_force(rise)))
    states = tj.bistability(truss_of(bars_of_a_truss(rise=rise), rise), loads=[push])
    assert bool(states.is_bistable)
    assert_close(states.travel("apex"), [0.0, 0.0, -2 * rise], digits=9)
    np.testing.assert_allclose(states.barriers, barrier(rise), rtol=1e-6)


class TestPrescribedDisplacements:
    """The states of the truss of von Mises do not depend on what moves it."""

    @pytest.mark.parametrize(
        "drive", mostly_slow([{"y": -0.65}, {"y": -0.6}, {"x": 0.0, "y": -0.65}])
    )
    def test_states_are_those_without_drive_force(self, drive):
        found = tj.bistability(von_mises_truss(), drives=[tj.Drive("apex", **drive)])
        assert bool(found.is_bistable)
        assert_close(found.travel("apex"), np.array([0.0, 0.0, -0.6]), digits=9)
        assert_close(found.barriers, np.full(2, barrier(0.3)), digits=9)
        np.testing.assert_array_equal(found.negative_eigenvalues, [0, 1, 0])
        # The drive force changes its sign where the bars are flat.
        assert_close(found.snap_factors, np.full(2, -0.3 / drive["y"]), digits=9)

    def test_a_displacement_that_does_not_reach_the_second_state(self):
        found = tj.bistability(von_mises_truss(), drives=[tj.Drive("apex", y=-0.5)])
        assert not bool(found.is_bistable) and np.isnan(found.energies[2])
        assert_close(found.snap_factors, np.full(2, 0.6), digits=9)

    @pytest.mark.slow
    def test_a_monostable_truss(self):
        push = [tj.Drive("apex", y=-0.9)]
        found = tj.bistability(supported_truss(spring=200.0), drives=push)
        assert not bool(found.is_bistable) and "monostable" in repr(found)

    @pytest.mark.release
    def test_a_lift_that_almost_makes_the_truss_monostable(self):
        lift = [tj.Load("apex", force=(0.0, von_mises_limit_force() * (1 - 1e-3)))]
        truss, drive = von_mises_truss(), tj.Drive("apex", y=-1.2)
        found = tj.bistability(truss, drives=[drive], constant_loads=lift)
        by_load = tj.bistability(truss, loads=[PUSH], constant_loads=lift)
        assert bool(found.is_bistable)
        assert_close(found.displacements, by_load.displacements, digits=8)
        assert_close(found.energies, by_load.energies, digits=9)

    @pytest.mark.slow
    def test_a_prescribed_angle(self):
        """A spring pulls a rotor over its dead center, at the angle 0."""
        begin, foot = 0.5, np.array([2.0, 0.0])
        end = np.array([np.cos(begin), np.sin(begin)])
        pivot = tj.Quadratic(np.diag([0.02, 1e6, 1e6]), "twist")
        hinges = [
            tj.Hinge("pivot", "wall", "rotor", pivot, at=(0.0, 0.0, 0.0)),
            bar("spring", "wall", "rotor", foot, end, 10.0),
        ]
        bodies = [tj.Body("wall"), tj.Body("rotor", pose=(0.0, 0.5, 0.0))]
        toggle = tj.Mechanism(bodies, hinges, fixed=["wall"])
        found = tj.bistability(toggle, drives=[tj.Drive("rotor", angle=-1.2)])

        def energy(turn):
            length = jnp.sqrt(5.0 - 4.0 * jnp.cos(begin + turn))
            stretch = length - np.hypot(*(foot - end))
            return 0.01 * turn**2 + 5.0 * stretch**2

        turns = np.array(
            [brentq(jax.grad(energy), *ends) for ends in ((-0.7, -0.4), (-1.1, -0.8))]
        )
        np.testing.assert_allclose(found.displacements[1:, 1, 0], turns, atol=1e-5)
        energies = np.array([energy(turn) for turn in turns])
        np.testing.assert_allclose(found.energies[1:], energies, rtol=1e-4)

    @pytest.mark.slow
    def test_barrier_and_switching_point_have_derivatives(self):
        def quantities(rise):
            drive = tj.Drive("apex", y=-0.8)
            truss = von_mises_truss(rise)
            found = tj.bistability(truss, drives=[drive], max_points=60)
            return jnp.stack([found.barriers[0], 0.8 * found.snap_factors[0]])

        exact = np.array([jax.grad(barrier)(0.3), 1.0])
        assert_close(jax.jit(jax.jacfwd(quantities))(0.3), exact, digits=9)


class TestBuckling:
    def found(self, force=1.0, constant=0.0, rotational=1.0, about=None):
        return tj.buckling(
            column(rotational=rotational),
            loads=[column_load(force=force)],
            constant_loads=[column_load(force=constant)],
            about=about,
        )

    def exact(self, rotational=1.0, count=6):
        springs = 2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
        springs[-1, -1] = 1.0
        return rotational * count * np.linalg.eigh(springs)[0]

    def test_column_of_rigid_links(self):
        found = self.found()
        np.testing.assert_allclose(found.load_factors, self.exact(), rtol=2e-6)
        bottom, top = np.asarray(found.shapes)[0, [1, -1], 0]
        assert abs(top) > abs(bottom) > 0 and top * bottom > 0
        assert repr(found).splitlines()[2].split() == ["0.348698", "link", "5"]

    @pytest.mark.slow
    def test_column_of_many_links(self):
        """Only a few of its 180 modes are computed. They are soft."""

        def factors(rotational):
            links, load = column(60, rotational, stiff=1e9), column_load(60)
            return tj.buckling(links, loads=[load], modes=3).load_factors

        found, slopes = jax.jvp(factors, (2.0,), (1.0,))
        exact = self.exact(count=60)[:3]
        np.testing.assert_allclose(found, 2.0 * exact, rtol=1e-9)
        np.testing.assert_allclose(slopes, exact, rtol=1e-6)

    @pytest.mark.slow
    @pytest.mark.parametrize("tilt", [0.3, 1e-3, np.pi])
    def test_a_column_on_pins_in_any_direction(self, tilt):
        """Two links of 0.5 m on two springs of 2 N m/rad.

        Displacements before buckling are rounding errors, also those of the state.
        """
        up = np.array([-np.sin(tilt), np.cos(tilt)])

        def at(height):
            return (tilt, *(height * up))

        spring = tj.Quadratic(np.diag([2.0, 0.0, 0.0]), "twist")
        links = tj.Mechanism(
            [tj.Body("base"), tj.Body("a", at(0.25)), tj.Body("b", at(0.75))],
            [
                tj.Hinge("lower", "base", "a", spring, at=at(0.0)),
                tj.Hinge("upper", "a", "b", spring, at=at(0.5)),
            ],
            fixed=["base"],
        )
        pins = [
            tj.Pin("foot", "base", "a", at=at(0.0)[1:]),
            tj.Pin("knee", "a", "b", at=at(0.5)[1:]),
        ]
        state = links.reference + np.array([[0.0] * 3, [1e-48, 0, 0], [-1e-48, 0, 0]])
        found = tj.buckling(
            links,
            loads=[tj.Load("b", force=tuple(-up), at=(0.0, 0.25))],
            constraints=pins,
            modes=3,
            about=state,
        )
        exact = np.array([3 - np.sqrt(5), 3 + np.sqrt(5)]) / 2 * 2.0 / 0.5
        np.testing.assert_allclose(found.load_factors, exact, rtol=1e-9)

    @pytest.mark.release
    def test_derivatives_by_the_stiffness(self):
        """The factors are proportional to the stiffness, so the second ones are zero."""

        def factors(rotational):
            mechanism = column(rotational=rotational)
            return tj.buckling(mechanism, loads=[column_load()], modes=3).load_factors

        first_twice = with_value(jax.jacrev(factors))
        second, first = jax.jit(jax.jacfwd(first_twice, has_aux=True))(1.3)
        np.testing.assert_allclose(first, self.exact()[:3], rtol=1e-5)
        assert_close(second, np.zeros(3), digits=6)

    def test_a_limit_point_far_from_the_linearized_equations_is_refused(self):
        """At the rise 1.6 it is found. A link beside it must not hide it either."""
        push = [tj.Load("apex", force=(0.0, -1.0))]
        found = tj.buckling(supported_truss(1.6), loads=push, modes=1)
        limit = von_mises_limit_force(1.6)
        np.testing.assert_allclose(found.load_factors[0], limit, rtol=1e-8)
        with pytest.raises(RuntimeError, match="use `path`"):
            tj.buckling(supported_truss(2.0), loads=push, modes=1)

    @pytest.mark.slow
    def test_a_branch_point_does_not_hide_a_lower_limit_point(self):
        limit = von_mises_limit_force()
        mechanism, loads = truss_and_link(1.2 * limit)
        found = tj.buckling(mechanism, loads=loads, throw=False)
        assert not np.any(np.isclose(found.load_factors[0], 1.2 * limit))

    def test_tension_buckles_with_negative_factors(self):
        found = self.found(force=-1.0)
        np.testing.assert_allclose(found.load_factors, -self.exact(), rtol=2e-6)

    def test_about_a_loaded_equilibrium(self):
        """A part of the load is constant already."""
        about = tj.equilibrium(column(), loads=[column_load(force=0.1)])
        found = self.found(constant=0.1, about=about)
        np.testing.assert_allclose(
            found.load_factors[0], self.exact()[0] - 0.1, rtol=1e-5
        )

    @pytest.mark.parametrize("derivative", mostly_slow([REVERSE, jax.jacfwd]))
    def test_a_link_on_a_pin_and_its_derivatives(self, derivative):
        """A rotational spring k and a link of length 1: the buckling load is k."""
        bodies = [tj.Body("base"), tj.Body("link", pose=(0.0, 0.0, 0.5))]
        pin = tj.Pin("pin", "base", "link", at=(0.0, 0.0))
        load = tj.Load("link", force=(0.0, -1.0), at=(0.0, 0.5))

        def factor(stiffness):
            spring = tj.Quadratic(jnp.diag(jnp.array([1.0, 0.0, 0.0])) * stiffness)
            hinge = tj.Hinge("spring", "base", "link", spring, at=(0.0, 0.0, 0.0))
            link = tj.Mechanism(bodies, [hinge], fixed=["base"])
            found = tj.buckling(link, loads=[load], constraints=[pin], throw=False)
            return found.load_factors[0]

        slope_and_value = derivative(with_value(factor), has_aux=True)
        slope, value = jax.jit(slope_and_value)(1.5)
        assert_close(value, 1.5, digits=10)
        assert_close(slope, 1.0, digits=9)

    @pytest.mark.parametrize("loads", [(1.3, 1.3), (2.7, 2.7, 4.0), (0.7, 0.7, 0.7)])
    def test_equal_load_factors(self, loads):
        """Their modes are orthonormal."""
        links, forces = parallel_links([*loads, *(4 - len(loads)) * [9.0]])
        found = tj.buckling(links, loads=forces)
        assert_close(found.load_factors[: len(loads)], np.array(loads), digits=10)
        shapes = np.asarray(found.shapes).reshape(4, -1)
        assert_close(shapes @ shapes.T, np.eye(4), digits=9)

    @pytest.mark.release
    def test_derivatives_of_equal_load_factors(self):
        def factors(stiffness):
            links, forces = parallel_links([stiffness, stiffness, 1.5 * stiffness, 9.0])
            return tj.buckling(links, loads=forces, modes=3).load_factors

        slopes = jax.jit(jax.jacrev(factors))(1.0)
        assert_close(slopes, np.array([1.0, 1.0, 1.5]), digits=9)

    @staticmethod
    def factors_of_a_stage(force):
        loads = [tj.Load("4", force=jnp.stack([0.0, force]))]
        found = tj.buckling(microstage(), loads=loads, modes=2, throw=False)
        return found.load_factors

    def test_estimates_without_an_equilibrium_are_not_listed(self):
        """Those after the first one follow from displacements that are far too large.

        The load at the factor is constant, except for the displacements before buckling.
        """
        factor, other = np.asarray(self.factors_of_a_stage(-100.0))
        assert other == np.inf
        double, other = np.asarray(self.factors_of_a_stage(-200.0))
        assert other == np.inf
        assert_close(double, factor / 2, digits=4)

    @pytest.mark.release
    def test_derivatives_beside_estimates_without_an_equilibrium(self):
        slopes = jax.jacfwd(with_value(self.factors_of_a_stage), has_aux=True)
        (change, _), (factor, other) = map(np.asarray, jax.jit(slopes)(-100.0))
        assert other == np.inf
        assert_close(change, factor / 100, digits=4)

    @pytest.mark.parametrize("rise", [0.05, 0.3, 1.0])
    def test_a_truss_buckles_at_its_limit_point(self, rise):
        """Far from the load factor of the linearized equations."""
        push = [tj.Load("apex", force=(0.0, -1.0))]
        found = tj.buckling(supported_truss(rise), loads=push, modes=1)
        force = von_mises_limit_force(rise)
        assert_close(found.load_factors, np.array([float(force)]), digits=9)

    @pytest.mark.slow
    def test_a_stiffness_that_depends_on_the_force(self):
        """A column that is softened by its load; see `Softened`."""
        hinge = tj.Hinge("hinge", "base", "link", Softened(), at=(np.pi / 2, 0.0, 0.0))
        bodies = [tj.Body("base"), tj.Body("link", pose=(0.0, 0.0, 0.5))]
        link = tj.Mechanism(bodies, [hinge], fixed=["base"])
        load = tj.Load("link", force=(0.0, -1.0), at=(0.0, 0.5))
        found = tj.buckling(link, loads=[load], modes=1)
        # The stiffness against rotation, 2 - P^2, is P times the length 1.
        np.testing.assert_allclose(found.load_factors, [1.0], rtol=1e-5)

    @pytest.mark.slow
    def test_a_hinge_outside_its_validity_range(self):
        """The column buckles at 0.35 N, and the energies are valid up to 0.2 N."""

        def narrow(force):
            rod = column(1)
            energy = tj.energies.WithValidityRange(
                rod.hinge_assembly.energy_of(0), rotation=0.5, force=force,
                error=[0.0, 0.0, 0.0],
            )  # fmt: skip
            hinge = tj.Hinge("hinge 0", "base", "link 0", energy, at=(np.pi / 2, 0, 0))
            bodies = [tj.Body("base"), tj.Body("link 0", pose=(0.0, 0.0, 0.5))]
            return tj.Mechanism(bodies, [hinge], fixed=["base"])

        load = [column_load(1)]
        message = r"'hinge 0': its rotation is .* force 1 N, .* valid up to .* 0\.2 N"
        with pytest.raises(RuntimeError, match=message):
            tj.buckling(narrow(0.2), loads=load)
        failed = tj.buckling(narrow(0.2), loads=load, throw=False)
        assert str(tj.result_names(failed.result)) == "out_of_range"
        assert np.isnan(failed.load_factors).all()
        np.testing.assert_allclose(
            tj.buckling(narrow(1.2), loads=load, modes=1).load_factors, [1.0], rtol=1e-6
        )

    def test_a_body_that_nothing_supports(self):
        with pytest.raises(RuntimeError, match=r"Nothing resists .* angle of 'link 5'"):
            self.found(rotational=0.0)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({}, "Nothing is multiplied"),
            ({"loads": [column_load()], "modes": 0}, "`modes` is 0"),
            (
                {"loads": [tj.Load("link 5", force=(0.0, -1.0), follower=True)]},
                "follower load",
            ),
        ],
    )
    def test_errors(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            tj.buckling(column(), **arguments)


class TestMessages:
    @pytest.mark.untyped
    def test_three_states_instead_of_one(self):
        truss, found = supported_truss(), cast(Any, switch())
        with pytest.raises(ValueError, match=r"shape \(3, 2, 3\).* one of its `poses`"):
            tj.equilibrium(truss, start=found)
        with pytest.raises(ValueError, match="one of its `poses`"):
            tj.draw(truss, found)

    def test_the_fraction_of_a_limit_point(self):
        with pytest.raises(
            RuntimeError, match=r"limit point at the fraction 0\.49749585"
        ):
            tj.equilibrium(von_mises_truss(), loads=[PUSH])

    def test_the_fraction_of_a_branch_point(self):
        """A steep truss moves to a side before it snaps."""
        fraction = branch_point_of_a_steep_truss(3.0) / 4000
        with pytest.raises(RuntimeError) as error:
            tj.equilibrium(
                von_mises_truss(3.0), loads=[tj.Load("apex", force=(0.0, -4000.0))]
            )
        assert f"There is a branch point at the fraction {fraction:.7g}" in str(
            error.value
        )
