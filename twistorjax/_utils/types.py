"""Types of arrays: their entries, the order of the entries, and their units.

The rotation is always the first entry. Angles are real numbers and are never wrapped.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Array, ArrayLike, Bool, Float, Int
from typing_extensions import TypeAliasType


# Arguments as a user may write them, for example as nested lists. Each is an alias with a
# name, which `help` prints instead of a long union.

NumberLike = TypeAliasType("NumberLike", ArrayLike)
# One number, or a list of numbers.
NumbersLike = TypeAliasType("NumbersLike", ArrayLike | Sequence[ArrayLike])
# Numbers by name, such as the parameters of a design.
NamedNumbers = TypeAliasType("NamedNumbers", Mapping[str, NumberLike])
ArrayOfNumbers = TypeAliasType("ArrayOfNumbers", ArrayLike)  # of any shape
KeyLike = TypeAliasType("KeyLike", Array | int)  # a key or a seed of `jax.random`

# (x, y); m
PointLike = TypeAliasType("PointLike", Float[ArrayLike, "2"] | Sequence[ArrayLike])
# The two ends of a hinge; m
EndsLike = TypeAliasType("EndsLike", Float[ArrayLike, "2 2"] | Sequence[PointLike])
# (fx, fy); N
ForceLike = TypeAliasType("ForceLike", Float[ArrayLike, "2"] | Sequence[ArrayLike])
# (angle, x, y); rad, m, m
PoseLike = TypeAliasType("PoseLike", Float[ArrayLike, "3"] | Sequence[ArrayLike])
# (rotation, x, y) per second; rad/s, m/s, m/s
VelocityLike = TypeAliasType("VelocityLike", Float[ArrayLike, "3"] | Sequence[ArrayLike])
# (moment, fx, fy); N m, N, N
WrenchLike = TypeAliasType("WrenchLike", Float[ArrayLike, "3"] | Sequence[ArrayLike])
# A linear map from twists to wrenches; N m, N/m, and N, or times s for damping
MatrixLike = TypeAliasType("MatrixLike", Float[ArrayLike, "3 3"])
# Inertia matrix against rotations about two axes; kg m^2
InertiaLike = TypeAliasType(
    "InertiaLike", Float[ArrayLike, "2 2"] | Sequence[Sequence[ArrayLike]]
)
# A force along z, and moments about x and y; N, N m, N m
OutOfPlaneForceLike = TypeAliasType(
    "OutOfPlaneForceLike", Float[ArrayLike, "3"] | Sequence[ArrayLike]
)
# A row (angle, x, y) for each body; rad, m, m
PosesLike = TypeAliasType(
    "PosesLike", Float[ArrayLike, "bodies 3"] | Sequence[Sequence[ArrayLike]]
)
# Vectors (x, y) from a cell of a lattice to the next ones; m
VectorsLike = TypeAliasType(
    "VectorsLike", Float[ArrayLike, "directions 2"] | Sequence[PointLike]
)
# Wave vectors (x, y); rad/m
WaveVectorsLike = TypeAliasType(
    "WaveVectorsLike", Float[ArrayLike, "waves 2"] | Sequence[Sequence[ArrayLike]]
)
# Wave vectors in units of the reciprocal lattice
ReducedVectorsLike = TypeAliasType(
    "ReducedVectorsLike",
    Float[ArrayLike, "corners directions"] | Sequence[Sequence[ArrayLike]],
)
# Derivatives of (x, y) by (x, y)
GradientLike = TypeAliasType(
    "GradientLike", Float[ArrayLike, "2 2"] | Sequence[Sequence[ArrayLike]]
)
# A closed polygon, in order; m
CornersLike = TypeAliasType(
    "CornersLike", Float[ArrayLike, "corners 2"] | Sequence[Sequence[ArrayLike]]
)
TimesLike = TypeAliasType("TimesLike", Float[ArrayLike, " times"] | Sequence[ArrayLike])
# Hz
FrequenciesLike = TypeAliasType(
    "FrequenciesLike", Float[ArrayLike, " frequencies"] | Sequence[ArrayLike]
)
# A coefficient for each term of a series; the units are those of the energy.
CoefficientsLike = TypeAliasType(
    "CoefficientsLike", Float[ArrayLike, " terms"] | Sequence[ArrayLike]
)
# A row (angle, x, y) or (moment, fx, fy) for each trial; rad, m, m or N m, N, N
TrialsLike = TypeAliasType(
    "TrialsLike", Float[ArrayLike, "trials 3"] | Sequence[Sequence[ArrayLike]]
)
# A number for each trial; J
EnergiesLike = TypeAliasType(
    "EnergiesLike", Float[ArrayLike, " trials"] | Sequence[ArrayLike]
)
# One standard deviation, or one for each trial; J or N m, N, N
EnergyDeviationsLike = TypeAliasType(
    "EnergyDeviationsLike", Float[ArrayLike, "*trials"] | Sequence[ArrayLike]
)
WrenchDeviationsLike = TypeAliasType(
    "WrenchDeviationsLike", Float[ArrayLike, "*trials 3"] | Sequence[ArrayLike]
)
# A row for each trial or time, with a number for each sensor
TableLike = TypeAliasType(
    "TableLike", Float[ArrayLike, "rows columns"] | Sequence[Sequence[ArrayLike]]
)
TableDeviationsLike = TypeAliasType(
    "TableDeviationsLike", Float[ArrayLike, "*rows columns"] | Sequence[Any]
)

# Arrays, as functions take and return them.

Key = TypeAliasType("Key", Array)  # a key of `jax.random`
AnyArray = TypeAliasType("AnyArray", Array)  # of any shape and dtype
Scalar = TypeAliasType("Scalar", Float[Array, ""])
Flag = TypeAliasType("Flag", Bool[Array, ""])
Count = TypeAliasType("Count", Int[Array, ""])
Numbers = TypeAliasType("Numbers", Float[Array, "..."])  # of any shape

Point = TypeAliasType("Point", Float[Array, "2"])  # (x, y); m
Pose = TypeAliasType("Pose", Float[Array, "3"])  # (angle, x, y); rad, m, m
# (rotation, along axis 1, along axis 2); rad, m, m
Twist = TypeAliasType("Twist", Float[Array, "3"])
Twistor = TypeAliasType("Twistor", Float[Array, "4"])  # (sigma, xi, x1, x2); -, -, m, m
Wrench = TypeAliasType("Wrench", Float[Array, "3"])  # (moment, fx, fy); N m, N, N
# A linear map between twists and wrenches
Matrix = TypeAliasType("Matrix", Float[Array, "3 3"])

# A row (angle, x, y) for each body; rad, m, m
Poses = TypeAliasType("Poses", Float[Array, "bodies 3"])
# A row (moment, fx, fy) for each body; N m, N, N
Wrenches = TypeAliasType("Wrenches", Float[Array, "bodies 3"])
# A closed polygon, in order; m
Corners = TypeAliasType("Corners", Float[Array, "corners 2"])
Entries = TypeAliasType("Entries", Float[Array, " entries"])  # of all constraints
Times = TypeAliasType("Times", Float[Array, " times"])  # s
Arm = TypeAliasType("Arm", Point | tuple[Scalar, Scalar])
Table = TypeAliasType("Table", Float[Array, "rows columns"])  # of readings

# Arrays of results, with axes in front for a batch of designs.

BatchScalar = TypeAliasType("BatchScalar", Float[Array, "*batch"])
BatchFlag = TypeAliasType("BatchFlag", Bool[Array, "*batch"])
Parameters = TypeAliasType("Parameters", Float[Array, " parameters"])


@runtime_checkable
class Displaced(Protocol):
    """A result with the displacements of bodies, such as an equilibrium or a motion."""

    @property
    def displacements(self) -> Float[Array, "*batch bodies 3"]:
        """Displacements of the bodies from `reference`; rad, m, m."""
        ...

    @property
    def reference(self) -> Poses:
        """Poses of the bodies in the reference configuration; rad, m, m."""
        ...


# A result with displacements, or poses of the bodies; rad, m, m
PosesOrResult = TypeAliasType("PosesOrResult", Displaced | PosesLike)
