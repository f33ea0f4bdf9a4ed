"""The bending factor of wide leaves against plates and an elastic solid."""

import jax
import numpy as np
import pytest
import scipy.integrate
from helpers import for_each
from numpy.polynomial import legendre

from twistorjax import flexures


def axis_values(count, first, clamped, size):
    """Return functions of one coordinate of a solid: values, derivatives, weights.

    The functions are Legendre polynomials of every other order. If they are clamped, they
    are differences of two of them, which vanish at both ends.
    """
    nodes, weights = legendre.leggauss(2 * count + 8)
    values, derivatives = [], []
    for order in range(first, first + 2 * count, 2):
        series = np.zeros(order + 2)
        series[order] = 1.0
        if clamped:
            series = np.zeros(order + 2)
            series[order + 1], series[order - 1] = 1.0, -1.0
        series /= np.sqrt(2 * order + 1)
        values.append(legendre.legval(nodes, series))
        derivatives.append(legendre.legval(nodes, legendre.legder(series)) * 2 / size)
    return np.array(values), np.array(derivatives), weights * size / 2


def solid_factor(width, thickness, poisson, shape, counts=(14, 4, 2)):
    """Compute the bending factor of a clamped solid of unit length by Ritz's method.

    The ends move by -1 and 1 in the direction of the thickness, or rotate by -1 and 1.
    The displacements (axial, across, lateral) are polynomials with their symmetries.
    """
    shear = 1 / (2 * (1 + poisson))
    lame = poisson / ((1 + poisson) * (1 - 2 * poisson))
    s_shaped = shape == "s-shaped"
    along = (1, 2, 2) if s_shaped else (2, 1, 1)
    sizes, firsts = (1.0, width, thickness), zip(along, (0, 1, 0), (1, 1, 0), strict=True)
    functions = [
        [axis_values(counts[a], row[a], a == 0, sizes[a]) for a in range(3)]
        for row in firsts
    ]
    # A given displacement of the ends and its gradient, as a product of three functions
    nodes = [legendre.leggauss(2 * count + 8)[0] for count in counts]
    x, z = nodes[0] / 2, nodes[2] * thickness / 2
    ones = [np.ones_like(node) for node in nodes]
    given = {(2, 0): (2 * ones[0], ones[1], ones[2])}
    if not s_shaped:
        given = {(0, 0): (2 * ones[0], ones[1], -z), (0, 2): (2 * x, ones[1], -ones[2])}

    def kronecker(parts):
        return np.kron(np.kron(parts[0], parts[1]), parts[2])

    def weighted(c, d):
        return [functions[c][a][int(a == d)] * functions[c][a][2] for a in range(3)]

    def product(c, d, other, e):
        rows = zip(weighted(c, d), functions[other], range(3), strict=True)
        return kronecker([left @ right[int(a == e)].T for left, right, a in rows])

    def with_given(c, d, gradient):
        return kronecker([f @ g for f, g in zip(weighted(c, d), gradient, strict=True)])

    def block(i, j):
        matrix = lame * product(i, i, j, j) + shear * product(i, j, j, i)
        return matrix + (i == j) * shear * sum(product(i, d, i, d) for d in range(3))

    def load(c):
        total = 0.0
        for (i, j), gradient in given.items():
            total += (i == j) * lame * with_given(c, c, gradient)
            total += (c == i) * shear * with_given(c, j, gradient)
            total += (c == j) * shear * with_given(c, i, gradient)
        return total

    weights = [functions[0][a][2] for a in range(3)]
    energy = 0.0
    for (i, j), one in given.items():
        for (k, m), two in given.items():
            factor = lame * (i == j) * (k == m)
            factor += shear * (i == k) * (j == m) + shear * (i == m) * (j == k)
            parts = zip(weights, one, two, strict=True)
            energy += factor * np.prod([np.sum(w * g * h) for w, g, h in parts])
    matrix = np.block([[block(i, j) for j in range(3)] for i in range(3)])
    right = np.concatenate([load(c) for c in range(3)])
    scale = 1 / np.sqrt(np.diag(matrix))
    solution = np.linalg.solve(matrix * np.outer(scale, scale), right * scale)
    stiffness = (energy - solution @ (right * scale)) / 4  # for a relative change of 1
    bending = width * thickness**3 / 12
    if not s_shaped:
        return stiffness / bending
    shear_compliance = 1 / (5 / 6 * shear * width * thickness)
    return 1 / (12 * bending * (1 / stiffness - shear_compliance))


