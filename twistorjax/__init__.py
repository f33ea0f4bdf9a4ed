"""Differentiable mechanics of planar compliant mechanisms, in JAX.

A `Mechanism` consists of rigid bodies that are connected by elastic hinges.
`equilibrium`, `linearize`, `vibrations`, `frequency_response`, and `simulate` compute its
response to loads and prescribed displacements. All results are differentiable. A solver
that fails raises an error, or with `throw=False` returns NaN and a `result`.

The namespaces contain the rest: `energies` and `flexures` for hinges, `solve` for results
and solvers of motion, `identification` and `sweeps` for studies, `io` and `plotting` for
files and figures, `geometry` for poses and twistors, and `examples` for the mechanisms of
the dissertation on which the library is based.
"""

from . import (
    energies as energies,
    examples as examples,
    flexures as flexures,
    geometry as geometry,
    identification as identification,
    io as io,
    plotting as plotting,
    solve as solve,
    sweeps as sweeps,
)
from ._utils.configuration import configure as configure
from .energies import (
    AbstractEnergy as AbstractEnergy,
    fit_energy as fit_energy,
    Quadratic as Quadratic,
)
from .flexures import Material as Material
from .identification import identify as identify, Parameter as Parameter
from .mechanism import (
    Body as Body,
    Constraint as Constraint,
    Drive as Drive,
    Hinge as Hinge,
    Load as Load,
    Mechanism as Mechanism,
    Pin as Pin,
    plate as plate,
    Slider as Slider,
)
from .plotting import animate as animate, draw as draw
from .solve import (
    Equilibrium as Equilibrium,
    equilibrium as equilibrium,
    frequency_response as frequency_response,
    FrequencyResponse as FrequencyResponse,
    Linearization as Linearization,
    linearize as linearize,
    Motion as Motion,
    result_names as result_names,
    RESULTS as RESULTS,
    simulate as simulate,
    Vibrations as Vibrations,
    vibrations as vibrations,
)
from .sweeps import Grid as Grid, sweep as sweep


__all__ = [
    "configure",
    "Body",
    "plate",
    "Hinge",
    "Material",
    "Mechanism",
    "Load",
    "Drive",
    "Pin",
    "Slider",
    "Constraint",
    "AbstractEnergy",
    "Quadratic",
    "fit_energy",
    "equilibrium",
    "Equilibrium",
    "linearize",
    "Linearization",
    "vibrations",
    "Vibrations",
    "frequency_response",
    "FrequencyResponse",
    "simulate",
    "Motion",
    "RESULTS",
    "result_names",
    "identify",
    "Parameter",
    "sweep",
    "Grid",
    "draw",
    "animate",
    "energies",
    "flexures",
    "geometry",
    "solve",
    "identification",
    "sweeps",
    "plotting",
    "io",
    "examples",
]


def __dir__() -> list[str]:
    return __all__
