"""Displacements of the plane as poses and twists, and how wrenches travel with them.

A pose `(angle, x, y)` is one frame as seen from another, or the displacement that
carries the one into the other. A twist is the constant velocity that reaches a pose in
unit time. Sections 2.3 to 2.6 of the dissertation.
"""

import jax.numpy as jnp
from jaxtyping import Array

from .._utils.types import Matrix, Point, Pose, Scalar, Twist, Wrench


def compose(outer: Pose, inner: Pose) -> Pose:
    """The pose of a frame in a frame in a frame: `inner` is seen from `outer`.

    Args:
        outer: the middle frame seen from the first; rad, m, m.
        inner: the last frame seen from the middle one; rad, m, m.

    Returns:
        The last frame seen from the first. As displacements of the plane: `inner` is
        done first, then `outer`.

    Source:
        Equation 2.81 of the dissertation.

    Example:
        >>> quarter = jnp.array([jnp.pi / 2, 1.0, 0.0])
        >>> compose(quarter, quarter)
        Array([3.14159265, 1.        , 1.        ], dtype=float64)
    """
    return _pose(outer[0] + inner[0], act(outer, inner[1:]))


def inverse(pose: Pose) -> Pose:
    """The first frame seen from the second, for the second seen from the first.

    Example:
        >>> inverse(jnp.array([0.0, 1.0, 2.0]))
        Array([-0., -1., -2.], dtype=float64)
    """
    return _pose(-pose[0], -_turn(-pose[0], pose[1:]))


def between(first: Pose, second: Pose) -> Pose:
    """The second frame as seen from the first, for poses seen from a third.

    The translation is the difference of the two positions, so that it loses no digits
    where the frames nearly coincide.

    Example:
        >>> between(jnp.array([0.0, 1.0, 0.0]), jnp.array([0.5, 1.0, 2.0]))
        Array([0.5, 0. , 2. ], dtype=float64)
    """
    return _pose(second[0] - first[0], _turn(-first[0], second[1:] - first[1:]))


def act(pose: Pose, point: Point) -> Point:
    """Where a point of the moved frame lies, seen from the first frame.

    Args:
        pose: the moved frame; rad, m, m.
        point: a point, resolved in the moved frame; m.

    Source:
        Equation 2.81 of the dissertation.

    Example:
        >>> act(jnp.array([jnp.pi / 2, 1.0, 0.0]), jnp.array([2.0, 0.0]))
        Array([1., 2.], dtype=float64)
    """
    return pose[1:] + _turn(pose[0], point)


def exp(twist: Twist) -> Pose:
    """The pose reached by moving with a constant twist for unit time.

    Args:
        twist: angle, and the velocity of the point at the origin; rad, m, m.

    Source:
        Equations 2.91 and 2.92 of the dissertation, as a half-way translation, which
        is smooth at rest. Its Example 2.2 is the example.

    Example:
        >>> exp(jnp.pi / 4 * jnp.array([1.0, 1.0, 1.0]))
        Array([0.78539816, 0.41421356, 1.        ], dtype=float64)
    """
    half = twist[0] / 2
    return _pose(twist[0], sinc(half) * _turn(half, twist[1:]))


def twist(pose: Pose) -> Twist:
    """The constant twist that reaches a pose in unit time: its logarithm.

    It is the translation seen from the frame half way, stretched from the chord of the
    motion's arc to the arc itself. Defined within a full turn, where the arc closes and
    the chord vanishes. Undoes `exp` there.

    Args:
        pose: of an angle strictly between minus and plus a full turn; rad, m, m.

    Source:
        Equations 2.107 and 2.108 of the dissertation, which divide by `1 - cos` of the
        angle and so lose all digits near rest; this form keeps them. Its Example 2.1 is
        the example.

    Example:
        >>> twist(jnp.array([jnp.pi / 6, 2.0, 1.0]))
        Array([0.52359878, 2.21590..., 0.45344...], dtype=float64)
    """
    half = pose[0] / 2
    return _pose(pose[0], _turn(-half, pose[1:]) / sinc(half))


def pole(pose: Pose) -> Point:
    """The point that a displacement leaves where it is: the centre of its rotation.

    Args:
        pose: a displacement that turns; rad, m, m.

    Returns:
        The fixed point, seen from the first frame; infinite for a pure translation,
        whose pole lies at infinity, across the motion.

    Source:
        Equation 2.123 of the dissertation (after McCarthy).

    Example:
        >>> pole(jnp.array([jnp.pi / 3, 2.0, 2 * jnp.sqrt(3)]))  # section 2.7.4
        Array([-2.        ,  3.46410162], dtype=float64)
    """
    half = pose[0] / 2
    along, across = _turn(-half, pose[1:]) / 2
    sine = jnp.sin(half)
    turns = sine != 0
    safe = jnp.where(turns, sine, 1.0)
    # 0 / 0 would be NaN: the pole of no displacement is as far as that of any translation
    return jnp.where(turns, jnp.stack([-across, along]) / safe, jnp.inf)


