"""Statics, linearization, vibrations, frequency response, and motion of a mechanism.

Start reading in `statics`. `equilibrium` assembles the equations of a `Mechanism`, its
loads, prescribed displacements, and constraints (`system`), and solves them by Newton's
method in load increments (`newton`). If an increment does not converge, or may contain a
fold, the solver returns to the last equilibrium and tries a shorter one, until the
increment is too short or `max_steps` is reached. Then `equilibrium` raises an error, or
with `throw=False` returns NaN with derivatives of zero, the reason (`results`), and the
last equilibrium (`fraction`, `reached`). A gain or another quantity is computed from the
displacements; see `amplification` in `examples.stage`. `static_results` has the
equilibrium, `static_errors` its messages, and `load_state` the loads from which load
increments begin.

`implicit_derivatives` differentiates an equilibrium by the implicit function theorem,
with one linear solve and not through the Newton steps.
`linearization`, `vibrations`, and `frequency_response` use the same `system` about an
equilibrium. `tangent_stiffness`, `factorization`, and `block_factorization` contain its
matrices. `dynamics` integrates the equations of motion (`motion_system`) by the solvers
in `collocation` or those of diffrax. `tables` converts solutions to xarray datasets.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
