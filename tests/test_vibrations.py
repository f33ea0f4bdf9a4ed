"""Vibrations: against reference frequencies, closed forms, and motion itself."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import four_bar, stage


# By another program in 50 digits; Hz
STAGE = [
    306.1366849, 4719.7317869, 6302.6505985, 9474.0135068, 12316.9615762, 14874.9283712,
]  # fmt: skip
FOUR_BAR = [
    36.3871815, 568.9155405, 681.1718392, 1230.3478384, 1300.4124816, 3078.9487182,
    3578.5604614, 7433.2397532, 9639.3729878,
]  # fmt: skip


def test_the_dissertations_mechanisms_vibrate_as_the_reference_does(validated):
    fixed = tj.vibrations(stage.microstage(), {"6": ["x"]})
    np.testing.assert_allclose(fixed.frequencies[:6], STAGE, rtol=1e-7)
    found = tj.vibrations(four_bar.four_bar())
    np.testing.assert_allclose(found.frequencies, FOUR_BAR, rtol=1e-7)
    oracle = "a derivation of its own, by LAPACK"
    validated("The stage", "six frequencies", fixed.frequencies[:6], STAGE, oracle)
    told = "nine frequencies", found.frequencies, FOUR_BAR, oracle
    validated("Four-bar linkages", *told)
    assert repr(found).startswith("successful: 9 vibrations")


def test_shapes_have_unit_modal_mass_and_no_part_in_one_another():
    linkage = four_bar.four_bar()
    shapes = tj.vibrations(linkage).shapes
    inertia = linkage.inertia()
    weighed = jnp.where(jnp.isinf(inertia), 0.0, inertia)[None] * shapes
    assert_close(jnp.einsum("ibk,jbk->ij", weighed, shapes), jnp.eye(9), digits=9)


def column(load, stiffness=2.0):
    """A rigid rod on a torsion hinge, pressed from above."""
    hinge = tj.Quadratic(jnp.diag(jnp.stack([jnp.asarray(stiffness), *jnp.full(2, 1e7)])))
    rod = tj.Body("rod", pose=(0, 0, 0.5), mass=1e-4, inertia=0.3)
    mechanism = tj.Mechanism(
        [tj.Body("base"), rod], [tj.Hinge("h", "base", "rod", hinge, (0, 0, 0))], ["base"]
    )
    return mechanism, [tj.Load("rod", (0, 0, -load), at=(0, 0.5))]


@pytest.mark.slow
def test_a_pressed_column_slows_down():
    """I w^2 = k - P L, about the hinge."""

    def frequency(load):
        mechanism, loads = column(load)
        solution = tj.equilibrium(mechanism, loads=loads)
        found = tj.vibrations(mechanism, about=solution, loads=loads)
        return found.frequencies[0]

    about_hinge = 0.3 + 1e-4 * 0.5**2
    expected = np.sqrt((2.0 - 1.2) / about_hinge) / (2 * np.pi)
    np.testing.assert_allclose(frequency(1.2), expected, rtol=1e-5)
    slope = jax.grad(frequency)(1.2)
    np.testing.assert_allclose(slope, -expected / (2 * (2.0 - 1.2)), rtol=1e-5)


def test_an_unstable_state_does_not_vibrate():
    mechanism, loads = column(2.1)
    upright = mechanism.reference.at[1, 2].add(-2.1 / 1e7)  # pressed together
    with pytest.raises(RuntimeError, match="releases energy"):
        tj.vibrations(mechanism, about=upright, loads=loads)
    told = tj.vibrations(mechanism, about=upright, loads=loads, throw=False)
    assert not told.succeeded and np.isnan(told.frequencies[0])


def test_loads_that_follow_have_no_vibrations():
    mechanism, _ = column(1.0)
    follower = tj.Load("rod", (0, 0, -1.0), follower=True)
    with pytest.raises(ValueError, match="follower load"):
        tj.vibrations(mechanism, loads=[follower])


def block(damping):
    spring = tj.Quadratic(jnp.diag(jnp.array([1.0, 50.0, 80.0])))
    hinge = tj.Hinge("spring", "wall", "block", spring, (0, 0, 0), damping=damping)
    body = tj.Body("block", mass=2.0, inertia=0.1)
    return tj.Mechanism([tj.Body("wall"), body], [hinge], fixed=["wall"])


def test_the_response_to_a_load_is_the_textbooks():
    time = 0.02
    frequencies = np.array([0.0, 0.5, 0.8, 3.0])
    answer = tj.frequency_response(
        block(time), frequencies, loads=[tj.Load("block", (0, 1.0, 0))]
    )
    omega = 2 * np.pi * frequencies
    expected = 1 / (50 - 2 * omega**2 + 1j * omega * time * 50)
    assert_close(answer.displacement("block")[:, 1], expected, digits=12)
    assert_close(answer.reaction("wall")[:, 1], -expected * 50 * (1 + 1j * omega * time))


def test_the_response_to_a_drive_asks_for_its_force():
    omega = 2 * np.pi * 0.5
    answer = tj.frequency_response(block(0.02), [0.5], drives=[tj.Drive("block", y=1e-3)])
    expected = 1e-3 * (80 - 2 * omega**2 + 1j * omega * 0.02 * 80)
    assert_close(answer.reaction("block")[0, 2], expected)


def test_a_resonance_without_damping_has_no_answer():
    resonance = float(tj.vibrations(block(None)).frequencies[1])
    push = tj.Load("block", (0, 1.0, 1.0))
    with pytest.raises(RuntimeError, match="a resonance without damping"):
        tj.frequency_response(block(None), [1.0, resonance], loads=[push])
    assert tj.frequency_response(block(0.1), [resonance], loads=[push]).succeeded


@pytest.mark.untyped
def test_frequencies_are_a_row():
    with pytest.raises(ValueError, match="must be a row of them"):
        tj.frequency_response(block(0.1), 3.0)


def exact_frequencies(bodies, hinges, inertia, more=None):
    """Frequencies in 60 digits, of bodies on hinges to the ground and to one another; Hz.

    Args:
        bodies: positions of the origins.
        hinges: the two bodies of each, the ground being -1; stiffness; and frame.
        inertia: of each coordinate.
        more: stiffness beside that of the hinges, if any.
    """
    with mpmath.workdps(60):
        size = 3 * len(bodies)
        total = mpmath.zeros(size) if more is None else mpmath.matrix(more.tolist())
        for ends, stiffness, (angle, x, y) in hinges:
            cos, sin = mpmath.cos(angle), mpmath.sin(angle)
            strain = mpmath.zeros(3, size)
            for body, sign in zip(ends, (-1, 1), strict=True):
                if body < 0:
                    continue
                arm = mpmath.mpf(x) - bodies[body][0], mpmath.mpf(y) - bodies[body][1]
                shift = (-arm[1], arm[0]), (1, 0), (0, 1)  # of the hinge, by coordinate
                for k, (dx, dy) in enumerate(shift):
                    strain[0, 3 * body + k] += sign * (k == 0)
                    strain[1, 3 * body + k] += sign * (cos * dx + sin * dy)
                    strain[2, 3 * body + k] += sign * (cos * dy - sin * dx)
            total += strain.T * mpmath.matrix(stiffness.tolist()) * strain
        root = mpmath.diag([1 / mpmath.sqrt(value) for value in inertia])
        squares = mpmath.eigsy(root * total * root, eigvals_only=True)
        return np.array([float(mpmath.sqrt(s) / (2 * mpmath.pi)) for s in squares])


@pytest.mark.slow
@pytest.mark.parametrize("loaded", [False, True])
def test_soft_vibrations_beside_stiff_ones_keep_their_digits(loaded):
    """Stiffness entries 1e16 apart, at angles at which a sum of them loses the soft ones.

    Loads without potential but for a moment that turns with its lever are the simplest
    that stiffen a mechanism which has not moved.
    """
    bodies = [(0.3, -0.2), (1.1, 0.4)]
    stiff = np.diag([1.0, 1e16, 0.5])
    hinges = [
        ((-1, 0), stiff, (0.3, -0.4, 0.7)),
        ((0, 1), stiff, (-1.1, 0.6, 0.2)),
    ]
    inertia = np.array([0.5, 2.0, 2.0, 0.1, 1.0, 1.0])
    mechanism = tj.Mechanism(
        [tj.Body("wall")]
        + [
            tj.Body(str(k), (0.0, *place), mass=mass, inertia=inertia[3 * k])
            for k, (place, mass) in enumerate(zip(bodies, inertia[1::3], strict=True))
        ],
        [
            tj.Hinge(
                str(k), *("wall" if end < 0 else str(end) for end in ends),
                tj.Quadratic(energy), at,
            )
            for k, (ends, energy, at) in enumerate(hinges)
        ],
        fixed=["wall"],
    )  # fmt: skip
    pull, more = [], np.zeros((6, 6))
    if loaded:
        pull = [tj.Load("1", (0.0, 0.2, 0.0), at=(1.5, 0.0))]
        more[3, 3] = 0.3  # moment over angle: force times lever
    exact = exact_frequencies(bodies, hinges, inertia, more)
    found = tj.vibrations(mechanism, loads=pull).frequencies
    assert exact[0] < 1 < 1e6 < exact[-1]
    np.testing.assert_allclose(found, exact, rtol=1e-12)


@pytest.mark.slow
def test_the_sum_of_equal_frequencies_has_second_derivatives():
    """A block on a spring that is alike in both directions, and three changes of it."""

    def both(change):
        x, y, mixed = change
        stiffness = jnp.array([[1e4, 0, 0], [0, 400 + x, mixed], [0, mixed, 400 + y]])
        hinge = tj.Hinge("spring", "wall", "block", tj.Quadratic(stiffness), at=(0, 0, 0))
        block = tj.Body("block", mass=1.0, inertia=0.1)
        mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
        return jnp.sum(tj.vibrations(mechanism).frequencies[:2])

    equal = jnp.zeros(3)
    found = tj.vibrations(block_on(400.0, 400.0)).frequencies
    assert_close(found[0], found[1])
    step = 0.1 * np.eye(3)
    ways = [(a, b) for a in range(3) for b in range(3)]
    corners = jnp.array(
        [
            [s * step[a] + t * step[b] for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
            for a, b in ways
        ]
    )
    at = jax.vmap(jax.vmap(both))(corners)
    differences = (at[:, 0] - at[:, 1] - at[:, 2] + at[:, 3]) / (4 * 0.1**2)
    second = jax.jit(jax.hessian(both))(equal).reshape(-1)
    np.testing.assert_allclose(second, differences, rtol=1e-5, atol=1e-9)


@pytest.mark.slow
def test_terms_that_are_not_positive_by_themselves_are_counted():
    """Couplings without stiffness of their own, and a spring that pushes away."""
    soft = tj.Quadratic(jnp.diag(jnp.array([2.0, 50.0, 30.0])), "twist")
    coupling = tj.energies.Polynomial(
        [5.0, 3.0, 1e-9], [(1, 0, 1), (0, 1, 1), (2, 0, 0)], "twist"
    )
    pushing = tj.energies.Polynomial([-4.0, 1e-12], [(0, 0, 2), (0, 2, 0)], "twist")
    hinge = tj.Hinge("h", "wall", "block", soft + coupling + pushing, at=(0.2, 0.1, 0.3))
    block = tj.Body("block", mass=2.0, inertia=0.1)
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
    stiffness = np.asarray(mechanism.stiffness(mechanism.reference))[1, :, 1]
    root = np.sqrt([0.1, 2.0, 2.0])
    squares = np.linalg.eigvalsh(stiffness / np.outer(root, root))
    exact = np.sqrt(squares) / (2 * np.pi)
    assert_close(tj.vibrations(mechanism).frequencies, exact)


def test_nothing_that_can_vibrate_is_refused():
    with pytest.raises(ValueError, match="No coordinate can vibrate"):
        tj.vibrations(block_on(400.0, 100.0), ["block"])


def block_on(along, across):
    spring = tj.Quadratic(jnp.diag(jnp.array([1e4, along, across])))
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
    block = tj.Body("block", mass=1.0, inertia=0.1)
    return tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
