"""What trials tell of an energy by turn, translation across and tension; see `MixedEnergy`.

The tension of a trial is known from its wrench. So the moment, the transverse force and
the length, which are derivatives of W, are linear in its coefficients.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._utils.types import Matrix, Pose, Scalar, Twist
from ...geometry import se2
from ..monomials import Powers, raised


class Terms(NamedTuple):
    """What each term adds, for a coefficient of one.

    Args:
        moment: to the slope of the energy by the turn; J/rad.
        shear: to that by the translation across; N.
        length: to the translation along; m.
        give: to its growth with the tension; m/N.
        leaning: of `moment` and `shear` with the tension; J/rad/N and -.
        energy: to W; J.
    """

    moment: Float[Array, "trials terms"]
    shear: Float[Array, "trials terms"]
    length: Float[Array, "trials terms"]
    give: Float[Array, "trials terms"]
    leaning: tuple[Float[Array, "trials terms"], Float[Array, "trials terms"]]
    energy: Float[Array, "trials terms"]


@partial(jax.jit, static_argnums=0)
def terms(
    powers: Powers,
    twists: Float[Array, "trials 3"],
    tensions: Float[Array, " trials"],
    length: Scalar | float,
    force: Scalar | float,
) -> Terms:
    """Each term of W at twists and tensions.

    Args:
        powers: of turn, translation across over `length`, and tension over `force`.
        twists: rad, m, m.
        tensions: N.
        length: m.
        force: N.
    """
    turns, _, across = twists.T
    exponents = np.array(powers)
    (t, dt, _), (y, dy, _), (n, dn, ddn) = (
        raised(values, exponents[:, k])
        for k, values in enumerate((turns, across / length, tensions / force))
    )
    return Terms(
        moment=dt * y * n,
        shear=t * dy * n / length,
        length=-t * y * dn / force,
        give=-t * y * ddn / force**2,
        leaning=(dt * y * dn / force, t * dy * dn / (length * force)),
        energy=t * y * n,
    )


def by_twist(pose: Pose) -> tuple[Twist, Matrix]:
    """The twist, and what makes the energy's slopes by it of the wrench.

    The second of these slopes is the tension.
    """
    twist = se2.twist(pose)
    turned = jax.vmap(lambda row: se2._turn(-pose[0], row))
    by_pose = jax.jacfwd(se2.exp)(twist)
    in_b = jnp.concatenate([by_pose[:1], turned(by_pose[1:].T).T])
    return twist, in_b.T
