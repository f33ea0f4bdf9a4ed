"""Fits of polynomial and mixed energies to trials, and files of trials and energies."""

import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, mostly_slow, some_stiffness

import twistorjax as tj
from twistorjax.energies.strains import Coordinates


REFERENCE = pathlib.Path(__file__).parent / "reference"


def random_trials(energy, count=40, seed=0, size=0.3, noise=0.0):
    rng = np.random.default_rng(seed)
    poses = jnp.array(rng.uniform(-size, size, (count, 3)))
    wrenches = jax.vmap(energy.wrench)(poses)
    wrenches = wrenches + noise * jnp.array(rng.normal(size=wrenches.shape))
    return tj.energies.Trials(
        poses, wrenches, wrench_deviations=max(noise, 1.0) * np.ones(3)
    )


def random_energy(coordinates: Coordinates = "twistor", order=4, seed=1):
    powers = [
        row for row in tj.energies.monomials(order, coordinates) if sum(row[-3:]) >= 2
    ]
    rng = np.random.default_rng(seed)
    perturbation = tj.energies.Polynomial(
        0.1 * rng.normal(size=len(powers)), powers, coordinates
    )
    return tj.Quadratic(some_stiffness(3), coordinates) + perturbation


@pytest.mark.parametrize("coordinates", ["twist", "twistor"])
def test_fit_recovers_a_polynomial(coordinates):
    energy = random_energy(coordinates)
    fit = tj.fit_energy(random_trials(energy), order=4, coordinates=coordinates)
    new_trials = random_trials(energy, seed=5)
    wrenches = jax.vmap(fit.energy.wrench)(new_trials.poses)
    assert_close(wrenches, new_trials.wrenches, digits=9)
    actual = jax.vmap(fit.energy)(new_trials.poses) - fit.energy(jnp.zeros(3))
    expected = jax.vmap(energy)(new_trials.poses) - energy(jnp.zeros(3))
    assert_close(actual, expected, digits=9)


def test_fit_recovers_a_polynomial_from_energies_alone():
    energy = random_energy()
    poses = random_trials(energy, 90).poses
    trials = tj.energies.Trials(poses, energies=jax.vmap(energy)(poses))
    fit = tj.fit_energy(trials, order=4)
    wrenches = jax.vmap(fit.energy.wrench)(poses)
    assert_close(wrenches, jax.vmap(energy.wrench)(poses), digits=7)


@pytest.mark.parametrize("copies", [1, 3])
def test_expected_errors_equal_those_of_fits_that_leave_one_pose_out(copies):
    """The other trials with this pose would say much about the one that is left out."""
    trials = random_trials(random_energy(order=6), 30, size=0.2)
    assert trials.wrenches is not None
    noise = 2e-3 * np.random.default_rng(1).normal(size=(30 * copies, 3))
    wrenches = np.tile(trials.wrenches, (copies, 1)) + noise
    rows = np.tile(np.arange(30), copies)
    trials = tj.energies.Trials(np.tile(trials.poses, (copies, 1)), wrenches)
    fit = tj.fit_energy(trials, order=3, ridge=0.0, scale=0.5)
    assert fit.value_count == 90
    errors = []
    for row in range(30):
        energy = tj.fit_energy(trials[rows != row], order=3, ridge=0.0, scale=0.5).energy
        predicted = np.asarray(energy.wrench(trials.poses[row]))
        errors.append(wrenches[rows == row] - predicted)
    expected = np.sqrt(np.mean(np.square(errors), axis=(0, 1)))
    np.testing.assert_allclose(fit.expected.rms_wrench, expected, rtol=1e-7)


@pytest.mark.slow
def test_covariance_is_that_of_repeated_fits():
    energy = tj.Quadratic(some_stiffness(4))
    rng = np.random.default_rng(9)
    exact = random_trials(energy, 20)
    assert exact.wrenches is not None
    coefficients, covariances = [], []
    for _ in range(300):
        noisy = exact.wrenches + 0.005 * jnp.array(rng.normal(size=exact.wrenches.shape))
        trials = tj.energies.Trials(
            exact.poses, noisy, wrench_deviations=0.005 * np.ones(3)
        )
        fit = tj.fit_energy(trials, order=2, ridge=0.0)
        coefficients.append(np.asarray(fit.energy.coefficients))
        covariances.append(fit.covariance)
    sampled = np.cov(np.array(coefficients).T)
    reported = np.mean(covariances, axis=0)
    free = np.diagonal(reported) > 1e-20
    ratio = np.diagonal(sampled)[free] / np.diagonal(reported)[free]
    assert free.sum() >= 6
    np.testing.assert_allclose(ratio, 1.0, atol=0.25)


