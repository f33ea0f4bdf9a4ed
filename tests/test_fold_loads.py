"""Loads of folds against independent computations: derivatives and random mechanisms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from path_helpers import bar, bars_of_a_truss, truss_of
from test_chain import lee_frame

import twistorjax as tj


pytestmark = pytest.mark.release


def loaded_truss(stiffness):
    """Two unequal bars, the second of which is softer; N/m."""
    truss = truss_of(bars_of_a_truss(stiffness, 600.0))
    return truss, {"loads": [tj.Load("apex", force=(1.0, -15.0))]}


def block_on_two_bars(offset):
    """A block that can rotate, with a force beside its middle; m."""
    ends = {
        "a": (np.array([-1.0, 0.1]), np.array([-0.2, 0.4])),
        "b": (np.array([1.0, 0.05]), np.array([0.2, 0.4])),
    }
    hinges = [bar(name, "wall", "block", *each, 900.0) for name, each in ends.items()]
    bend = tj.Quadratic(np.diag([20.0, 3.0, 1.0]), "twist")
    hinges.append(tj.Hinge("bend", "wall", "block", bend, at=(0.0, 0.0, 0.4)))
    bodies = [tj.Body("wall"), tj.Body("block", pose=(0.0, 0.0, 0.4))]
    block = tj.Mechanism(bodies, hinges, fixed=["wall"])
    load = tj.Load("block", force=(0.0, -30.0), at=jnp.stack([offset, 0.0 * offset]))
    return block, {"loads": [load]}


def truss_on_pins(rise):
    """The bars are bodies that are elastic in the middle only, and turn on pins; m."""
    length, angle = jnp.hypot(1.0, rise), jnp.arctan2(rise, 1.0)
    names, quarter = ("lower", "upper"), length / 4
    spring = tj.energies.Quadratic(np.diag([1e4, 500.0, 1e4]), "twist")
    unit = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    foot = jnp.array([-1.0, 0.0])
    bodies = [
        tj.Body("wall"),
        tj.Body("apex", pose=jnp.stack([0.0 * rise, 0.0 * rise, rise])),
    ]
    for k, name in enumerate(names):
        place = foot + (1 + 2 * k) * quarter * unit
        bodies.append(tj.Body(name, pose=jnp.concatenate([angle[None], place])))
    middle = jnp.concatenate([angle[None], foot + 2 * quarter * unit])
    truss = tj.Mechanism(
        bodies,
        [tj.Hinge("middle", *names, spring, at=middle)],
        fixed={"wall": ["angle", "x", "y"], "apex": ["angle", "x"]},
    )
    pins = [
        tj.Pin("foot", "wall", "lower", at=foot),
        tj.Pin("head", "upper", "apex", at=jnp.stack([0.0 * rise, rise])),
    ]
    loads = [tj.Load("apex", force=(0.0, -15.0))]
    return truss, {"loads": loads, "constraints": pins, "load_factors": (-0.2, 1.0)}


def truss_behind_a_spring(stiffness):
    """A displacement is prescribed behind a soft spring, so the truss snaps; N/m."""
    spring = tj.energies.AxialSpring(stiffness, length=1.0)
    hinges = bars_of_a_truss()
    hinges.append(tj.Hinge("spring", "apex", "hand", spring, at=(np.pi / 2, 0.0, 0.8)))
    bodies = [
        tj.Body("wall"),
        tj.Body("apex", pose=(0.0, 0.0, 0.3)),
        tj.Body("hand", pose=(0.0, 0.0, 1.3)),
    ]
    free = {"apex": ["angle"], "hand": ["angle", "x"]}
    whole = tj.Mechanism(bodies, hinges, fixed={"wall": ["angle", "x", "y"], **free})
    return whole, {"drives": [tj.Drive("hand", y=-0.9)]}


def check_derivative_of_fold(build, value):
    """Compare the derivatives of the first fold with difference quotients."""

    @jax.jit
    def fold(value):
        mechanism, arguments = build(value)
        found = tj.path(
            mechanism, max_points=120, max_critical=1, throw=False, **arguments
        )
        point = found.critical_points
        return jnp.append(point.displacements[0].reshape(-1), point.load_factors[0])

    value = jnp.asarray(value)
    derivative = jax.jit(jax.jacfwd(fold))(value)
    assert np.isfinite(derivative).all() and fold(value)[-1] != 1.0
    step = 2e-4 * value
    beyond = [np.asarray(fold(value + k * step)) for k in (-2, -1, 1, 2)]
    quotient = (beyond[0] - 8 * beyond[1] + 8 * beyond[2] - beyond[3]) / (12 * step)
    np.testing.assert_allclose(derivative[-1], quotient[-1], rtol=1e-6)
    size = np.max(np.abs(quotient))
    np.testing.assert_allclose(derivative, quotient, atol=1e-6 * size)


@pytest.mark.parametrize(
    ("build", "value"),
    [
        (loaded_truss, 1000.0),
        (block_on_two_bars, 0.05),
        (truss_on_pins, 0.3),
        (truss_behind_a_spring, 30.0),
    ],
)
def test_the_derivative_of_a_fold_is_its_difference_quotient(build, value):
    check_derivative_of_fold(build, value)


def test_the_derivative_of_the_fold_of_a_frame_is_its_difference_quotient():
    """The load on the frame of Lee is not vertical, and its direction is changed."""
    frame = lee_frame()

    def build(angle):
        force = 2500 * jnp.stack([jnp.sin(angle), -jnp.cos(angle)])
        return frame, {
            "loads": [tj.Load("load", force=force)],
            "load_factors": (-0.1, 1.0),
        }

    check_derivative_of_fold(build, 0.1)


class TestRandomMechanisms:
    """A block on four bars of random places and stiffness, under a random force."""

    COUNT, BARS = 200, 4

    def designs(self):
        random = np.random.default_rng(3)
        shape = (self.COUNT, self.BARS)
        direction = random.uniform(0, 2 * np.pi, shape)
        radius = random.uniform(0.8, 1.5, shape)
        feet = radius[..., None] * np.stack([np.cos(direction), np.sin(direction)], -1)
        ends = random.uniform(-0.3, 0.3, (*shape, 2))
        stiffness = random.uniform(0.5, 2.0, shape)
        side = random.uniform(0, 2 * np.pi, self.COUNT)
        force = 3 * np.stack([np.cos(side), np.sin(side)], -1)
        return feet, ends, stiffness, force

    @staticmethod
    def fold(feet, ends, stiffness, force):
        hinges = [
            bar(f"bar {k}", "wall", "block", feet[k], ends[k], stiffness[k])
            for k in range(len(feet))
        ]
        bodies = [tj.Body("wall"), tj.Body("block")]
        block = tj.Mechanism(bodies, hinges, fixed=["wall"])
        found = tj.path(
            block, loads=[tj.Load("block", force=force)], load_factors=(-1.0, 1.0),
            max_points=150, max_critical=1, throw=False,
        )  # fmt: skip
        return found.critical_points.load_factors[0]

    @staticmethod
    def potential(place, feet, ends, stiffness, force):
        """Energy of the bars without the work of the force, gradient, and Hessian."""
        angle, shift = place[0], place[1:]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        arms = ends @ turn.T
        bars = arms + shift - feet
        length = np.linalg.norm(bars, axis=1)
        natural = np.linalg.norm(ends - feet, axis=1)
        units, stretch = bars / length[:, None], length - natural
        rates = np.zeros((len(feet), 2, 3))
        rates[:, 0, 0], rates[:, 1, 0] = -arms[:, 1], arms[:, 0]
        rates[:, 0, 1] = rates[:, 1, 2] = 1.0
        slopes = np.einsum("ba,bak->bk", units, rates)
        value = np.sum(stiffness * stretch**2) / 2 - force @ shift
        gradient = (stiffness * stretch) @ slopes - np.append(0.0, force)
        across = np.eye(2) - units[:, :, None] * units[:, None]
        bent = np.einsum("bak,bac,bcl->bkl", rates, across, rates) / length[:, None, None]
        bent[:, 0, 0] -= np.sum(units * arms, axis=1)
        parts = slopes[:, :, None] * slopes[:, None] + stretch[:, None, None] * bent
        return value, gradient, np.einsum("b,bkl->kl", stiffness, parts)

    def bisected(self, feet, ends, stiffness, force):
        """Increase the force until the minimum near the last one disappears.

        The step is reduced if the minimum moves far, and finally if it disappears.
        """

        def minimum(start, factor):
            def of(part):
                return lambda place: self.potential(
                    place, feet, ends, stiffness, factor * force
                )[part]

            found = scipy.optimize.minimize(
                of(0), start, jac=of(1), hess=of(2), method="trust-exact",
                options={"gtol": 1e-10, "initial_trust_radius": 0.01,
                         "max_trust_radius": 0.02, "maxiter": 300},
            )  # fmt: skip
            near = np.linalg.norm(found.x - start) < 0.04
            return found.x if near else None

        place, low, step = np.zeros(3), 0.0, 0.01
        while step > max(1e-5 * low, 1e-9):
            found = minimum(place, low + step)
            if found is None:
                step /= 4
            else:
                place, low, step = found, low + step, min(2 * step, 0.01)
                if low > 1.0:
                    return np.nan
        return low

    def test_their_first_folds_agree_with_bisection_by_minimization(self):
        designs = self.designs()
        folds = np.asarray(jax.jit(jax.vmap(self.fold))(*map(jnp.asarray, designs)))
        has_fold = folds > 0
        assert has_fold.sum() > 0.6 * self.COUNT
        exact = np.array(
            [self.bisected(*design) for design in zip(*designs, strict=True)]
        )
        np.testing.assert_array_equal(has_fold, np.isfinite(exact))
        np.testing.assert_allclose(folds[has_fold], exact[has_fold], rtol=1e-4)