@pytest.mark.parametrize("shape", ["s-shaped", "circular"])
@pytest.mark.parametrize(("width", "thickness"), [(0.2, 0.02), (0.5, 0.05), (1, 0.02),
                                                  (2, 0.1)])  # fmt: skip
def test_the_bending_factor_is_that_of_a_clamped_solid(width, thickness, shape):
    for poisson, tolerance in ((0.3, 0.007), (0.45, 0.025)):
        factor = flexures.bending_factor(
            width=width, length=1.0, thickness=thickness, poisson=poisson, shape=shape
        )
        solid = solid_factor(width, thickness, poisson, shape)
        np.testing.assert_allclose(factor, solid, rtol=tolerance)
        assert abs(solid - 1) > 2 * abs(float(factor) - solid)


def test_the_bending_factor_of_published_finite_elements():
    """It is 1.040 for the leaves of a parallelogram, with a mesh error of 0.6 %."""
    factor = flexures.bending_factor(
        width=50e-3, length=250e-3, thickness=5e-3, poisson=0.3
    )
    np.testing.assert_allclose(factor, 1.040, rtol=0.006)
    solid = solid_factor(0.2, 0.02, 0.3, "s-shaped")
    np.testing.assert_allclose(factor, solid, rtol=1e-3)


@pytest.mark.parametrize("shape", ["s-shaped", "circular"])
@pytest.mark.parametrize("width", [0.1, 1.0])
def test_the_bending_factor_is_the_minimum_of_the_energy_of_a_plate(width, shape):
    """The differential equations of the docstring are solved by SciPy."""
    poisson = 0.3
    s_shaped = shape == "s-shaped"

    def moment(x):
        return x if s_shaped else np.ones_like(x)

    def rates(x, state):
        anticlastic, slope = state[0], state[1]
        source = 3 * poisson / (1 - poisson) * moment(x)
        rate = (6 * (1 + poisson) * anticlastic + source) / width**2
        curvature = moment(x) - 2 * poisson * anticlastic
        return np.stack([slope, rate, curvature * moment(x)])

    nodes = np.linspace(-0.5, 0.5, 201)
    solution = scipy.integrate.solve_bvp(
        rates,
        lambda a, b: np.array([a[0], b[0], a[2]]),
        nodes,
        np.zeros((3, 201)),
        tol=1e-9,
        max_nodes=50_000,
    )
    # The work of a narrow beam is larger by the plate's stiffness over that of a beam.
    narrow = (1 / 12 if s_shaped else 1.0) / (1 - poisson**2)
    factor = flexures.bending_factor(
        width=width, length=1.0, thickness=0.01, poisson=poisson, shape=shape
    )
    np.testing.assert_allclose(factor, narrow / solution.y[2, -1], rtol=1e-7)


@pytest.mark.parametrize("shape", ["s-shaped", "circular"])
def test_the_bending_factor_is_one_for_narrow_leaves_and_that_of_a_plate_for_wide(shape):
    @jax.jit
    def factor(width, poisson=0.3):
        return flexures.bending_factor(
            width=width, length=1.0, thickness=0.01, poisson=poisson, shape=shape
        )

    np.testing.assert_allclose(factor(1e-9), 1.0, rtol=1e-9)
    np.testing.assert_allclose(factor(1e5), 1 / (1 - 0.09), rtol=1e-9)
    np.testing.assert_allclose(factor(0.5, poisson=0.0), 1.0, rtol=1e-15)
    # The series of a very wide leaf continues the formula.
    limit = np.sqrt(1.5 * 1.3) / 0.03
    below, above = factor(limit * (1 - 1e-9)), factor(limit * (1 + 1e-9))
    np.testing.assert_allclose(below, above, rtol=1e-12)
    widths, step = np.array([1e-3, 0.2, 1.0, 100.0]), 1e-5
    slopes = for_each(jax.grad(factor), widths)
    ends = [for_each(factor, widths * (1 + side * step)) for side in (1, -1)]
    change = ends[0] - ends[1]
    np.testing.assert_allclose(slopes * widths, change / (2 * step), atol=1e-8)


def test_a_leaf_that_is_too_thick_for_a_plate_raises_an_error():
    with pytest.raises(ValueError, match=r"is 0\.101, but the factor is that of a plate"):
        flexures.bending_factor(width=1.0, length=1.0, thickness=0.101, poisson=0.3)
