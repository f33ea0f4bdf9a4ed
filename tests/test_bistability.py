"""Bistable states, linearized buckling, and messages at critical points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from path_helpers import (
    BAR_STIFFNESS,
    column,
    column_load,
    von_mises_force,
    von_mises_limit_force,
)
from scipy.optimize import brentq

import twistorjax as tj
from twistorjax.examples.truss import von_mises_truss


PUSH = tj.Load("apex", force=(0.0, -20.0))


def switch(rise=0.3, max_points=100, **arguments):
    truss = von_mises_truss(rise)
    return tj.bistability(truss, loads=[PUSH], max_points=max_points, **arguments)


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

    def test_a_weight_makes_the_first_barrier_smaller(self):
        """Snap forces shift by the weight, and the energies include its work."""
        weight = tj.Load("apex", force=(0.0, -2.0))
        found = switch(constant_loads=[weight])
        plain = von_mises_limit_force()
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

    def test_barrier_and_snap_force_have_derivatives(self):
        def quantities(rise):
            found = switch(rise)
            return jnp.stack([found.barriers[0], 20 * found.snap_factors[0]])

        def exact(rise):
            return jnp.stack([barrier(rise), von_mises_limit_force(rise)])

        assert_close(
            jax.jit(jax.jacrev(quantities))(0.3), jax.jacrev(exact)(0.3), digits=9
        )

    def test_a_spring_below_the_apex_makes_the_truss_monostable(self):
        """The slope of the force of the bars is -88 N/m or more."""
        truss = von_mises_truss()
        for stiffness, snaps in ((200.0, False), (30.0, True)):
            spring = tj.Quadratic(np.diag([0.0, stiffness, stiffness]))
            hinges = [
                tj.Hinge(
                    name, *ends, truss.hinge_assembly.energy_of(row), at=truss.at[row]
                )
                for row, (name, ends) in enumerate(
                    {"left": ("wall", "apex"), "right": ("apex", "wall")}.items()
                )
            ]
            bodies = [tj.Body("wall"), tj.Body("apex", pose=(0.0, 0.0, 0.3))]
            below = tj.Hinge("spring", "wall", "apex", spring, at=(0.0, 0.0, 0.3))
            fixed = {"wall": ["angle", "x", "y"], "apex": ["angle"]}
            supported = tj.Mechanism(bodies, [*hinges, below], fixed=fixed)
            load = tj.Load("apex", force=(0.0, -200.0))
            found = tj.bistability(supported, loads=[load], max_points=100)
            assert bool(np.isfinite(found.snap_factors[0])) == snaps
            # The spring pushes back with more force than the bars hold with.
            assert not bool(found.is_bistable)
            assert np.isnan(found.energies[2])
            assert ("monostable" in repr(found)) != snaps


class TestBuckling:
    COUNT = 6

    def exact(self, rotational=1.0):
        count = self.COUNT
        springs = 2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
        springs[-1, -1] = 1.0
        return rotational * count * np.linalg.eigh(springs)[0]

    def test_column_of_rigid_links(self):
        found = tj.buckling(column(), loads=[column_load()])
        np.testing.assert_allclose(found.load_factors, self.exact(), rtol=2e-6)
        bottom, top = found.shapes[0, 1, 0], found.shapes[0, -1, 0]
        assert abs(top) > abs(bottom) > 0 and top * bottom > 0
        assert repr(found).splitlines()[2].split() == ["0.348698", "link", "5"]

    def test_derivatives_by_the_stiffness(self):
        """The factors are proportional to the stiffness, so the second ones are zero."""

        def factors(rotational):
            mechanism = column(rotational=rotational)
            return tj.buckling(mechanism, loads=[column_load()], modes=3).load_factors

        first = jax.jit(jax.jacfwd(factors))
        np.testing.assert_allclose(first(1.3), self.exact()[:3], rtol=1e-5)
        second = jax.jit(jax.jacfwd(jax.jacrev(factors)))(1.3)
        assert_close(second, np.zeros(3), digits=6)

    def test_tension_buckles_with_negative_factors(self):
        found = tj.buckling(column(), loads=[column_load(force=-1.0)], modes=2)
        np.testing.assert_allclose(found.load_factors, -self.exact()[:2], rtol=2e-6)

    def test_about_a_loaded_equilibrium(self):
        """A part of the load is constant already."""
        constant = [column_load(force=0.1)]
        about = tj.equilibrium(column(), loads=constant)
        found = tj.buckling(
            column(), loads=[column_load()], constant_loads=constant, about=about
        )
        np.testing.assert_allclose(
            found.load_factors[0], self.exact()[0] - 0.1, rtol=1e-5
        )

    def test_a_link_on_a_pin(self):
        """A rotational spring k and a link of length 1: the buckling load is k."""
        spring = tj.Quadratic(np.diag([1.5, 0.0, 0.0]))
        bodies = [tj.Body("base"), tj.Body("link", pose=(0.0, 0.0, 0.5))]
        hinge = tj.Hinge("spring", "base", "link", spring, at=(0.0, 0.0, 0.0))
        mechanism = tj.Mechanism(bodies, [hinge], fixed=["base"])
        pin = tj.Pin("pin", "base", "link", at=(0.0, 0.0))
        load = tj.Load("link", force=(0.0, -1.0), at=(0.0, 0.5))
        found = tj.buckling(mechanism, loads=[load], constraints=[pin], modes=1)
        assert_close(found.load_factors, np.array([1.5]), digits=10)

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
    def test_the_fraction_of_a_limit_point(self):
        with pytest.raises(
            RuntimeError, match=r"limit point at the fraction 0\.49749585"
        ):
            tj.equilibrium(von_mises_truss(), loads=[PUSH])

    def test_the_fraction_of_a_branch_point(self):
        with pytest.raises(RuntimeError, match=r"branch point at the fraction 0\.348698"):
            tj.equilibrium(column(), loads=[column_load()])
