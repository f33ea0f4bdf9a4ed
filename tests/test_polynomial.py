"""Polynomial and rational energies (sections 3.6 and 4.7 of the dissertation)."""

import itertools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, for_each, mostly_slow, some_poses, some_stiffness

import twistorjax as tj
from twistorjax.energies.evaluation import polynomial_derivatives
from twistorjax.geometry import se2, twistors


every_coordinates = pytest.mark.parametrize("coordinates", ["twist", "twistor"])


def random_polynomial(coordinates, order=4, seed=0, scale=0.7, **settings):
    powers = tj.energies.monomials(order, coordinates, **settings)
    rng = np.random.default_rng(seed)
    return tj.energies.Polynomial(
        rng.normal(size=len(powers)), powers, coordinates, scale
    )


def sum_of_terms(energy, pose):
    """The polynomial, as the sum of products of powers."""
    twistor = energy.coordinates == "twistor"
    variables = twistors.twistor(pose) if twistor else se2.twist(pose)
    variables = variables.at[-2:].divide(energy.scale)
    terms = jnp.prod(variables[None] ** np.array(energy.powers, float), axis=1)
    return jnp.vdot(energy.coefficients, terms)


def idx4(i1, i2, i3, i4, order):
    """Position of a monomial, counted from one: listing `idx4` of the dissertation."""
    table = np.ones((order + 1, 4), int)
    for j in range(1, 4):
        for i in range(1, order + 1):
            table[i, j] = table[i - 1, j] + table[i, j - 1]
    position, remaining = 1, order
    for power, column in ((i4, 3), (i3, 2), (i2, 1), (i1, 0)):
        position += sum(
            table[i - 1, column] for i in range(remaining + 1, remaining + 1 - power, -1)
        )
        remaining -= power
    return position


def test_monomials_have_the_order_of_the_dissertation():
    order = 4
    powers = tj.energies.monomials(order, redundant=True)
    for row in itertools.product(range(order + 1), repeat=4):
        if sum(row) <= order:
            assert powers[idx4(*row, order=order) - 1] == row


def all_powers(order):
    return np.array(tj.energies.monomials(order, redundant=True), float)


@pytest.mark.slow
def test_monomials_without_redundant_ones_are_linearly_independent():
    """Their number is the rank of all monomials of the twistor at many points."""
    twistors_of_poses = for_each(twistors.twistor, some_poses(3, 90))
    for order, count in ((2, 14), (4, 55)):
        values = np.prod(twistors_of_poses[:, None] ** all_powers(order), axis=2)
        assert np.linalg.matrix_rank(values, 1e-10) == count
        assert len(tj.energies.monomials(order)) == count


@every_coordinates
def test_value_and_derivatives_equal_those_of_the_sum_of_terms(coordinates):
    energy = random_polynomial(coordinates, 5)
    poses = 0.5 * some_poses(1, 12)[8:]

    def derivatives(energy):
        @jax.jit
        @jax.vmap
        def at(pose):
            return energy(pose), jax.grad(energy)(pose), jax.hessian(energy)(pose)

        return at(poses)

    expected = derivatives(partial(sum_of_terms, energy))
    for actual, exact in zip(derivatives(energy), expected, strict=True):
        assert_close(actual, exact, digits=9)


def test_second_derivatives_share_the_sums_of_the_energy():
    """Ten partial derivatives take fewer products than four energies."""
    energy = random_polynomial("twist", 8)
    variables = tuple(jnp.array([0.3, 0.1, 0.2]))
    orders = [row for row in itertools.product(range(3), repeat=3) if sum(row) <= 2]

    def products(orders):
        def derivatives(coefficients):
            return polynomial_derivatives(energy.powers, orders, coefficients, variables)

        program = jax.jit(derivatives).lower(energy.coefficients).as_text()
        return program.count("stablehlo.multiply")

    assert len(energy.powers) <= products(((0, 0, 0),))
    assert products(tuple(orders)) < 4 * products(((0, 0, 0),))


def test_derivatives_by_coefficients_are_the_monomials():
    pose = jnp.array([0.4, 0.2, -0.3])
    energy = random_polynomial("twistor", 3)

    @jax.jit
    @jax.grad
    def derivatives(coefficients):
        polynomial = tj.energies.Polynomial(
            coefficients, energy.powers, scale=energy.scale
        )
        return polynomial(pose)

    variables = np.asarray(twistors.twistor(pose)) / [1, 1, energy.scale, energy.scale]
    expected = np.prod(variables ** np.array(energy.powers, float), axis=1)
    assert_close(derivatives(energy.coefficients), expected)


@every_coordinates
def test_quadratic_energy_is_a_polynomial_of_second_order(coordinates):
    stiffness = some_stiffness(2)
    strain_variables = range(1, 4) if coordinates == "twistor" else range(3)
    factor = 2.0 if coordinates == "twistor" else 0.5
    terms = {}
    for i, j in itertools.product(range(3), repeat=2):
        row = [0] * (4 if coordinates == "twistor" else 3)
        row[strain_variables[i]] += 1
        row[strain_variables[j]] += 1
        value = factor * float(stiffness[i, j])
        terms[tuple(row)] = terms.get(tuple(row), 0.0) + value
    energy = tj.energies.Polynomial(list(terms.values()), list(terms), coordinates)
    poses = some_poses(4)
    expected = for_each(tj.Quadratic(stiffness, coordinates), poses)
    assert_close(for_each(energy, poses), expected, digits=10)


