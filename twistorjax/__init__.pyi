from . import (
    energies as energies,
    examples as examples,
    flexures as flexures,
    geometry as geometry,
    identification as identification,
    io as io,
    lattices as lattices,
    plotting as plotting,
    solve as solve,
    sweeps as sweeps,
)
from ._compile.configuration import configure as configure
from .energies import (
    AbstractEnergy as AbstractEnergy,
    fit_energy as fit_energy,
    Quadratic as Quadratic,
)
from .flexures import surrogate as surrogate
from .identification import identify as identify, Parameter as Parameter
from .mechanism import (
    Body as Body,
    Constraint as Constraint,
    Drive as Drive,
    Expansion as Expansion,
    Hinge as Hinge,
    Load as Load,
    Material as Material,
    Mechanism as Mechanism,
    Pin as Pin,
    plate as plate,
    Slider as Slider,
    SubMechanism as SubMechanism,
    Temperature as Temperature,
    weights as weights,
)
from .plotting import animate as animate, draw as draw
from .solve import (
    Bistability as Bistability,
    bistability as bistability,
    Buckling as Buckling,
    buckling as buckling,
    constraint_analysis as constraint_analysis,
    Dispersion as Dispersion,
    dispersion as dispersion,
    Equilibrium as Equilibrium,
    equilibrium as equilibrium,
    Fatigue as Fatigue,
    fatigue as fatigue,
    frequency_response as frequency_response,
    FrequencyResponse as FrequencyResponse,
    Linearization as Linearization,
    linearize as linearize,
    LinearResponse as LinearResponse,
    Motion as Motion,
    out_of_plane as out_of_plane,
    OutOfPlane as OutOfPlane,
    Path as Path,
    path as path,
    port_compliance as port_compliance,
    port_motion as port_motion,
    range_of_motion as range_of_motion,
    RangeOfMotion as RangeOfMotion,
    result_names as result_names,
    RESULTS as RESULTS,
    simulate as simulate,
    state_space as state_space,
    StateSpace as StateSpace,
    Stresses as Stresses,
    stresses as stresses,
    Vibrations as Vibrations,
    vibrations as vibrations,
)
from .sweeps import (
    Grid as Grid,
    Limit as Limit,
    optimize as optimize,
    Optimum as Optimum,
    sweep as sweep,
)

__version__: str