def test_reference_is_unstressed_unless_it_is_free():
    energy = tj.energies.Polynomial(
        [1.0, 5.0, 5.0], [(0, 1, 0, 0), (0, 0, 2, 0), (0, 2, 0, 0)]
    )
    trials = random_trials(energy, 60)
    with pytest.warns(UserWarning, match="the error at new trials is up to 4"):
        unstressed = tj.fit_energy(trials, order=2, reference="unstressed")
    assert_close(unstressed.energy.wrench(jnp.zeros(3)), jnp.zeros(3), digits=12)
    free = tj.fit_energy(trials, order=2, reference="free")
    assert_close(free.energy.wrench(jnp.zeros(3)), jnp.array([0.5, 0.0, 0.0]), digits=9)


def test_stable_reference_has_a_positive_definite_stiffness():
    """The exact energy snaps through: its transverse reference stiffness is negative."""
    energy = tj.energies.Polynomial(
        [1.0, 9.0, -2.0, 40.0], [(0, 2, 0, 0), (0, 0, 2, 0), (0, 0, 0, 2), (0, 0, 0, 4)]
    )
    trials = random_trials(energy, 60)
    with pytest.warns(UserWarning, match="is not positive definite"):
        stable = tj.fit_energy(trials, order=4).energy.tangent_stiffness()
    assert np.linalg.eigvalsh(stable)[0] > 0
    unstable = tj.fit_energy(trials, order=4, reference="unstressed")
    assert np.linalg.eigvalsh(unstable.energy.tangent_stiffness())[0] < -0.5


def test_undetermined_terms_are_reported():
    """Trials without rotation do not determine terms of the rotation."""
    energy = tj.Quadratic(some_stiffness(5))
    poses = random_trials(energy, 20).poses.at[:, 0].set(0.0)
    fit = tj.fit_energy(
        tj.energies.Trials(poses, energies=jax.vmap(energy)(poses)), order=2
    )
    assert fit.rank < fit.terms
    assert any("xi^2" in text for text in fit.undetermined)


def test_fit_to_finite_elements_of_a_leaf_has_the_expected_error():
    """Held-out errors are below 0.5 % and below twice the expected errors."""
    trials = tj.energies.read_trials(REFERENCE / "fe_leaf.csv")
    assert len(trials) == 122 and trials.wrenches is not None
    held_out = np.arange(len(trials)) % 8 == 7
    fit = tj.fit_energy(trials[~held_out], symmetry="leaf")
    wrenches = jax.vmap(fit.energy.wrench)(trials.poses[held_out])
    error = np.asarray(trials.wrenches[held_out] - wrenches)
    size = np.sqrt(np.mean(np.asarray(trials.wrenches) ** 2, axis=0))
    relative = np.sqrt(np.mean(error**2, axis=0)) / size
    assert np.all(relative < 5e-3)
    assert np.all(relative < 2 * fit.expected.relative)
    assert np.all(fit.expected.relative < 5e-3)


def test_fit_to_finite_elements_of_a_notch_is_accurate():
    trials = tj.energies.read_trials(REFERENCE / "fe_notch.csv")
    fits = [
        tj.fit_energy(trials, 4, symmetry="leaf", hold_out=0.25, seed=seed)
        for seed in range(4)
    ]
    held_out = [fit.held_out.relative for fit in fits if fit.held_out is not None]
    error = np.sqrt(np.mean(np.square(held_out), axis=0))
    assert np.all(error < 1e-3)
    np.testing.assert_allclose(fits[0].expected.relative / error, 1.0, atol=0.5)
    stiffness = jnp.diag(fits[0].energy.tangent_stiffness())
    np.testing.assert_allclose(stiffness, [2.3875, 1.9406e8, 1.6210e7], rtol=2e-3)


def test_fit_to_random_trials_interpolates_and_raises_a_warning():
    """Section 7.1: 17 trials have 51 values, for 69 coefficients of fourth order."""
    trials = tj.energies.read_trials(REFERENCE / "random_trials.csv")
    settings = {"redundant": True, "reference": "free", "ridge": 0.0, "hold_out": 1 / 17}
    with pytest.warns(UserWarning, match="69 coefficients for 51 measured values"):
        fit = tj.fit_energy(trials, order=4, **settings)
    assert fit.rank == 51
    assert np.all(fit.training.largest_wrench < 2.6e-5)
    assert np.all(np.isinf(fit.expected.rms_wrench))
    assert fit.held_out is not None
    assert np.all(fit.held_out.relative > 1.0)  # predicting zero gives 1
    assert "warning: the fit interpolates" in repr(fit)


