"""A published bistable leaf of rubber, pushed sideways beyond its branch point.

The forces are those of two such leaves, from the data of "Stable propagation of
mechanical signals in soft media using stored elastic energy" (PNAS 113, 2016), published
by Daraio-lab as Neel-Bistable in 2019 under CC BY 4.0.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate
import scipy.optimize

import twistorjax as tj


pytestmark = pytest.mark.slow
LENGTH, THICKNESS, WIDTH, MODULUS = 6.93e-3, 7e-3 / 13, 5e-3, 0.6e6
STROKE = 6e-3  # at the load factor 1; m
# Displacements (mm) and forces (N) of the published simulation, by the angle (degrees)
PUBLISHED = {
    22.2: [
        (0.1876, 0.0115329),
        (1.0126, 0.0161088),
        (1.9876, 0.00657158),
        (3.0001, -0.00399392),
        (4.0126, 0.00324138),
        (4.9876, 0.0462854),
    ],
    32.3: [
        (0.1876, 0.0236180),
        (1.0126, 0.0280354),
        (1.9876, 0.0193672),
        (3.0001, 0.00834006),
        (4.0126, -0.00370342),
        (4.9876, -0.00910082),
    ],
}


def end_of(angle):
    """Return the direction of the leaf (rad), and the position of its pushed end (m)."""
    direction = angle - jnp.pi / 2
    end = LENGTH * jnp.stack([jnp.cos(direction), jnp.sin(direction)])
    return direction, end


def pushed_leaf(angle):
    """Return a leaf between a wall and a tip that moves along x only."""
    rubber = tj.Material(modulus=MODULUS, poisson=0.0)
    beam = tj.flexures.Beam(
        rubber, length=LENGTH, thickness=THICKNESS, width=WIDTH, shear_factor=None
    )
    direction, end = end_of(angle)
    pose = jnp.concatenate([direction[None], end / 2])
    leaf = tj.flexures.chain(
        "leaf", beam, "wall", "tip", pose, segments=12, rotation=1.5, force=0.08
    )
    tip = tj.Body("tip", jnp.concatenate([jnp.zeros(1), end]))
    return tj.Mechanism(
        [tj.Body("wall"), tip, *leaf.bodies],
        leaf.hinges,
        fixed={"wall": ["angle", "x", "y"], "tip": ["angle", "y"]},
    )


def followed(angle, **settings):
    push = tj.Drive("tip", x=-STROKE)
    return tj.path(pushed_leaf(angle), drives=[push], **settings)


def displacements_and_forces(path):
    """Return the displacements of the tip (mm), and the forces of two leaves (N)."""
    displacements = -1e3 * np.asarray(path.displacement("tip"))[:, 1]
    return displacements, -2 * np.asarray(path.reactions)[:, 1, 1]


class Elastica:
    """The extensible elastica, by shooting from the wall with Runge-Kutta steps."""

    steps = 120

    def __init__(self, angle):
        direction, end = end_of(angle)
        self.direction, self.end = float(direction), np.asarray(end) / LENGTH

    def gap(self, load, displacement):
        """Return how far the end is from where it must be, and its derivatives.

        The load is the moment at the wall over E I / L, and the force over E I / L^2. The
        displacement is in m.
        """
        slenderness = 12 * (LENGTH / THICKNESS) ** 2  # E A L^2 / E I
        # The derivatives are those of complex steps.
        steps = 1e-30j * np.concatenate([np.zeros((3, 1)), np.eye(3)], axis=1)
        moment, force_x, force_y = load[:, None] + steps

        def rate(state):
            angle, x, y = state
            cos, sin = np.cos(angle), np.sin(angle)
            stretch = 1 + (force_x * cos + force_y * sin) / slenderness
            bending = moment - force_y * x + force_x * y
            return np.stack([bending, stretch * cos, stretch * sin])

        state, h = np.zeros((3, 4), complex), 1 / self.steps
        state[0] = self.direction
        for _ in range(self.steps):
            k1 = rate(state)
            k2 = rate(state + h / 2 * k1)
            k3 = rate(state + h / 2 * k2)
            k4 = rate(state + h * k3)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        x, y = self.end
        gap = np.real(state[:, 0]) - [self.direction, x - displacement / LENGTH, y]
        return gap, np.imag(state[:, 1:]) / 1e-30

    def load(self, displacement, load):
        """Return the load at a displacement, from a load that is near."""
        for _ in range(20):
            gap, stiffness = self.gap(load, displacement)
            load = load - np.linalg.solve(stiffness, gap)
            if np.max(np.abs(gap)) < 1e-13:
                break
        return load

    def branch_point(self):
        """Return the displacement (mm) and the force of two leaves (N) there."""
        load, low, step = np.zeros(3), 1e-6, 0.05e-3

        def determinant(displacement):
            loaded = self.load(displacement, load)
            return np.linalg.det(self.gap(loaded, displacement)[1])

        sign = np.sign(determinant(low))
        while np.sign(determinant(low + step)) == sign:
            low += step
            load = self.load(low, load)
        at = scipy.optimize.brentq(determinant, low, low + step, xtol=1e-14)
        stiffness = MODULUS * WIDTH * THICKNESS**3 / 12
        return 1e3 * at, -2 * stiffness / LENGTH**2 * self.load(at, load)[1]


@pytest.mark.parametrize("angle", PUBLISHED)
def test_the_leaf_snaps_along_another_branch_as_published(angle, validated, pictured):
    """It buckles between its ends, and the branches join again at the second point."""
    path = followed(np.radians(angle), load_factors=(0.0, 1.0), throw=False)
    first, second = path.critical_points[0], path.critical_points[1]
    branch = followed(
        np.radians(angle),
        load_factors=(0.0, float(second.load_factor) - 1e-4),
        start=first,
        largest_step=0.05,
    )
    points = [1e3 * STROKE * float(point.load_factor) for point in (first, second)]
    displacements, forces = displacements_and_forces(branch)
    expected = Elastica(np.radians(angle)).branch_point()
    found = points[0], forces[0]
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    name = f"rubber leaf at {angle}°"
    validated(
        "Published mechanisms",
        f"{name}, displacement and force of the branch point",
        np.array(found) / expected,
        np.ones(2),
        "the extensible elastica, by shooting",
    )
    straight = scipy.interpolate.CubicSpline(*displacements_and_forces(path))
    buckled = scipy.interpolate.CubicSpline(displacements, forces)
    at, published = np.array(PUBLISHED[angle]).T
    is_buckled = (at > points[0]) & (at < points[1])
    computed = np.where(is_buckled, buckled(at), straight(at))
    largest = np.max(np.abs(published))
    np.testing.assert_allclose(computed, published, rtol=0, atol=5e-3 * largest)
    validated(
        "Published mechanisms",
        f"{name}, forces before and after both branch points",
        computed,
        published,
        "a published simulation (Neel-Bistable)",
    )
    pictured(
        "Published mechanisms",
        "bistable-leaf",
        "Force of two rubber leaves. They leave the dashed path at a branch point.",
        ("displacement (mm)", "force (N)"),
        {
            f"{angle}°": (displacements, forces),
            f"{angle}°, not buckled (dashed)": displacements_and_forces(path),
        },
        {
            "published simulation": (at, published),
            "branch point of the elastica": expected,
        },
    )


def test_the_derivative_of_the_snap_force_by_the_angle(validated):
    def snap_force(angle):
        path = followed(angle, load_factors=(0.0, 0.08), max_points=30, max_critical=1)
        return -2 * path.critical_points.reactions[0, 1, 1]

    angle, step = np.radians(22.2), 2e-3
    derivative = jax.grad(snap_force)(angle)
    sides = [Elastica(angle + sign * step).branch_point()[1] for sign in (1, -1)]
    expected = (sides[0] - sides[1]) / (2 * step)
    np.testing.assert_allclose(derivative, expected, rtol=3e-4)
    validated(
        "Published mechanisms",
        "rubber leaf at 22.2°, derivative of the snap force by the angle",
        derivative,
        expected,
        "differences of the extensible elastica",
    )
