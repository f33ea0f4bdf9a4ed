"""The four-bar linkages on pins, with quadratic energies, surrogates, and exact beams."""

import json
from typing import Any

import equinox as eqx
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from helpers import assert_close

from twistorjax.examples import four_bar_models as example


MODULUS, WIDTH, THICKNESS, HOLE, WEB = 69e9 / 20, 5e-3, 1e-3, 8e-3, 0.5e-3
BENDING = MODULUS * WIDTH * THICKNESS**3 / 12
RATIO = WEB / HOLE
FITTED_NOTCH = (  # the rotational stiffness of the listing `notch_stiff`
    MODULUS * WIDTH * HOLE**2 * RATIO**2 * (0.1109 * np.sqrt(RATIO) - 0.035 * RATIO)
)
# Centers of the hinges A, B, C, D and of link 3, and lengths of the leaves; m
PLACES = {
    "identical": np.array(
        [[-17.5, 7.5], [-17.5, 57.5], [17.5, 57.5], [17.5, 7.5], [0.0, 65.0]]
    )
    * 1e-3,
    "leaves-and-notches": np.array(
        [[-17.5, 12.5], [-17.5, 56.5], [17.5, 56.5], [17.5, 7.5], [0.0, 63.0]]
    )
    * 1e-3,
}
CRANK = np.radians([2.0, 6.0, 10.0, 14.0, 18.0])
HOWELL = 0.8517, 2 * 0.8517 * 2.65
MATCHED = np.sqrt(1 / 3), 2.0


@pytest.fixture(scope="module")
def models():
    # Surrogates of identical leaves are left out, because they take long to compute.
    names = ["pseudo-rigid-body", "quadratic", "exact beam"]
    return {
        "identical": example.four_bar_models("identical", names),
        "leaves-and-notches": example.four_bar_models("leaves-and-notches"),
    }


@pytest.fixture(scope="module")
def comparisons(models):
    return {
        hinges: example.compare(parts, CRANK.tolist()) for hinges, parts in models.items()
    }


def rotated(angle, vector):
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array(
        [cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]]
    )


def closed_loop(crank, lower, places):
    """Angles of the links 3 and 4 on rigid links, if hinge B is at a given position."""
    _, b, c, d, _ = places

    def gap(angles):
        coupler, rocker = angles
        return lower + rotated(coupler, c - b) - d - rotated(rocker, c - d)

    solution = scipy.optimize.root(gap, [0.0, crank], tol=1e-14)
    assert np.max(np.abs(gap(solution.x))) < 1e-15
    return solution.x


def pinned(crank, hinges, long_leaf):
    """Energy and displacement of link 3 on pins, from the equations of loop closure."""
    places = PLACES[hinges]
    a, b, _, _, center = places

    def state(segment):
        """Energy and displacement if the segment of the leaf has an angle."""
        if hinges == "identical":
            position, springs = a + rotated(crank, b - a), [BENDING / 10e-3 * crank**2]
            upper = lower = BENDING / 10e-3
        else:
            distance, factor = long_leaf
            half = np.array([0.0, distance * 20e-3 / 2])
            position = a - half + rotated(segment, 2 * half)
            position += rotated(crank, b - a - half)
            stiffness = factor * BENDING / 20e-3
            springs = [stiffness * segment**2, stiffness * (crank - segment) ** 2]
            upper, lower = FITTED_NOTCH, BENDING / 10e-3
        coupler, rocker = closed_loop(crank, position, places)
        springs += [upper * (coupler - crank) ** 2, upper * (rocker - coupler) ** 2]
        springs += [lower * rocker**2]
        moved = position + rotated(coupler, center - b) - center
        return sum(springs) / 2, [coupler, *moved]

    if hinges == "identical":
        return state(0.0)
    found: Any = scipy.optimize.minimize_scalar(
        lambda segment: state(segment)[0], (0.4 * crank, 0.6 * crank), tol=1e-12
    )
    return state(found.x)


