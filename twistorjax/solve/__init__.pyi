from .bistability import Bistability as Bistability, bistability as bistability
from .buckling import Buckling as Buckling, buckling as buckling
from .constraint_analysis import constraint_analysis as constraint_analysis
from .continuation.solution import (
    CriticalPoint as CriticalPoint,
    CriticalPoints as CriticalPoints,
    Path as Path,
    PathPoint as PathPoint,
)
from .dispersion import Dispersion as Dispersion, dispersion as dispersion
from .equations.mobility import ConstraintAnalysis as ConstraintAnalysis
from .equations.stresses import Stresses as Stresses
from .equilibrium import (
    Column as Column,
    equilibrium as equilibrium,
    result_names as result_names,
    RESULTS as RESULTS,
)
from .fatigue import Fatigue as Fatigue, fatigue as fatigue
from .frequency_response import (
    frequency_response as frequency_response,
    FrequencyResponse as FrequencyResponse,
)
from .integration.collocation import Gauss as Gauss, Radau as Radau
from .integration.diffrax_interface import ProgressBar as ProgressBar
from .integration.solution import Energies as Energies, Motion as Motion
from .linearization import (
    Linearization as Linearization,
    linearize as linearize,
    LinearResponse as LinearResponse,
)
from .out_of_plane import (
    out_of_plane as out_of_plane,
    spatial_compliance as spatial_compliance,
)
from .out_of_plane_model import (
    OutOfPlane as OutOfPlane,
    OutOfPlaneResponse as OutOfPlaneResponse,
)
from .path import path as path
from .port_compliance import (
    port_compliance as port_compliance,
    PortCompliance as PortCompliance,
)
from .port_motion import port_motion as port_motion, PortMotion as PortMotion
from .range_of_motion import (
    range_of_motion as range_of_motion,
    RangeOfMotion as RangeOfMotion,
)
from .simulate import simulate as simulate
from .state_space import state_space as state_space, StateSpace as StateSpace
from .statics.solution import Equilibrium as Equilibrium
from .stresses import stresses as stresses
from .stroke_stiffness import (
    stiffness_over_stroke as stiffness_over_stroke,
    StrokeStiffness as StrokeStiffness,
)
from .vibration_results import (
    OutOfPlaneVibrations as OutOfPlaneVibrations,
    Vibrations as Vibrations,
)
from .vibrations import vibrations as vibrations