def leaf_trials():
    """Trials of a leaf by finite elements; rotations up to 46 degrees."""
    return tj.energies.read_trials(REFERENCE / "fe_leaf.csv")


DEGREE = np.pi / 180


@pytest.mark.parametrize(
    ("pose_units", "wrench_units", "message"),
    [
        ([1, 1, 1], [-1, -1, -1], "In 61 of 61 trials the wrench points back"),
        ([1, 1, 1], [1, -1, 1], "if the sign of the forces along axis 1 is reversed"),
        pytest.param(
            *([DEGREE, 1e-3, 1e-3], [1e-3, 1, 1], "more than one turn: are the angles"),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            *([1, 1e-3, 1e-3], [1, 1, 1], "smaller if the translations are in millim"),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            *([1, 1, 1], [1e-3, 1, 1], "times smaller if the moments are in N mm"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_wrong_units_and_signs_of_trials_are_recognized(
    pose_units, wrench_units, message
):
    """The finite-element trials in other units, read as if they were in SI units."""
    trials = leaf_trials()[np.arange(0, 122, 2)]
    assert trials.wrenches is not None
    wrong = tj.energies.Trials(
        trials.poses / np.array([pose_units], float),
        trials.wrenches / np.array([wrench_units], float),
    )
    with pytest.warns(UserWarning, match="the error at new trials is up to") as caught:
        fit = tj.fit_energy(wrong, order=4, symmetry="leaf")
    assert message in str(caught[0].message) and message in repr(fit)


@pytest.mark.parametrize("factor", mostly_slow([1e3, -1.0]))
def test_wrong_moments_of_noisy_trials_are_recognized(factor):
    """The fits with other units have the symmetry of the hinge, as trials are few."""
    trials = leaf_trials()[np.arange(0, 122, 2)]
    wrenches = np.asarray(trials.wrenches)
    noise = np.random.default_rng(3).normal(size=wrenches.shape)
    noise *= 5e-3 * np.sqrt(np.mean(wrenches**2, axis=0))
    wrong = tj.energies.Trials(
        trials.poses, (wrenches + noise) * np.array([factor, 1.0, 1.0])
    )
    message = "sign of the moments" if factor < 0 else "moments are in N mm"
    with pytest.warns(UserWarning, match=message):
        tj.fit_energy(wrong, order=4, coordinates="mixed", symmetry="leaf")


def test_negative_definite_stiffness_raises_a_warning():
    """A free reference does not exclude the energy of reversed wrenches."""
    trials = random_trials(-1.0 * tj.Quadratic(some_stiffness(3)), 20)
    with pytest.warns(UserWarning, match="all eigenvalues of the stiffness"):
        fit = tj.fit_energy(trials, order=2, reference="unstressed")
    assert_close(fit.stiffness, -some_stiffness(3), digits=9)


def test_component_without_measured_values_has_a_small_relative_error():
    """Rounding errors of a force that is zero are no error of 100 %."""
    slider = tj.Quadratic(np.diag([2.0, 0.0, 9.0]), "twist")
    poses = random_trials(slider, 30).poses * np.array([[0.0, 1.0, 1.0]])
    wrenches = jax.vmap(slider.wrench)(poses)
    noise = 1e-9 * np.random.default_rng(0).normal(size=(30, 3))
    trials = tj.energies.Trials(poses, wrenches + noise)
    fit = tj.fit_energy(trials, order=2, reference="unstressed")
    assert np.all(fit.expected.relative < 1e-3)


def test_validity_range_is_that_of_the_trials():
    fit = tj.fit_energy(leaf_trials(), 4, coordinates="mixed", symmetry="leaf")
    limited = fit.with_validity_range
    assert_close(limited.rotation, 0.8)
    wrenches = leaf_trials().wrenches
    assert wrenches is not None
    assert_close(limited.force, np.max(np.linalg.norm(wrenches[:, 1:], axis=1)))
    assert_close(limited.error, fit.expected.relative)


def test_search_of_orders_ends_when_the_error_increases(monkeypatch):
    """Trials of a quadratic energy with noise; order 2 is the best one."""
    from twistorjax.energies.fitting import polynomial

    orders, fit_order = [], polynomial._candidate

    def record(trials, order, *others):
        orders.append(order)
        return fit_order(trials, order, *others)

    monkeypatch.setattr(polynomial, "_candidate", record)
    trials = random_trials(tj.Quadratic(some_stiffness(3)), 100, noise=0.01)
    fit = tj.fit_energy(trials)
    assert fit.energy.order == 2 and orders == [2, 3, 4]


def write(path, text):
    path.write_text(text)
    return path


HEAD = "angle_rad,px_m,py_m,moment_Nm,fx_N,fy_N"


def test_columns_of_a_file_are_found_by_their_names(tmp_path):
    text = "fy_N,note,angle_rad,px_m,py_m,moment_Nm,fx_N\n6,first,1,2,3,4,5\n"
    trials = tj.energies.read_trials(write(tmp_path / "t.csv", text))
    assert_close(trials.poses, np.array([[1.0, 2.0, 3.0]]))
    assert_close(trials.wrenches, np.array([[4.0, 5.0, 6.0]]))
    assert trials.energies is None


def test_units_in_the_header_are_converted(tmp_path):
    """180 degrees are pi; 1 mm, N mm, mJ are 1e-3; a kN is 1000 N."""
    text = (
        "# rig 3\nangle_deg,px_mm,py_\u00b5m,moment_N mm,fx_kN,fy_mN,energy_mJ,"
        "sd_moment_Nmm,sd_fx_N,sd_fy_N,sd_energy_J\n"
        "180,1,2,3,4,5,6,7,8,9,10\n\n  # a pause\n-90,1,2,3,4,5,6,7,8,9,10\n"
    )
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8")
    trials = tj.energies.read_trials(path)
    assert_close(trials.poses, [[np.pi, 1e-3, 2e-6], [-np.pi / 2, 1e-3, 2e-6]])
    assert_close(trials.wrenches, [[3e-3, 4e3, 5e-3]] * 2)
    assert_close(trials.energies, [6e-3] * 2)
    assert_close(trials.wrench_deviations, [[7e-3, 8.0, 9.0]] * 2)
    assert_close(trials.energy_deviations, [10.0] * 2)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_header_may_be_a_comment_after_a_byte_order_mark(tmp_path, encoding):
    """`numpy.savetxt` writes the header as a comment."""
    path = tmp_path / "t.csv"
    path.write_text(f"# made by a rig\r\n# {HEAD}\r\n1,2,3,4,5,6\r\n", encoding=encoding)
    trials = tj.energies.read_trials(path)
    assert_close(trials.poses, [[1.0, 2.0, 3.0]])
    assert_close(trials.wrenches, [[4.0, 5.0, 6.0]])


@pytest.mark.parametrize("separator", [";", "\t"])
def test_separator_is_found_in_the_first_line(tmp_path, separator):
    text = f"{HEAD}\n1,2,3,4,5,6\n".replace(",", separator)
    trials = tj.energies.read_trials(write(tmp_path / "t.csv", text))
    assert_close(trials.wrenches, np.array([[4.0, 5.0, 6.0]]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "lacks the column angle_rad"),
        ("angle_rad,px_m\n1,2\n", "lacks the column py_m"),
        (f"{HEAD}\n1,2,3,4,5,6\n1,2,3\n", "line 3: it has 3 entries"),
        (f"{HEAD}\n1,2,3,4,5,nan\n", "line 2: fy_N is nan"),
        (f"{HEAD}\n1,2,3,4,five,6\n", "line 2: fx_N is five"),
        (f"{HEAD}\n", "has no trials"),
        (f"{HEAD},fx_N\n1,2,3,4,5,6,7\n", "has the column fx_N more than once"),
        (f"{HEAD},sd_fx_N\n1,2,3,4,5,6,7\n", "lacks the column sd_moment_Nm, sd_fy_N"),
        (f"{HEAD},px_mm\n1,2,3,4,5,6,7\n", "has the column px twice, in different"),
        (f"{HEAD}\n1,2,3,4,5,6\n# 2\n1,2,3,4,5,x\n", "line 4: fy_N is x"),
        (HEAD.replace("fx", "f"), "Optional are the standard deviations sd_moment_Nm"),
        (HEAD.replace("px_m", "px_inch"), "the unit of px must be one of m, cm, mm"),
        ("angle_rad;px_m;py_m;energy_J\n1;2;3;1,5\n", "is 1,5, but must be a finite"),
        (f'"a\nnote",{HEAD}\n1,2,3,4,5,6,x\n', "line 3: fy_N is x"),
        (f"{HEAD}\n1,2,3,4,1_0,6\n", "line 2: fx_N is 1_0, but must be a finite"),
        (f"{HEAD}\n1,2,3,4,\u0661,6\n", "line 2: fx_N is \u0661, but must be a finite"),
        (f"{HEAD},note\n1,2,3,4,5,6,{'x' * 200_000}\n", "line 2: an entry cannot be"),
        (f'{HEAD},note\n1,2,3,4,5,6,"x\n1,2,3,4,5,6,x\n', "a quotation mark missing"),
        (f"{HEAD},sd_fx_N,sd_fy_N,sd_moment_Nm\n1,2,3,4,5,6,0,1,1\n", "must be positive"),
    ],
)
def test_message_about_a_damaged_file_names_the_line(tmp_path, text, message):
    with pytest.raises(ValueError) as error:
        tj.energies.read_trials(write(tmp_path / "trials.csv", text))
    assert "trials.csv" in str(error.value)
    assert message in str(error.value)


def test_binary_file_raises_an_error(tmp_path):
    path = tmp_path / "trials.csv"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match="is not a UTF-8 text file"):
        tj.energies.read_trials(path)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tj.energies.Trials([[0, 0, 0]]), "need `wrenches` or `energies`"),
        (lambda: tj.energies.Trials([0, 0, 0], energies=[1.0]), "a row (angle, x, y)"),  # pyright: ignore[reportArgumentType]
        (lambda: tj.energies.Trials([[0, 0, 0]], [[1.0, 2.0]]), "for each of 1 poses"),
        (
            lambda: tj.energies.Trials([[0, 0, np.nan]], energies=[1.0]),
            "`poses` has [0.0, 0.0, nan] at",
        ),
        (
            lambda: tj.energies.WithValidityRange(random_energy(), 1, 1, [0, -0.1, 0]),
            "`error` is [0.0, -0.1, 0.0], but must not be negative",
        ),
        (
            lambda: tj.fit_energy(random_trials(random_energy(), 5), 2, hold_out=1.5),
            "`hold_out` is 1.5",
        ),
        (
            lambda: tj.fit_energy(random_trials(random_energy(), 5), 2, ridge=-1.0),
            "`ridge` is -1",
        ),
        (
            lambda: tj.fit_energy(tj.energies.Trials([[0, 0, 1e160]], [[1.0, 0, 0]]), 2),
            "`trials` have a value of 1e+160, but a fit needs values of at most 1e100",
        ),
        (
            lambda: tj.fit_energy(
                random_trials(random_energy(), 5),
                2,
                reference="relaxed",  # pyright: ignore[reportArgumentType]
            ),
            "'stable'",
        ),
    ],
)
def test_invalid_arguments_raise_an_error(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert message in str(error.value)


def energies():
    polynomial = random_energy().parts[1]
    squares = tj.energies.SumOfSquares(
        [[0.1, 0.7]], [(0, 1, 0, 0), (0, 0, 0, 1)], scale=1 / 3
    )
    charges = tj.energies.PointCharges([1 / 3, -0.1], [[0.1, 0.0], [-0.3, 0.7]])
    return [
        polynomial,
        0.3 * random_energy("twist"),
        tj.energies.Rational(polynomial, squares),
        charges,
    ]


@pytest.mark.parametrize(
    "energy", energies(), ids=["polynomial", "sum", "rational", "charges"]
)
def test_saved_energy_is_loaded_to_the_last_bit(tmp_path, energy):
    tj.io.save_energy(energy, tmp_path / "hinge.json")
    loaded = tj.io.load_energy(tmp_path / "hinge.json")
    assert jax.tree.structure(loaded) == jax.tree.structure(energy)
    arrays = zip(jax.tree.leaves(loaded), jax.tree.leaves(energy), strict=True)
    for actual, expected in arrays:
        assert np.asarray(actual).tobytes() == np.asarray(expected).tobytes()


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_energy_is_loaded_from_a_file_with_a_byte_order_mark(tmp_path, encoding):
    path = tmp_path / "hinge.json"
    tj.io.save_energy(energies()[0], path)
    path.write_text(path.read_text(), encoding=encoding)
    loaded = tj.io.load_energy(path)
    assert isinstance(loaded, tj.energies.Polynomial)
    assert_close(loaded.coefficients, energies()[0].coefficients, digits=16)


def test_damaged_file_of_an_energy_raises_an_error(tmp_path):
    path = tmp_path / "hinge.json"
    tj.io.save_energy(energies()[0], path)
    text = path.read_text()
    for damaged, message in (
        (text[: len(text) // 2], "is damaged or not a JSON file"),
        (
            text.replace('"twistorjax": 6', '"twistorjax": 99'),
            "is 99, .* be one of 2, 3, 4, 5",
        ),
        (text.replace('"scale"', '"size"'), "`energy` has the unknown field `size`"),
        (text.replace('"Polynomial"', '"Spline"'), "must be one of Quadratic"),
        ("[1]", "is a list of 1 entry, but must be an object"),
    ):
        with pytest.raises(ValueError, match=message) as error:
            tj.io.load_energy(write(path, damaged))
        assert "hinge.json" in str(error.value)
