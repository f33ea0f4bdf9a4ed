"""Arch of links that sways to either side, against angles of rigid links."""

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize

import twistorjax as tj


COUNT, RISE, STIFFNESS = 8, 0.5, 1.0


def joints():
    """Places of the joints on a parabola with a span of 2 m, and the slopes of links."""
    x = np.linspace(-1.0, 1.0, COUNT + 1)
    places = np.stack([x, RISE * (1 - x**2)], axis=1)
    sides = np.diff(places, axis=0)
    return places, np.arctan2(sides[:, 1], sides[:, 0]), np.hypot(*sides.T)


def arch_of_links():
    """Rigid links on pins, with springs between the links but not at the supports."""
    places, slopes, _ = joints()
    names = ["wall", *(f"link {k}" for k in range(COUNT)), "wall"]
    bodies = [tj.Body("wall")]
    middles = (places[:-1] + places[1:]) / 2
    for name, slope, middle in zip(names[1:-1], slopes, middles, strict=True):
        bodies.append(tj.Body(name, pose=(slope, *middle)))
    spring = tj.Quadratic(np.diag([STIFFNESS, 0.0, 0.0]), "twist")
    pins, hinges = [], []
    for k, place in enumerate(places):
        first, second, at = names[k], names[k + 1], (0.0, *place)
        pins.append(tj.Pin(f"pin {k}", first, second, at=place))
        if 0 < k < COUNT:
            hinges.append(tj.Hinge(f"spring {k}", first, second, spring, at=at))
    return tj.Mechanism(bodies, hinges, fixed=["wall"]), pins


class Angles:
    """Equilibrium of the arch in the slopes of its links, with a force at the crown.

    The unknowns are the slopes, the two components of the support force, and the force
    at the crown, downward.
    """

    def __init__(self):
        _, self.slopes, self.lengths = joints()
        self.half = np.arange(COUNT) < COUNT // 2
        differences = np.diff(np.eye(COUNT), axis=0)
        self.bending = STIFFNESS * differences.T @ differences

    def balance(self, unknowns):
        """Moments on the links, their derivatives by the slopes, and sides of links."""
        slopes, across, up, force = unknowns[:COUNT], *unknowns[COUNT:]
        x, y = self.lengths * np.cos(slopes), self.lengths * np.sin(slopes)
        upward = up + force * self.half
        moments = self.bending @ (slopes - self.slopes) - across * y + upward * x
        return moments, self.bending - np.diag(across * x + upward * y), x, y

    def equations(self, unknowns):
        moments, _, x, y = self.balance(unknowns)
        return np.array([*moments, np.sum(x) - 2.0, np.sum(y)])

    def lowest_stiffness(self, unknowns):
        """Smallest eigenvalue of the stiffness for motions that the supports allow."""
        _, tangent, x, y = self.balance(unknowns)
        allowed = scipy.linalg.null_space(np.stack([y, x]))
        return np.linalg.eigvalsh(allowed.T @ tangent @ allowed)[0]

    def descent(self, unknowns):
        rise = np.sum((self.lengths * np.sin(unknowns[:COUNT]))[self.half])
        return RISE - rise

    def tilt(self, unknowns):
        """Sum of the slopes at the crown, which vanishes if the arch is symmetric."""
        return unknowns[COUNT // 2 - 1] + unknowns[COUNT // 2]

    def solve(self, quantity, value, guess):
        """Equilibrium at which a quantity has a value."""

        def equations(unknowns):
            return np.append(self.equations(unknowns), quantity(unknowns) - value)

        found = scipy.optimize.root(equations, guess, tol=1e-13)
        assert np.max(np.abs(equations(found.x))) < 1e-10
        return found.x

    def symmetric(self, descent):
        """Symmetric equilibrium, by small steps of the descent of the crown."""
        unknowns = np.array([*self.slopes, 0.0, 0.0, 0.0])
        for value in np.linspace(0.0, descent, 20)[1:]:
            unknowns = self.solve(self.descent, value, unknowns)
        return unknowns

    def critical(self):
        """Symmetric equilibrium at which the stiffness against one motion vanishes."""

        def stiffness(value):
            return self.lowest_stiffness(self.symmetric(value))

        return self.symmetric(scipy.optimize.brentq(stiffness, 0.01, 0.3, xtol=1e-13))


@pytest.mark.release
def test_both_sides_of_the_branch_of_a_symmetric_arch_are_followed():
    (mechanism, pins), angles = arch_of_links(), Angles()
    middle, length = f"link {COUNT // 2 - 1}", joints()[2][COUNT // 2 - 1]
    crown = (length / 2, 0.0)
    push = {
        "loads": [tj.Load(middle, force=(0.0, -10.0), at=crown)],
        "constraints": pins,
        "load_factors": (-0.1, 4.0),
    }
    with pytest.warns(UserWarning, match="`max_critical` is 1"):
        upright = tj.path(mechanism, **push, max_critical=1)
    first = upright.critical_points[0]
    exact = angles.critical()
    assert first.kind == "branch"
    np.testing.assert_allclose(10 * first.load_factor, exact[-1], rtol=1e-8)
    for side in (1, -1):
        swayed = tj.path(
            mechanism, **push, start=first, direction=side,
            until=lambda point: abs(angles.tilt(point.displacements[1:, 0])) - 1.0,
        )  # fmt: skip
        slopes = np.asarray(swayed.poses)[1:, 1:, 0]
        tilts, unknowns = [angles.tilt(each) for each in slopes], exact
        assert abs(tilts[-1]) > 0.9 and np.all(np.diff(np.abs(tilts)) > 0)
        for found, tilt, factor in zip(
            slopes, tilts, swayed.load_factors[1:], strict=True
        ):
            unknowns = angles.solve(angles.tilt, tilt, unknowns)
            np.testing.assert_allclose(found, unknowns[:COUNT], atol=1e-9)
            np.testing.assert_allclose(10 * factor, unknowns[-1], rtol=1e-9)
