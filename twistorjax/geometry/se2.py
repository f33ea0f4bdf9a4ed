"""Poses and twists: rigid displacements of the plane, and transformations of wrenches.

A pose `(angle, x, y)` is the orientation and the position of a moving frame relative to a
fixed frame. It is also the displacement that moves the fixed frame onto the moving frame.
A twist is the constant velocity that produces a displacement in unit time. Sections 2.3
to 2.6 of the dissertation.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp

from .._utils.types import AnyArray, Arm, Matrix, Point, Pose, Scalar, Twist, Wrench


@jax.jit
def compose(outer: Pose, inner: Pose) -> Pose:
    """Compose two poses.

    Args:
        outer: Pose of the second frame relative to the first; rad, m, m.
        inner: Pose of the third frame relative to the second; rad, m, m.

    Returns:
        The pose of the third frame relative to the first; rad, m, m. As a displacement of
        the plane, it applies `inner` first and then `outer`.

    Source:
        Equation 2.81 of the dissertation.

    Example:
        >>> step = jnp.array([jnp.pi / 2, 1.0, 0.0])  # 1 m along x, and 90 degrees
        >>> compose(step, step)
        Array([3.14159265, 1.        , 1.        ], dtype=float64)
    """
    return _join(outer[0] + inner[0], act(outer, inner[1:]))


@jax.jit
def inverse(pose: Pose) -> Pose:
    """Invert a pose.

    Args:
        pose: Pose of the second frame relative to the first; rad, m, m.

    Returns:
        The pose of the first frame relative to the second; rad, m, m.

    Example:
        >>> inverse(jnp.array([0.0, 1.0, 2.0]))
        Array([-0., -1., -2.], dtype=float64)
    """
    return _join(-pose[0], -rotate(-pose[0], pose[1:]))


@jax.jit
def between(first: Pose, second: Pose) -> Pose:
    """Compute the pose of one frame relative to another.

    The difference of the two positions is formed first. The result is therefore accurate
    also if the two frames nearly coincide.

    Args:
        first: Pose of the first frame relative to a common frame; rad, m, m.
        second: Pose of the second frame relative to the same common frame; rad, m, m.

    Returns:
        The pose of the second frame relative to the first; rad, m, m.

    Example:
        >>> between(jnp.array([0.0, 1.0, 0.0]), jnp.array([0.5, 1.0, 2.0]))
        Array([0.5, 0. , 2. ], dtype=float64)
    """
    return _join(second[0] - first[0], rotate(-first[0], second[1:] - first[1:]))


@jax.jit
def act(pose: Pose, point: Point) -> Point:
    """Transform a point from the moving frame to the fixed frame.

    Args:
        pose: Pose of the moving frame relative to the fixed frame; rad, m, m.
        point: Coordinates of the point in the moving frame; m.

    Returns:
        The coordinates of the point in the fixed frame; m.

    Source:
        Equation 2.81 of the dissertation.

    Example:
        >>> pose = jnp.array([jnp.pi / 2, 1.0, 0.0])
        >>> act(pose, jnp.array([2.0, 0.0]))
        Array([1., 2.], dtype=float64)
    """
    return pose[1:] + rotate(pose[0], point)


@jax.jit
def exp(twist: Twist) -> Pose:
    """Compute the pose that a constant twist reaches in unit time.

    Args:
        twist: Rotation, and velocity of the point at the origin; rad, m, m.

    Returns:
        The pose; rad, m, m. Its angle is not wrapped.

    Source:
        Equations 2.91 and 2.92 of the dissertation. They are written here with the
        translation in the mid-frame, which is smooth at zero rotation. The example is
        Example 2.2 of the dissertation.

    Example:
        >>> exp(jnp.pi / 4 * jnp.array([1.0, 1.0, 1.0]))
        Array([0.78539816, 0.41421356, 1.        ], dtype=float64)
    """
    half = twist[0] / 2
    return _join(twist[0], sinc(half) * rotate(half, twist[1:]))


@jax.jit
def twist(pose: Pose) -> Twist:
    """Compute the constant twist that reaches a pose in unit time.

    The twist is the logarithm of the pose, the inverse of `exp`. Its first entry is the
    angle of the pose. Its other entries are the translation of the pose, resolved in the
    mid-frame, times the ratio of the length of an arc to that of its chord: a constant
    twist moves the origin of the frame along a circular arc, and the translation is the
    chord of this arc. At an angle of 2 pi the arc is a closed circle, the chord is zero,
    and the twist is not defined.

    Args:
        pose: Pose with an angle strictly between -2 pi and 2 pi; rad, m, m.

    Returns:
        The twist; rad, m, m.

    Source:
        Equations 2.107 and 2.108 of the dissertation divide by `1 - cos(angle)`, which
        loses all digits at small angles. The form used here is accurate at any angle. The
        example is Example 2.1 of the dissertation.

    Example:
        >>> twist(jnp.array([jnp.pi / 6, 2.0, 1.0]))
        Array([0.52359878, 2.21590..., 0.45344...], dtype=float64)
    """
    half = pose[0] / 2
    return _join(pose[0], rotate(-half, pose[1:]) / sinc(half))


@jax.jit
def pole(pose: Pose) -> Point:
    """Compute the pole of a displacement: its fixed point, the center of its rotation.

    Args:
        pose: The displacement; rad, m, m.

    Returns:
        The pole in the fixed frame; m. It is infinite for a pure translation.

    Source:
        Equation 2.123 of the dissertation (after McCarthy). The example is from its
        section 2.7.4.

    Example:
        >>> pole(jnp.array([jnp.pi / 3, 2.0, 2 * jnp.sqrt(3)]))
        Array([-2.        ,  3.46410162], dtype=float64)
    """
    half = pose[0] / 2
    along, across = rotate(-half, pose[1:]) / 2
    sine = jnp.sin(half)
    rotates = sine != 0
    safe = jnp.where(rotates, sine, 1.0)
    # The identity would give 0 / 0 = NaN; its pole is infinite, as for any translation.
    return jnp.where(rotates, jnp.stack([-across, along]) / safe, jnp.inf)


@jax.jit
def adjoint(pose: Pose) -> Matrix:
    """Compute the matrix that transforms a twist to another frame of reference.

    Args:
        pose: Pose of the moving frame relative to the fixed frame; rad, m, m.

    Returns:
        The matrix `Ad` of `twist_in_fixed_frame = Ad @ twist_in_moving_frame`.

    Source:
        Equations 3.22 and 3.23 of the dissertation.

    Example:
        >>> pose = jnp.array([0.0, 1.0, 2.0])
        >>> rotation = jnp.array([1.0, 0.0, 0.0])  # about the origin of the moving frame
        >>> adjoint(pose) @ rotation
        Array([ 1.,  2., -1.], dtype=float64)
    """
    cos, sin = jnp.cos(pose[0]), jnp.sin(pose[0])
    one, zero = jnp.ones_like(cos), jnp.zeros_like(cos)
    rows = [[one, zero, zero], [pose[2], cos, -sin], [-pose[1], sin, cos]]
    return jnp.stack([jnp.stack(row) for row in rows])


@jax.jit
def transform_wrench(pose: Pose, wrench: Wrench) -> Wrench:
    """Transform a wrench from the moving frame to the fixed frame.

    Power does not depend on the frame of reference. Wrenches are therefore transformed by
    the inverse transpose of the `adjoint`.

    Args:
        pose: Pose of the moving frame relative to the fixed frame; rad, m, m.
        wrench: Moment about the origin of the moving frame, and force in its axes;
            N m, N, N.

    Returns:
        The moment about the origin of the fixed frame, and the force in its axes;
        N m, N, N.

    Source:
        Equations 3.58 to 3.60 of the dissertation.

    Example:
        >>> pose = jnp.array([0.0, 2.0, 0.0])
        >>> transverse_force = jnp.array([0.0, 0.0, 3.0])
        >>> transform_wrench(pose, transverse_force)
        Array([6., 0., 3.], dtype=float64)
    """
    force = rotate(pose[0], wrench[1:])
    return _join(wrench[0] + cross(pose[1:], force), force)


@jax.jit
def transform_stiffness(pose: Pose, stiffness: Matrix) -> Matrix:
    """Transform a stiffness matrix from the moving frame to the fixed frame.

    Args:
        pose: Pose of the moving frame relative to the fixed frame; rad, m, m.
        stiffness: Stiffness matrix in the moving frame, which maps twists to wrenches;
            N m/rad, N/rad, N/m.

    Returns:
        The stiffness matrix in the fixed frame; N m/rad, N/rad, N/m.

    Source:
        `Ad^-T K Ad^-1`, the inverse of equation 3.25 of the dissertation.

    Example:
        >>> pose = jnp.array([0.0, 2.0, 0.0])
        >>> stiffness = jnp.diag(jnp.array([1.0, 0.0, 10.0]))
        >>> transform_stiffness(pose, stiffness)  # rotation: 1 + 10 * 2**2
        Array([[41.,  0., 20.],
               [ 0.,  0.,  0.],
               [20.,  0., 10.]], dtype=float64)
    """
    back = adjoint(inverse(pose))
    return back.T @ stiffness @ back + 0.0  # The sum turns entries of -0.0 into 0.0.


def sinc(x: Scalar, cos: Scalar | None = None, sin: Scalar | None = None) -> Scalar:
    """Compute `sin(x) / x` and its derivatives to rounding accuracy, also at zero.

    Args:
        x: Argument; rad.
        cos: Cosine of `x`, if it is already known.
        sin: Sine of `x`, if it is already known.

    Returns:
        The quotient; 1 at zero.
    """
    cos = jnp.cos(x) if cos is None else cos
    sin = jnp.sin(x) if sin is None else sin
    return _sinc_derivative(0, x, cos, sin)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _sinc_derivative(order: int, x: Scalar, cos: Scalar, sin: Scalar) -> Scalar:
    """Compute a derivative of `sin(x) / x`, whose derivative is this function again.

    Derivatives of the series by JAX would be several times as long.
    """
    return _evaluate_sinc_derivative(order, x, cos, sin)


@_sinc_derivative.defjvp
def _(order, primals, tangents):
    slope = _sinc_derivative(order + 1, *primals)
    return _sinc_derivative(order, *primals), slope * tangents[0]


@partial(jax.jit, static_argnums=0)  # traced once for each order
def _evaluate_sinc_derivative(order: int, x: Scalar, cos: Scalar, sin: Scalar) -> Scalar:
    """Compute it from the series if x is small; see `_sinc_derivative`."""
    near = jnp.abs(x) < 1
    # The first omitted term, of degree 22 or more, is below rounding.
    first = (order + 1) // 2
    coefficients = [
        (-1) ** n / ((2 * n + 1) * math.factorial(2 * n - order))
        for n in range(first, first + 11)
    ]
    square = x * x
    series = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        series = series * square + coefficient
    series = series * x if order % 2 else series
    # The derivative of `x sinc(x) = sin(x)`.
    far = jnp.where(near, 1.0, x)
    quotient = sin / far
    for k in range(1, order + 1):
        derivative = (sin, cos, -sin, -cos)[k % 4]
        quotient = (derivative - k * quotient) / far
    return jnp.where(near, series, quotient)


def rotate(angle: Scalar, vector: Point) -> Point:
    """Rotate a vector.

    Args:
        angle: Angle of the rotation, positive counterclockwise; rad.
        vector: The vector, in any unit.

    Returns:
        The rotated vector, in the same unit.
    """
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y = vector[0], vector[1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y])


def rotation_displacement(
    arm: Arm, cos: AnyArray, sin: AnyArray
) -> tuple[AnyArray, AnyArray]:
    """Compute the displacement `(R - 1) arm` of a point that rotates about a center.

    It is computed from the half angle, because `cos(angle) - 1` loses digits at small
    angles.

    Args:
        arm: Vector from the center to the point before the rotation; m.
        cos: Cosine of half the angle of rotation.
        sin: Sine of half the angle of rotation.

    Returns:
        The two components of the displacement; m.
    """
    versine, sine = 2 * sin * sin, 2 * sin * cos
    return -versine * arm[0] - sine * arm[1], sine * arm[0] - versine * arm[1]


def cross(first: Point, second: Point) -> Scalar:
    """Compute the cross product of two plane vectors, such as the moment of a force.

    Args:
        first: First vector, for example the lever arm; m.
        second: Second vector, for example the force; N.

    Returns:
        The out-of-plane component, in the product of the two units; N m for a moment.
    """
    return first[0] * second[1] - first[1] * second[0]


def _join(angle: Scalar, vector: Point) -> Pose:
    """Join an angle (or a moment) and a vector to a pose, a twist or a wrench."""
    return jnp.concatenate([angle[None], vector])
