"""Tests on a single hinge of a mechanism."""

import equinox as eqx
import jax
from jaxtyping import Array, Float

from ..._utils.host import as_float, on_host
from ..._utils.types import Table, TrialsLike, WrenchLike
from ..._utils.validation import index_of, require_array, require_deviations
from ...energies.fitting.trials import Trials
from ...mechanism.mechanism import Mechanism
from .measurement import AbstractTest, Measurement


class HingeTest(AbstractTest):
    """Wrenches measured on one hinge alone, at prescribed displacements.

    Args:
        hinge: Name of the hinge in the mechanism.
        poses: Poses of frame b of the hinge relative to its frame a, a row for each
            trial; rad, m, m.
        standard_deviation: Standard deviations of the moment, of the force along axis 1
            and of the force along axis 2, or one for all three; N m, N, N.

    Raises:
        ValueError: A shape is wrong, a pose is not finite, or a standard deviation is
            not positive.

    Example:
        >>> HingeTest("A", poses=[[0.1, 0.0, 0.0]], standard_deviation=(1e-3, 0.1, 0.1))
        HingeTest of A at 1 displacement
    """

    hinge: str = eqx.field(static=True)
    poses: Float[Array, "trials 3"]
    standard_deviation: Float[Array, "3"]

    def __init__(self, hinge: str, poses: TrialsLike, standard_deviation: WrenchLike):
        self.hinge = hinge
        self.poses = require_array(
            "`poses`", poses, (None, 3), "have a row (angle, x, y) for each trial"
        )
        self.standard_deviation = require_deviations(
            "`standard_deviation`", standard_deviation, (3,)
        )

    @classmethod
    def from_trials(cls, hinge: str, trials: Trials) -> Measurement:
        """Convert trials of a single hinge to a measurement.

        Args:
            hinge: Name of the hinge in the mechanism.
            trials: Trials with wrenches.

        Returns:
            The measurement, which `identify` takes.

        Raises:
            ValueError: The trials have no wrenches.
        """
        if trials.wrenches is None or trials.wrench_deviations is None:
            raise ValueError(
                "`trials` has no wrenches, but a `HingeTest` needs measured wrenches."
            )
        test = cls(hinge, trials.poses, trials.wrench_deviations[0])
        return test.measurement(trials.wrenches, trials.wrench_deviations)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the moment and the two forces."""
        return tuple(f"{self.hinge}.{name}" for name in ("moment", "force_1", "force_2"))

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the moment and the two forces."""
        return ("N m", "N", "N")

    @property
    def standard_deviations(self) -> Table:
        """Standard deviations of the readings, equal in all trials; N m, N, N."""
        xp, (row,) = on_host(self.standard_deviation)
        return as_float(xp.broadcast_to(row, self.poses.shape))

    def predict(
        self, mechanism: Mechanism, *, forward: bool = True, throw: bool = True
    ) -> Table:
        del forward, throw
        row = index_of("`hinge`", "hinge", self.hinge, mechanism.hinge_names)
        return jax.vmap(mechanism.hinge_assembly.energy_of(row).wrench)(self.poses)

    def __repr__(self) -> str:
        plural = "s" if len(self.poses) != 1 else ""
        return f"HingeTest of {self.hinge} at {len(self.poses)} displacement{plural}"
