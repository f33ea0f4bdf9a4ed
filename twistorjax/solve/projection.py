"""Solvers of diffrax for mechanisms with constraints."""

from typing import Any, cast

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp

from .integration.system import MotionSystem, State


class Projected(dfx.AbstractWrappedSolver):
    """A solver of diffrax that projects the end of each step onto the constraints.

    The equations of motion set the second time derivative of the constraint violations to
    zero. Because of integration errors, the violations themselves would slowly grow.
    Therefore the displacements and velocities are projected after each step, in the
    metric of the inertia. The order of the solver does not change.

    Args:
        solver: A solver for ordinary differential equations.

    Source:
        Hairer, Lubich and Wanner, Geometric Numerical Integration, algorithm IV.4.2.
    """

    solver: dfx.AbstractSolver

    @property
    def term_structure(self) -> Any:
        return self.solver.term_structure

    @property
    def interpolation_cls(self) -> Any:  # pyright: ignore
        return self.solver.interpolation_cls

    @property
    def term_compatible_contr_kwargs(self) -> Any:
        return self.solver.term_compatible_contr_kwargs

    @property
    def root_finder(self) -> Any:
        """Root finder of an implicit solver, whose tolerances diffrax sets."""
        return cast(dfx.AbstractImplicitSolver, self.solver).root_finder

    def order(self, terms):
        return self.solver.order(terms)

    def strong_order(self, terms):
        return self.solver.strong_order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args)

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)

    def step(self, terms, t0, t1, y0: State, args: MotionSystem, solver_state, made_jump):
        # The state of the solver was computed before the projection of the last step. For
        # diffrax the projection is a jump.
        del made_jump
        end, error, dense, solver_state, result = self.solver.step(
            terms, t0, t1, y0, args, solver_state, True
        )
        time = jnp.asarray(t1)
        position, rate = args.project(time, end.position, end.rate)
        end = eqx.tree_at(lambda end: (end.position, end.rate), end, (position, rate))
        return end, error, dense, solver_state, result
