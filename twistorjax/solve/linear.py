"""Small displacements: the linear map from what is done to a mechanism to its answer."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._utils.types import Poses, PosesLike
from .._utils.validation import require_float64
from ..mechanism.loads import Drive, driven, Load, loaded_bodies, LoadSet
from ..mechanism.mechanism import Mechanism
from .factorization import Factors
from .results import RESULTS
from .static_system import DofPartition, Problem
from .statics import Equilibrium, free_coordinates, raised, within_range


class Linearization(eqx.Module):
    """A mechanism near one state, its tangent factored once for many loads and drives.

    Call it with drives of just the coordinates that it was made for, and any loads; it
    answers with an `Equilibrium` whose displacements and reactions are the changes from
    the state, to first order, and whose energy is half their product: at rest what the
    hinges store, about a loaded state the second-order change of the whole potential.
    """

    mechanism: Mechanism
    about: Poses
    matrix: Float[Array, "coordinates coordinates"]
    factors: Factors
    places: DofPartition = eqx.field(static=True)
    finite: Bool[Array, ""]

    def __call__(
        self,
        *,
        loads: Sequence[Load] = (),
        drives: Sequence[Drive] = (),
        throw: bool = True,
    ) -> Equilibrium:
        """The change of displacements and reactions under some loads and drives.

        Args:
            loads: small ones, beside those that act already.
            drives: of the coordinates that were named to `linearize`, all of them.
            throw: whether a failure is raised, or only told by `result`.

        Raises:
            ValueError: the driven coordinates are not those named, or a name is unknown.
            RuntimeError: the state is not stable, or a value is not finite.
        """
        mechanism = self.mechanism
        places, targets = driven(mechanism, drives)
        if sorted(places) != sorted(self.places.driven):
            raise ValueError(
                f"`drives` moves {_listed(mechanism, places)}, but this map was made by "
                f"`linearize` for {_listed(mechanism, self.places.driven)}."
            )
        free = np.array(self.places.free, int)
        flat = (
            jnp.zeros(self.about.size)
            .at[np.array(places, int)]
            .set(jnp.array(targets, float))
        )
        applied, _ = LoadSet.of(
            loads, loaded_bodies(mechanism, loads), mechanism.reference
        ).apply(self.about - mechanism.reference)
        applied = applied.reshape(-1)
        flat = flat.at[free].set(self.factors.solve((applied - self.matrix @ flat)[free]))
        forces = self.matrix @ flat
        fixed = jnp.ones(flat.size).at[free].set(0.0)
        result = RESULTS.where(
            self.factors.resists(), RESULTS.successful, RESULTS.unstable
        )
        fine = self.finite & jnp.all(jnp.isfinite(applied))
        result = RESULTS.where(fine, result, RESULTS.not_finite)
        shape = self.about.shape
        answer = Equilibrium(
            displacements=flat.reshape(shape),
            reference=self.about,
            reactions=(fixed * (forces - applied)).reshape(shape),
            energy=jnp.vdot(flat, forces) / 2,
            reached=flat.reshape(shape),
            fraction=jnp.ones(()),
            steps=jnp.zeros((), int),
            result=result,
            names=mechanism.names,
        )
        return raised(answer, mechanism) if throw else answer


def linearize(
    mechanism: Mechanism,
    driven: Sequence[str] | Mapping[str, Sequence[str]] = (),
    *,
    about: PosesLike | Equilibrium | None = None,
    loads: Sequence[Load] = (),
) -> Linearization:
    """The answer of a mechanism to small loads and drives, as one factorisation.

    Args:
        mechanism: at rest where nothing loads it.
        driven: which coordinates will be driven: names of bodies, for all three, or a
            mapping from names to some of "angle", "x" and "y".
        about: Equilibrium from which changes count, or its poses, by default rest; rad,
            m, m.
        loads: that hold the mechanism there; they add to its stiffness as they turn.

    Returns:
        A function of loads and drives.

    Raises:
        ValueError: double precision is off, or a name is unknown.

    Example:
        >>> from twistorjax import Body, Hinge, Mechanism, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> mechanism = Mechanism([Body("wall"), Body("block")], [hinge], fixed=["wall"])
        >>> small = linearize(mechanism, driven={"block": ["y"]})
        >>> small(drives=[Drive("block", y=1e-3)]).reaction("block")
        Array([0.  , 0.  , 0.01], dtype=float64)
    """
    require_float64(mechanism.reference)
    mechanism.require_support()
    places = mechanism.coordinates("driven", driven)
    if both := sorted(set(places) & set(mechanism.fixed)):
        raise ValueError(
            f"`driven` has the {_listed(mechanism, both)}, but that is held already."
        )
    free = free_coordinates(len(mechanism.names), mechanism.fixed, places)
    every = DofPartition(tuple(range(3 * len(mechanism.names))), ())
    moved = jnp.zeros_like(mechanism.reference)
    if about is not None:
        moved = within_range(mechanism, "about", about)
    acting = LoadSet.of(loads, loaded_bodies(mechanism, loads), mechanism.reference)
    whole = Problem(mechanism.hinge_assembly, acting, jnp.zeros(0), every)
    _, matrix, _ = whole.matrix(moved)
    rows = np.array(free, int)
    return Linearization(
        mechanism=mechanism,
        about=mechanism.reference + moved,
        matrix=matrix,
        factors=Factors.of(matrix[rows[:, None], rows], whole.symmetric),
        places=DofPartition(free, places),
        finite=jnp.all(jnp.isfinite(matrix)),
    )


def _listed(mechanism: Mechanism, places: Sequence[int]) -> str:
    words = [mechanism.coordinate(place) for place in sorted(places)]
    return " and ".join(words) or "nothing"