def test_frames_of_both_bodies_can_be_changed_independently():
    """Equation 4.70: the energy is a polynomial of the twistor of the new frames."""
    energy = random_polynomial("twistor", 4)
    frames = [jnp.asarray(some_poses(seed, 9)[8]) for seed in (5, 6, 7)]
    frame_a, frame_b, pose = frames
    changed = energy.change_frames(frame_a, frame_b)
    new_pose = se2.compose(se2.compose(se2.inverse(frame_a), pose), frame_b)
    assert_close(changed(new_pose), energy(pose), digits=8)
    assert changed.powers == tj.energies.monomials(4)


@every_coordinates
def test_frames_that_coincide_in_the_reference_can_be_changed(coordinates):
    """Equations 3.69 and 4.70."""
    energy = random_polynomial(coordinates, 3)
    frame, pose = jnp.array([0.7, 0.4, -0.2]), jnp.array([-0.9, 0.1, 0.6])
    new_pose = se2.compose(se2.compose(se2.inverse(frame), pose), frame)
    assert_close(energy.change_frames(frame)(new_pose), energy(pose), digits=10)


SYMMETRIES = {
    "mirror": lambda pose: pose * np.array([-1.0, 1.0, -1.0]),
    "ends": lambda pose: se2.inverse(pose) * np.array([1.0, -1.0, -1.0]),
    "exchange": se2.inverse,
    "sign": lambda pose: pose + np.array([2 * np.pi, 0.0, 0.0]),
}


@pytest.mark.parametrize("kind", SYMMETRIES)
@every_coordinates
def test_symmetric_polynomial_is_invariant_under_the_symmetry(coordinates, kind):
    """A polynomial without the symmetry is not invariant."""
    if (kind, coordinates) == ("sign", "twist"):
        pytest.skip("the twist has no sign")
    symmetric = random_polynomial(coordinates, 5, symmetry=[kind])
    general = random_polynomial(coordinates, 5)
    assert 0 < len(symmetric.powers) < len(general.powers)
    poses = 0.3 * some_poses(8, 20)[7:]

    def energies(pose):
        image = SYMMETRIES[kind](pose)
        return [f(at) for f in (symmetric, general) for at in (image, pose)]

    of_image, of_pose, general_of_image, general_of_pose = for_each(energies, poses)
    assert_close(of_image, of_pose, digits=10)
    assert np.max(np.abs(general_of_image - general_of_pose)) > 0.1


def test_sum_of_squares_has_no_zero():
    rng = np.random.default_rng(0)
    powers = tj.energies.monomials(2)
    squares = tj.energies.SumOfSquares(rng.normal(size=(3, len(powers))), powers)
    assert np.min(for_each(squares, some_poses(9, 200))) >= 1.0
    energy = tj.energies.Rational(random_polynomial("twistor", 2), squares)
    pose = jnp.array([0.3, 0.2, 0.1])
    assert_close(energy(pose), float(energy.numerator(pose)) / float(squares(pose)))
    step = 1e-6 * np.eye(3)
    ahead, behind = (for_each(energy, np.asarray(pose) + sign * step) for sign in (1, -1))
    assert_close(jax.jit(jax.grad(energy))(pose), (ahead - behind) / 2e-6, digits=8)


@pytest.mark.parametrize("name", mostly_slow(["rational", "polynomial"]))
def test_wrench_of_a_hinge_equals_the_load_in_equilibrium(name):
    powers = ((0, 2, 0, 0), (0, 0, 2, 0), (0, 0, 0, 2), (0, 4, 0, 0), (0, 2, 0, 2))
    energy = tj.energies.Polynomial([2.0, 30.0, 9.0, 1.0, 20.0], powers)
    if name == "rational":
        denominator = tj.energies.SumOfSquares([[0.3]], [(0, 0, 0, 1)])
        energy = tj.energies.Rational(energy, denominator)
    bodies = [tj.Body("wall"), tj.Body("block")]
    hinge = tj.Hinge("hinge", "wall", "block", energy, at=(0, 0, 0))
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    solution = tj.equilibrium(mechanism, loads=[tj.Load("block", (0.3, 1.0, 2.0))])
    pose = solution.pose("block")
    assert np.abs(np.asarray(pose)[0]) > 0.05
    assert_close(jax.jit(jax.grad(energy))(pose), np.array([0.3, 1.0, 2.0]), digits=8)


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
            lambda: tj.energies.Polynomial([1.0], [(2, 0, 0)], "polar"),  # pyright: ignore[reportArgumentType]
            "'twist', 'twistor'",
        ),
        (
            lambda: tj.energies.Polynomial([1.0], [(0, 2, 0, 0)], scale=0.0),
            "must be positive",
        ),
        (lambda: tj.energies.monomials(-1), "a whole number, zero or positive"),
        (lambda: tj.energies.monomials(2, symmetry=["round"]), "'mirror', 'ends'"),  # pyright: ignore[reportArgumentType]
        (
            lambda: tj.energies.monomials(2, "twist", symmetry=["sign"]),
            "of the twistor only",
        ),
        (lambda: tj.energies.SumOfSquares([[1.0]], [(0, 2, 0, 0)] * 2), "more than once"),
    ],
)
def test_invalid_arguments_raise_an_error(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert message in str(error.value)


def test_symmetry_of_a_leaf_can_be_given_in_a_list():
    assert tj.energies.monomials(4, symmetry=["leaf"]) == tj.energies.monomials(
        4, symmetry="leaf"
    )
    both = tj.energies.monomials(4, "mixed", symmetry=["leaf", "exchange"])
    assert both == tj.energies.monomials(
        4, "mixed", symmetry=["mirror", "ends", "exchange"]
    )
