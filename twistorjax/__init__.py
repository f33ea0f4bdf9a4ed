"""Differentiable mechanics of planar compliant mechanisms, in JAX.

A `Mechanism` consists of rigid bodies that are connected by elastic hinges.
`equilibrium`, `linearize`, `vibrations`, `frequency_response`, and `simulate` compute its
response to loads and prescribed displacements. Their results are differentiable. A solver
that fails raises an error, or with `throw=False` returns NaN and a `result`.

The namespaces contain the rest: `energies` and `flexures` for hinges, `lattices` for
repeated cells, `solve` for results and solvers of motion, `identification` and `sweeps`
for studies, `io` and `plotting` for files and figures, `geometry` for poses and twistors,
and `examples` for the mechanisms of the dissertation on which the library is based.
"""

from ._utils.lazy_names import attach


__version__ = "0.2.0"


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)
