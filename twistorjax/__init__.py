"""Differentiable mechanics of planar mechanisms of rigid bodies and elastic hinges."""

from . import (
    cases as cases,
    clifford as clifford,
    lines as lines,
    se2 as se2,
    solve as solve,
    study as study,
    sweeps as sweeps,
)
from .body import Body as Body, plate as plate
from .boundary import Drive as Drive, Load as Load
from .certified import Certified as Certified
from .coulomb import Coulomb as Coulomb
from .damping import Viscous as Viscous
from .energy import AbstractEnergy as AbstractEnergy, Quadratic as Quadratic
from .exchange import (
    exudyn_script as exudyn_script,
    load_mechanism as load_mechanism,
    save_mechanism as save_mechanism,
    save_outline as save_outline,
)
from .fitted import Fit as Fit
from .flexure import (
    Beam as Beam,
    bend as bend,
    bend_to as bend_to,
    Bent as Bent,
    distilled as distilled,
    Exact as Exact,
    largest_turn as largest_turn,
    leaf as leaf,
    leaf_outline as leaf_outline,
    leaf_stress as leaf_stress,
    Material as Material,
    notch as notch,
    notch_outline as notch_outline,
    notch_profile as notch_profile,
    notch_stress as notch_stress,
    quartic_leaf as quartic_leaf,
)
from .hinge import Hinge as Hinge
from .joints import Constraint as Constraint, Pin as Pin, Slider as Slider
from .mechanism import Mechanism as Mechanism
from .monomials import monomials as monomials
from .polynomial import (
    Polynomial as Polynomial,
    Rational as Rational,
    Squares as Squares,
)
from .quotients import fit_rational as fit_rational, RationalFit as RationalFit
from .regression import fit_energy as fit_energy
from .show.animation import animate as animate
from .show.drawing import draw as draw
from .show.landscapes import draw_energy as draw_energy
from .show.progress import ProgressBar as ProgressBar
from .slender import Slender as Slender
from .solve.collocation import Gauss as Gauss, Radau as Radau
from .solve.dynamics import simulate as simulate
from .solve.linear import linearise as linearise, Linearised as Linearised
from .solve.motion import Motion as Motion
from .solve.results import outcomes as outcomes, RESULTS as RESULTS
from .solve.statics import Equilibrium as Equilibrium, equilibrium as equilibrium
from .solve.tables import Column as Column
from .solve.vibrations import (
    frequency_response as frequency_response,
    Response as Response,
    Vibrations as Vibrations,
    vibrations as vibrations,
)
from .storage import load_energy as load_energy, save_energy as save_energy
from .study import (
    Advice as Advice,
    advise as advise,
    fit as fit,
    Gauge as Gauge,
    HingeTest as HingeTest,
    Identification as Identification,
    Measured as Measured,
    MotionTest as MotionTest,
    posterior as posterior,
    read_measured as read_measured,
    Reading as Reading,
    Sensor as Sensor,
    StaticTest as StaticTest,
    Unknown as Unknown,
    VibrationTest as VibrationTest,
)
from .sweeps import (
    Grid as Grid,
    Normal as Normal,
    open_sweep as open_sweep,
    sampled as sampled,
    sweep as sweep,
    tolerances as tolerances,
    Uniform as Uniform,
)
from .trials import read_trials as read_trials, Trials as Trials