@pytest.mark.parametrize(
    ("hinges", "name", "long_leaf"),
    [
        pytest.param("identical", "pseudo-rigid-body", None, marks=pytest.mark.release),
        pytest.param(
            "leaves-and-notches", "pseudo-rigid-body", HOWELL, marks=pytest.mark.slow
        ),
        pytest.param(
            "leaves-and-notches",
            "pseudo-rigid-body, matched",
            MATCHED,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_linkage_on_pins_follows_from_loop_closure(
    comparisons, hinges, name, long_leaf
):
    comparison = comparisons[hinges]
    row, step = comparison.models.index(name), 1e-4
    for k, crank in enumerate(comparison.rotations):
        energy, displacement = pinned(crank, hinges, long_leaf)
        assert_close(comparison.displacements[row, k], displacement, digits=8)
        assert_close(comparison.energies[row, k], energy, digits=12)
        after, before = (
            pinned(crank + sign * step, hinges, long_leaf)[0] for sign in (1, -1)
        )
        torque = (after - before) / (2 * step)
        np.testing.assert_allclose(comparison.torques[row, k], torque, rtol=1e-6)


@pytest.mark.slow
def test_identical_leaves_on_pins_are_a_parallelogram(comparisons):
    comparison = comparisons["identical"]
    row = comparison.models.index("pseudo-rigid-body")
    angle, x, y = comparison.displacements[row].T
    assert_close(angle, np.zeros(5))
    assert_close(x, -50e-3 * np.sin(comparison.rotations))
    assert_close(y, 50e-3 * (np.cos(comparison.rotations) - 1))
    assert_close(comparison.torques[row], 4 * BENDING / 10e-3 * comparison.rotations)


@pytest.mark.slow
def test_matched_pins_have_the_compliance_of_the_leaf(models):
    """Deflection and rotation of a cantilever under a force and a moment at its end."""
    distance, factor = MATCHED
    length, stiffness = 20e-3, factor * BENDING / 20e-3
    arms = np.array([1 + distance, 1 - distance]) * length / 2  # from the end to the pins
    pins = np.array([[np.sum(arms**2), np.sum(arms)], [np.sum(arms), 2.0]]) / stiffness
    leaf = np.array([[length**3 / 3, length**2 / 2], [length**2 / 2, length]]) / BENDING
    assert_close(pins / leaf, np.ones((2, 2)))
    linkage, joints = models["leaves-and-notches"]["pseudo-rigid-body, matched"]
    lower, upper = (joint.at[1] for joint in joints[:2])
    assert_close(upper - lower, distance * length)
    springs = [linkage.hinge_assembly.energy_of(k).stiffness[0, 0] for k in range(2)]
    assert_close(np.array(springs), np.full(2, stiffness))


def compliances(shape, thickness, shear=True):
    """Compliances of a beam about its middle: rotation, axial, and transverse."""
    area, shear_modulus = (lambda x: WIDTH * thickness(x)), MODULUS / 2.6

    def bending(x):
        return MODULUS * WIDTH * thickness(x) ** 3 / 12

    def transverse(x):
        return x**2 / bending(x) + shear * 1.2 / (shear_modulus * area(x))

    parts = (lambda x: 1 / bending(x)), (lambda x: 1 / (MODULUS * area(x))), transverse
    return [
        2
        * scipy.integrate.quad(part, 0.0, shape / 2, epsabs=0, epsrel=1e-9, limit=200)[0]
        for part in parts
    ]


def linear_torque(hinges, shear=True):
    """Torque over the rotation of link 2, for small rotations of linear springs."""

    def leaf(length):
        return compliances(length, lambda x: THICKNESS, shear)

    notch = compliances(HOLE, lambda x: WEB + HOLE - np.sqrt(HOLE**2 - 4 * x**2))
    beams = [leaf(10e-3)] * 4
    if hinges != "identical":
        beams = [leaf(20e-3), notch, notch, leaf(10e-3)]
    stiffness = np.zeros((12, 12))  # angle, x, y at the origin for each link
    for k, beam in enumerate(beams):
        x, y = PLACES[hinges][k]
        at_hinge = np.array([[1.0, 0.0, 0.0], [-y, 1.0, 0.0], [x, 0.0, 1.0]])
        map_to_hinge = np.zeros((3, 12))
        map_to_hinge[:, 3 * k : 3 * k + 3] = -at_hinge
        following = 3 * ((k + 1) % 4)
        map_to_hinge[:, following : following + 3] = at_hinge
        # The axis of the beam is y.
        matrix = np.diag(1 / np.array(beam)[[0, 2, 1]])
        stiffness += map_to_hinge.T @ matrix @ map_to_hinge
    free = np.arange(4, 12)
    tied = stiffness[3, free] @ np.linalg.solve(
        stiffness[np.ix_(free, free)], stiffness[free, 3]
    )
    return stiffness[3, 3] - tied


@pytest.mark.parametrize(
    ("hinges", "expected"),
    [
        pytest.param(
            "identical",
            {"pseudo-rigid-body": 0.0138, "quadratic": 0.0004},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "leaves-and-notches",
            {
                "pseudo-rigid-body": 0.2486,
                "pseudo-rigid-body, matched": 0.0066,
                "quadratic": 0.0025,
                "surrogate": 0.0,
            },
            marks=pytest.mark.release,
        ),
    ],
)
def test_the_torques_of_small_rotations(models, hinges, expected):
    """Beams are linear springs with shear; the other models differ by known amounts."""
    rotation = 1e-3
    comparison = example.compare(models[hinges], [rotation])
    differences = comparison.torques[:, 0] / rotation / linear_torque(hinges) - 1
    found = dict(zip(comparison.models, differences, strict=True))
    assert abs(found["exact beam"]) < 2e-4
    for name, difference in expected.items():
        assert abs(found[name] - difference) < 2e-4


@pytest.mark.slow
@pytest.mark.parametrize("hinges", PLACES)
def test_the_torque_is_the_derivative_of_the_energy(comparisons, hinges):
    """A polynomial through all energies, of degree 5, is differentiated."""
    comparison = comparisons[hinges]
    at = np.array([0.0, *comparison.rotations]) / comparison.rotations[-1]
    for energies, torques in zip(comparison.energies, comparison.torques, strict=True):
        series = np.polynomial.Polynomial.fit(at, [0.0, *energies], 5)
        slope = series.deriv()(at[1:]) / comparison.rotations[-1]
        np.testing.assert_allclose(slope, torques, rtol=1e-4)


@pytest.mark.slow
def test_surrogates_are_as_accurate_as_they_report(models, comparisons):
    comparison = comparisons["leaves-and-notches"]
    linkage, _ = models["leaves-and-notches"]["surrogate"]
    energies = [linkage.hinge_assembly.energy_of(k) for k in range(4)]
    error = max(float(np.max(energy.error)) for energy in energies)
    assert error < 5e-4
    row = comparison.models.index("surrogate")
    rotation, motion, torque, energy = np.abs(comparison.differences()[row]).T
    for relative in (torque, energy, motion / 15e-3):
        assert 0 < np.max(relative) < error
    assert np.max(rotation) < error * comparison.rotations[-1]


@pytest.mark.slow
def test_the_measured_differences_are_those_of_the_manual(comparisons):
    """Largest differences from the exact beams: deg, mm, %, %."""
    expected = {
        "identical": {
            "pseudo-rigid-body": [0.129, 0.317, 2.54, 2.08],
            "quadratic": [0.0144, 0.156, 1.67, 0.831],
        },
        "leaves-and-notches": {
            "pseudo-rigid-body": [0.201, 0.0327, 27.9, 26.8],
            "pseudo-rigid-body, matched": [0.0609, 0.0743, 1.21, 1.04],
            "quadratic": [0.152, 0.127, 2.76, 1.49],
        },
    }
    for hinges, parts in expected.items():
        comparison = comparisons[hinges]
        largest = np.max(np.abs(comparison.differences()), axis=1)
        largest *= [180 / np.pi, 1e3, 100, 100]
        for name, row in parts.items():
            found = largest[comparison.models.index(name)]
            np.testing.assert_allclose(found, row, rtol=0.02)


@pytest.mark.slow
def test_a_model_outside_its_range_is_nan_from_there_on(models):
    only = {"surrogate": models["leaves-and-notches"]["surrogate"]}
    comparison = example.compare(only, [0.3, 0.45, 0.5])
    assert comparison.results[0, 0] == "successful"
    assert comparison.results[0, 1] == "out_of_range"
    assert np.all(np.isnan(comparison.torques[0, 1:]))
    assert np.isfinite(comparison.torques[0, 0])


@pytest.mark.slow
def test_all_models_are_built_by_default(models, monkeypatch):
    """The surrogates are replaced, because they take long to compute."""
    monkeypatch.setattr(example, "surrogate", lambda beam, **_: example.ExactBeam(beam))
    names = [*example.four_bar_models("leaves-and-notches")]
    assert names == [*models["leaves-and-notches"]]
    names.remove("pseudo-rigid-body, matched")
    assert [*example.four_bar_models()] == names


@pytest.mark.untyped
def test_invalid_arguments():
    for rotations in ([], [0.0, 0.1], [0.2, 0.1]):
        with pytest.raises(ValueError, match="must be positive and increasing"):
            example.compare({}, rotations)
    with pytest.raises(ValueError, match="'heat'"):
        example.four_bar_models("identical", ["heat"])
    with pytest.raises(ValueError, match="`hinges` is 'x'"):
        unknown: Any = "x"
        example.four_bar_models(unknown, ["quadratic"])


@pytest.fixture
def run_computed(run_here, monkeypatch, comparisons):
    """Run the command with results that have been computed already."""
    monkeypatch.setattr(example, "four_bar_models", lambda hinges: hinges)
    monkeypatch.setattr(example, "compare", lambda hinges: comparisons[hinges])
    return run_here


@pytest.mark.slow
def test_the_command_prints_json_and_draws_a_figure(run_computed, comparisons):
    done = run_computed("four-bar-models", "--json", "--plot", "models.png")
    assert done.returncode == 0, done.stderr
    assert (run_computed.folder / "models.png").stat().st_size > 50_000
    result = json.loads(done.stdout)
    assert set(result) == set(PLACES)
    for hinges, comparison in comparisons.items():
        part = result[hinges]
        assert set(part) == {"crank_rotations_rad", "models"}
        assert part["crank_rotations_rad"] == CRANK.tolist()
        assert tuple(part["models"]) == comparison.models
        for k, values in enumerate(part["models"].values()):
            assert set(values) == {
                *("rotation_rad", "x_m", "y_m", "torque_Nm", "energy_J"),
                "largest_difference",
            }
            assert values["x_m"] == comparison.displacements[k, :, 1].tolist()
            assert values["torque_Nm"] == comparison.torques[k].tolist()
        exact = part["models"]["exact beam"]["largest_difference"]
        assert set(exact) == {"rotation_rad", "displacement_m", "torque", "energy"}
        assert set(exact.values()) == {0.0}


@pytest.mark.slow
def test_the_command_prints_a_table_of_both_linkages(run_computed):
    done = run_computed("four-bar-models")
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert max(map(len, lines)) < 100
    assert sum(line.startswith("exact beam") for line in lines) == 2
    (matched,) = (line for line in lines if line.startswith("pseudo-rigid-body, matched"))
    numbers = [float(word) for word in matched.split()[2:]]
    expected = [0.339, -12.863, -1.812, 114.21, 18.20, 0.061, 0.074, 1.212, 1.037]
    np.testing.assert_allclose(numbers, expected, rtol=1e-3, atol=6e-4)


@pytest.mark.slow
def test_the_command_reports_a_failure(run_computed, comparisons, monkeypatch):
    comparison = comparisons["identical"]
    results = comparison.results.copy()
    results[1, 3] = "unstable"
    failed = eqx.tree_at(lambda c: c.results, comparison, results)
    monkeypatch.setattr(example, "compare", lambda hinges: failed)
    done = run_computed("four-bar-models")
    assert (done.returncode, done.stdout) == (1, "")
    assert "'quadratic' failed at a rotation of 0.2443 rad: unstable" in done.stderr
