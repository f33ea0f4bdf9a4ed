"""Statics, linearization, vibrations, frequency response, and motion of a mechanism.

A file of this folder is a question that a user asks, named as its public function; a
folder is machinery. Start reading in `equilibrium`. It assembles the equations of a
`Mechanism`, its loads, prescribed displacements, and constraints (`equations`), and
solves them by Newton's method in load increments (`statics`). If an increment does not
converge, or may contain a fold, the solver returns to the last equilibrium and tries a
shorter one, until the increment is too short or `max_steps` is reached. Then
`equilibrium` raises an error, or with `throw=False` returns NaN with derivatives of zero,
the reason (`result`), and the last equilibrium (`fraction`, `reached`). A gain or another
quantity is computed from the displacements; see `amplification` in `examples.stage`.

`linearization`, `vibrations`, `frequency_response`, and others use the same equations
about an equilibrium. `path` and what is built on it follow equilibria beyond buckling
loads (`continuation`), and `simulate` integrates the equations of motion (`integration`).
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
