"""One hinge of a mechanism, tried on its own."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .._utils.validation import index_of
from ..energies.fitting.trials import Trials
from ..mechanism.mechanism import Mechanism
from .measurement import AbstractTest, Measurement, so_many_deviations


class HingeTest(AbstractTest):
    """The wrenches that one hinge takes at some displacements, tried on its own.

    Args:
        hinge: its name in the mechanism.
        poses: its frame b seen from its frame a, a row for each trial; rad, m, m.
        deviation: standard deviations of moment, force along axis 1 and along axis 2;
            N m, N, N.

    Example:
        >>> HingeTest("A", [[0.1, 0.0, 0.0]], (1e-3, 0.1, 0.1))
        HingeTest of A at 1 displacement
    """

    hinge: str = eqx.field(static=True)
    poses: Float[Array, "trials 3"]
    deviation: Float[Array, "3"]

    def __init__(
        self,
        hinge: str,
        poses: Float[ArrayLike, "trials 3"] | Sequence[Sequence[ArrayLike]],
        deviation: Float[ArrayLike, "3"] | Sequence[ArrayLike],
    ):
        self.hinge = hinge
        self.poses = jnp.asarray(poses, float)
        if self.poses.ndim != 2 or self.poses.shape[1] != 3:
            raise ValueError(
                f"`poses` has shape {self.poses.shape}, but must have a row (angle, x, "
                "y) for each trial."
            )
        self.deviation = so_many_deviations(deviation, 3)

    @classmethod
    def of(cls, hinge: str, trials: Trials) -> Measurement:
        """Trials of a hinge, as one of a mechanism's.

        Args:
            hinge: its name in the mechanism.
            trials: of it, with wrenches.

        Raises:
            ValueError: the trials have no wrenches.
        """
        if trials.wrenches is None or trials.wrench_deviations is None:
            raise ValueError("`trials` has no wrenches, but a `HingeTest` reads them.")
        test = cls(hinge, trials.poses, trials.wrench_deviations[0])
        return test.measured(trials.wrenches, trials.wrench_deviations)

    @property
    def columns(self) -> tuple[str, ...]:
        """The wrench's entries."""
        return tuple(f"{self.hinge}.{name}" for name in ("moment", "force_1", "force_2"))

    @property
    def units(self) -> tuple[str, ...]:
        """Of the wrench."""
        return ("N m", "N", "N")

    @property
    def deviations(self) -> Float[Array, "rows columns"]:
        """The same for all trials."""
        return jnp.broadcast_to(self.deviation, self.poses.shape)

    def read(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Float[Array, "rows columns"]:
        del forward, throw
        row = index_of("`hinge`", "hinge", self.hinge, mechanism.hinge_names)
        return jax.vmap(mechanism.hinge_assembly.energy_of(row).wrench)(self.poses)

    def __repr__(self) -> str:
        many = "s" if len(self.poses) != 1 else ""
        return f"HingeTest of {self.hinge} at {len(self.poses)} displacement{many}"
