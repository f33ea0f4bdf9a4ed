"""Energies that are polynomials or quotients of them: sections 3.6 and 4.7."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, some_poses, some_stiffness

import twistorjax as tj
from twistorjax.geometry import se2, twistors


every_coordinates = pytest.mark.parametrize("coordinates", ["twist", "twistor"])


def some_polynomial(coordinates, order=4, seed=0, scale=0.7, **settings):
    powers = tj.energies.monomials(order, coordinates, **settings)
    rng = np.random.default_rng(seed)
    return tj.energies.Polynomial(
        rng.normal(size=len(powers)), powers, coordinates, scale
    )


def plain(energy, pose):
    """The polynomial as it stands on paper."""
    point = twistors.twistor(pose) if energy.coordinates == "twistor" else se2.twist(pose)
    point = point.at[-2:].divide(energy.scale)
    terms = [jnp.prod(point ** jnp.array(row, float)) for row in energy.powers]
    return jnp.vdot(energy.coefficients, jnp.stack(terms))


def idx4(i1, i2, i3, i4, order):
    """The dissertation's listing, which counts from one."""
    table = np.ones((order + 1, 4), int)
    for j in range(1, 4):
        for i in range(1, order + 1):
            table[i, j] = table[i - 1, j] + table[i, j - 1]
    place, left = 1, order
    for power, column in ((i4, 3), (i3, 2), (i2, 1), (i1, 0)):
        place += sum(table[i - 1, column] for i in range(left + 1, left + 1 - power, -1))
        left -= power
    return place


def test_monomials_stand_in_the_dissertations_order():
    order = 4
    powers = tj.energies.monomials(order, redundant=True)
    for row in itertools.product(range(order + 1), repeat=4):
        if sum(row) <= order:
            assert powers[idx4(*row, order) - 1] == row


def test_without_redundancy_there_are_as_many_as_functions():
    """The rank of all monomials of the twistor, at more points than there are of them."""
    poses = some_poses(3, 90)
    for order, count in ((2, 14), (4, 55)):
        values = [
            jnp.prod(twistors.twistor(pose)[None] ** powers(order), axis=1)
            for pose in poses
        ]
        assert np.linalg.matrix_rank(np.stack(values), 1e-10) == count
        assert len(tj.energies.monomials(order)) == count


def powers(order):
    return jnp.array(tj.energies.monomials(order, redundant=True), float)


@every_coordinates
def test_is_the_sum_of_its_terms_and_so_are_its_derivatives(coordinates):
    energy = some_polynomial(coordinates, 5)
    poses = 0.5 * some_poses(1, 12)[8:]
    for derivative in (lambda f: f, jax.grad, jax.hessian):
        actual = jax.vmap(derivative(energy))(poses)
        expected = jax.vmap(derivative(lambda pose: plain(energy, pose)))(poses)
        assert_close(actual, expected, digits=9)


def test_derivatives_by_coefficients_are_the_monomials():
    pose = jnp.array([0.4, 0.2, -0.3])
    energy = some_polynomial("twistor", 3)

    def stored_energy(coefficients):
        return tj.energies.Polynomial(coefficients, energy.powers, scale=energy.scale)(
            pose
        )

    point = twistors.twistor(pose).at[2:].divide(energy.scale)
    expected = jnp.prod(point[None] ** jnp.array(energy.powers, float), axis=1)
    assert_close(jax.grad(stored_energy)(energy.coefficients), expected)


@every_coordinates
def test_of_second_order_it_can_be_the_quadratic_one(coordinates):
    matrix = some_stiffness(2)
    names = range(1, 4) if coordinates == "twistor" else range(3)
    factor = 2.0 if coordinates == "twistor" else 0.5
    terms = {}
    for i, j in itertools.product(range(3), repeat=2):
        row = [0] * (4 if coordinates == "twistor" else 3)
        row[names[i]] += 1
        row[names[j]] += 1
        terms[tuple(row)] = terms.get(tuple(row), 0.0) + factor * float(matrix[i, j])
    energy = tj.energies.Polynomial(list(terms.values()), list(terms), coordinates)
    poses = some_poses(4)
    expected = jax.vmap(tj.Quadratic(matrix, coordinates))(poses)
    assert_close(jax.vmap(energy)(poses), expected, digits=10)


def test_is_a_polynomial_from_any_two_frames():
    """Equation 4.70: each body may be seen from another frame of its own."""
    energy = some_polynomial("twistor", 4)
    frames = (some_poses(seed, 9)[7:] for seed in (5, 6, 7))
    for first, second, pose in zip(*frames, strict=True):
        seen = energy.seen_from(first, second)
        inside = se2.compose(se2.compose(se2.inverse(first), pose), second)
        assert_close(seen(inside), energy(pose), digits=8)
        assert seen.powers == tj.energies.monomials(4)


@every_coordinates
def test_is_a_polynomial_from_frames_that_coincide_at_rest(coordinates):
    """Equations 3.69 and 4.70."""
    energy = some_polynomial(coordinates, 3)
    moved, pose = jnp.array([0.7, 0.4, -0.2]), jnp.array([-0.9, 0.1, 0.6])
    inside = se2.compose(se2.compose(se2.inverse(moved), pose), moved)
    assert_close(energy.seen_from(moved)(inside), energy(pose), digits=10)