def adjoint(pose: Pose) -> Matrix:
    """Takes a twist resolved in a frame to the frame from which that frame is seen.

    Args:
        pose: the frame in which the twist is resolved; rad, m, m.

    Returns:
        The matrix `Ad` of `twist_outside = Ad @ twist_inside`.

    Source:
        Equations 3.22 and 3.23 of the dissertation.

    Example:
        >>> adjoint(jnp.array([0.0, 1.0, 2.0])) @ jnp.array([1.0, 0.0, 0.0])
        Array([ 1.,  2., -1.], dtype=float64)
    """
    cos, sin = jnp.cos(pose[0]), jnp.sin(pose[0])
    one, zero = jnp.ones_like(cos), jnp.zeros_like(cos)
    rows = [[one, zero, zero], [pose[2], cos, -sin], [-pose[1], sin, cos]]
    return jnp.stack([jnp.stack(row) for row in rows])


def transform_wrench(pose: Pose, wrench: Wrench) -> Wrench:
    """The wrench about a frame's origin, resolved in the frame that sees it.

    Power does not depend on the observer, so wrenches travel by the inverse transpose
    of the `adjoint` that carries twists.

    Args:
        pose: the frame in which the wrench is resolved; rad, m, m.
        wrench: moment about that frame's origin, and force in its axes; N m, N, N.

    Source:
        Equations 3.58 to 3.60 of the dissertation.

    Example:
        >>> transform_wrench(jnp.array([0.0, 2.0, 0.0]), jnp.array([0.0, 0.0, 3.0]))
        Array([6., 0., 3.], dtype=float64)
    """
    force = _turn(pose[0], wrench[1:])
    return _pose(wrench[0] + _cross(pose[1:], force), force)


def transform_stiffness(pose: Pose, stiffness: Matrix) -> Matrix:
    """A stiffness about a frame's origin, in its axes, as the frame that sees it has it.

    Args:
        pose: the frame in which the stiffness is resolved; rad, m, m.
        stiffness: maps twists to wrenches there; N m/rad, N/rad, N/m.

    Source:
        Equation 3.25 of the dissertation, from the other side: `Ad^-T K Ad^-1`.

    Example:
        >>> leaf = jnp.diag(jnp.array([1.0, 0.0, 10.0]))
        >>> transform_stiffness(jnp.array([0.0, 2.0, 0.0]), leaf)  # 1 + 2 * 2 * 10
        Array([[41.,  0., 20.],
               [ 0.,  0.,  0.],
               [20.,  0., 10.]], dtype=float64)
    """
    back = adjoint(inverse(pose))
    return back.T @ stiffness @ back + 0.0  # no entry prints as minus zero


def sinc(x: Scalar, sine: Scalar | None = None) -> Scalar:
    """`sin(x) / x`, exact to rounding at 0 as elsewhere, with its derivatives.

    Args:
        x: where; rad.
        sine: `sin(x)`, if it is known already.
    """
    near = jnp.abs(x) < 1
    square = jnp.where(near, x, 0.0) ** 2
    series = jnp.zeros_like(square)
    for k in range(11, 0, -1):  # the first term left out, x^24 / 25!, is below rounding
        series = -(1 + series) * square / (2 * k * (2 * k + 1))
    far = jnp.where(near, 1.0, x)
    sine = jnp.sin(far) if sine is None else jnp.where(near, 1.0, sine)
    return jnp.where(near, 1 + series, sine / far)


def _pose(angle: Scalar, translation: Point) -> Pose:
    return jnp.concatenate([angle[None], translation])


def _turn(angle: Scalar, vector: Point) -> Point:
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y = vector[0], vector[1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y])


def _swing(
    arm: Point | tuple[Scalar, Scalar], cos: Array, sin: Array
) -> tuple[Array, Array]:
    """What turning adds to the place of a point, without loss of digits: (R - 1) arm.

    Args:
        arm: from the centre to the point, before; m.
        cos: of half the angle.
        sin: likewise.
    """
    versine, sine = 2 * sin * sin, 2 * sin * cos
    return -versine * arm[0] - sine * arm[1], sine * arm[0] - versine * arm[1]


def _cross(first: Point, second: Point) -> Scalar:
    return first[0] * second[1] - first[1] * second[0]