SYMMETRIES = {
    "mirror": lambda pose: pose * jnp.array([-1.0, 1.0, -1.0]),
    "ends": lambda pose: se2.inverse(pose) * jnp.array([1.0, -1.0, -1.0]),
    "exchange": se2.inverse,
    "sign": lambda pose: pose + jnp.array([2 * jnp.pi, 0.0, 0.0]),
}


@pytest.mark.parametrize("kind", SYMMETRIES)
@every_coordinates
def test_a_symmetry_leaves_the_energy_alone(coordinates, kind):
    """The mirror across axis 1; the other end, half a turn on; exchanged; a turn on."""
    if (kind, coordinates) == ("sign", "twist"):
        pytest.skip("the twist has no sign")
    energy = some_polynomial(coordinates, 5, symmetry=[kind])
    whole = some_polynomial(coordinates, 5)
    assert 0 < len(energy.powers) < len(whole.powers)
    poses = 0.3 * some_poses(8, 20)[7:]
    image = jax.vmap(SYMMETRIES[kind])(poses)
    assert_close(jax.vmap(energy)(image), jax.vmap(energy)(poses), digits=10)
    assert np.max(np.abs(jax.vmap(whole)(image) - jax.vmap(whole)(poses))) > 0.1


def test_a_denominator_of_squares_has_no_zero():
    rng = np.random.default_rng(0)
    powers = tj.energies.monomials(2)
    squares = tj.energies.SumOfSquares(rng.normal(size=(3, len(powers))), powers)
    values = jax.vmap(squares)(some_poses(9, 200))
    assert jnp.min(values) >= 1.0
    energy = tj.energies.Rational(some_polynomial("twistor", 2), squares)
    pose = jnp.array([0.3, 0.2, 0.1])
    assert_close(energy(pose), energy.numerator(pose) / squares(pose))
    step = 1e-6 * jnp.eye(3)
    slope = jax.vmap(lambda d: energy(pose + d) - energy(pose - d))(step) / 2e-6
    assert_close(jax.grad(energy)(pose), slope, digits=8)


@pytest.mark.parametrize("name", ["polynomial", "rational"])
def test_is_a_hinge_of_a_mechanism(name):
    """Under a load it rests where the hinge's wrench is the load's."""
    powers = ((0, 2, 0, 0), (0, 0, 2, 0), (0, 0, 0, 2), (0, 4, 0, 0), (0, 2, 0, 2))
    energy = tj.energies.Polynomial([2.0, 30.0, 9.0, 1.0, 20.0], powers)
    if name == "rational":
        energy = tj.energies.Rational(
            energy, tj.energies.SumOfSquares([[0.3]], [(0, 0, 0, 1)])
        )
    bodies = [tj.Body("wall"), tj.Body("block")]
    hinge = tj.Hinge("hinge", "wall", "block", energy, at=(0, 0, 0))
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    solution = tj.equilibrium(mechanism, loads=[tj.Load("block", (0.3, 1.0, 2.0))])
    pose = solution.pose("block")
    assert jnp.abs(pose[0]) > 0.05
    wrench = jax.grad(energy)(pose)
    assert_close(wrench, jnp.array([0.3, 1.0, 2.0]), digits=8)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tj.energies.Polynomial([1.0], [(0, 2)]), "must be 4 whole numbers"),
        (
            lambda: tj.energies.Polynomial([1.0], [(0, -1, 0, 0)]),
            "must be 4 whole numbers",
        ),
        (
            lambda: tj.energies.Polynomial([1.0, 2.0], [(0, 2, 0, 0)]),
            "there are 1 `powers`",
        ),
        (
            lambda: tj.energies.Polynomial([1.0, 2.0], 2 * [(0, 2, 0, 0)]),
            "more than once",
        ),
        (
            lambda: tj.energies.Polynomial([np.nan], [(0, 2, 0, 0)]),
            "powers (0, 2, 0, 0) is not",
        ),
        (
            lambda: tj.energies.Polynomial([1.0], [(2, 0, 0)], "polar"),
            "'twist', 'twistor'",
        ),
        (
            lambda: tj.energies.Polynomial([1.0], [(0, 2, 0, 0)], scale=0.0),
            "must be positive",
        ),
        (lambda: tj.energies.monomials(-1), "a whole number from 0 on"),
        (lambda: tj.energies.monomials(2, symmetry=["round"]), "'mirror', 'ends'"),
        (
            lambda: tj.energies.monomials(2, "twist", symmetry=["sign"]),
            "of the twistor alone",
        ),
        (lambda: tj.energies.SumOfSquares([[1.0]], [(0, 2, 0, 0)] * 2), "more than once"),
    ],
)
def test_bad_input_is_told(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert message in str(error.value)


def test_the_symmetry_of_a_leaf_may_stand_in_a_list():
    assert tj.energies.monomials(4, symmetry=["leaf"]) == tj.energies.monomials(
        4, symmetry="leaf"
    )
    both = tj.energies.monomials(4, "tension", symmetry=["leaf", "exchange"])
    assert both == tj.energies.monomials(
        4, "tension", symmetry=["mirror", "ends", "exchange"]
    )
