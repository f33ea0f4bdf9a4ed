"""A parallelogram flexure under large loads, compared with 3-D finite elements."""

import json
import pathlib

import numpy as np
import pytest

from twistorjax.examples import parallelogram as example


FILE = pathlib.Path(__file__).parent / "reference" / "parallelogram_fe3d.csv"


@pytest.fixture(scope="module")
def study():
    """Return the displacements in the 101 load cases of the finite elements."""
    return example.study(example.read_cases(FILE))


@pytest.mark.slow
def test_every_load_case_of_the_finite_elements_is_computed(study):
    assert len(study.names) == 101 and np.all(study.succeeded)
    assert "101 of 101 load cases computed, bending factor 1.04" in str(study)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("transverse", "largest"),
    [("0 to 5", (1.0, 0.3, 3.5)), ("5 to 10", (0.8, 0.6, 2.0))],
)
def test_the_median_errors_are_those_of_the_mesh(study, transverse, largest, validated):
    """These are percents of ux, uy and phi; the axial loads are up to 5 E I / L^2."""
    count, computed, median = study.medians()[transverse]
    assert count == computed >= 30
    assert np.all(100 * median <= largest)
    what = f"parallelogram, transverse load {transverse} E I / L², median (phi)"
    oracle = "101 analyses by solid finite elements"
    validated("Surrogates", what, 1 + median[2], 1.0, oracle)


@pytest.mark.slow
def test_the_median_errors_at_loads_up_to_20_are_below_those_of_beam_elements(study):
    """Beam elements have 4.1 %, 1.3 % and 44 %; see the source of the load cases."""
    count, computed, median = study.medians()["10 to 20"]
    assert count == computed == 30
    assert np.all(100 * median < [4.1, 1.3, 44.0])


@pytest.mark.slow
def test_the_command_prints_the_cases_in_their_order(study, run_here):
    """Above twice the buckling load pi^2 E I / L^2 of a leaf there is no equilibrium."""
    rows = [100, 3, 57]
    first, *lines = FILE.read_text().splitlines()
    columns = "transverse_EI_L2,axial_EI_L2,moment_EI_L"
    assert first.startswith(columns)
    loads = [",".join(lines[row].split(",")[:3]) for row in rows]
    content = "\n".join([columns, *loads[:2], "2,-30,0", loads[2]])
    (run_here.folder / "cases.csv").write_text(content)
    done = run_here("parallelogram", "--cases", "cases.csv", "--json")
    assert done.returncode == 0
    found = json.loads(done.stdout)
    assert list(found) == ["ux_L", "uy_L", "phi_rad", "result"]
    assert found["result"] == ["successful", "successful", "no_equilibrium", "successful"]
    for key, column in (("ux_L", 0), ("uy_L", 1), ("phi_rad", 2)):
        expected = study.displacements[rows, column]
        np.testing.assert_allclose(
            [found[key][k] for k in (0, 1, 3)], expected, rtol=1e-6, atol=1e-10
        )
        assert found[key][2] is None


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("transverse_EI_L2,axial_EI_L2\n1,0\n", "has no column moment_EI_L. The first"),
        ("transverse_EI_L2,axial_EI_L2,moment_EI_L\n", "has no load cases. The first"),
        (
            "transverse_EI_L2,axial_EI_L2,moment_EI_L,ux_L\n1,0,0,0\n",
            "has the column ux_L, but a comparison needs all of ux_L, uy_L, phi_rad",
        ),
        (
            "transverse_EI_L2,axial_EI_L2,moment_EI_L\n1,0,much\n",
            "moment_EI_L is much, but",
        ),
        (
            "transverse_EI_L2,axial_EI_L2,moment_EI_L\n1,0,nan\n",
            "moment_EI_L is nan, but",
        ),
        (
            "transverse_EI_L2,axial_EI_L2,moment_EI_L\n1,0\n",
            "cases.csv, line 2: it has 2",
        ),
        (None, "cases.csv"),
    ],
)
def test_a_file_that_cannot_be_used_is_reported(content, message, run_here):
    if content is not None:
        (run_here.folder / "cases.csv").write_text(content)
    done = run_here("parallelogram", "--cases", "cases.csv")
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("twistorjax: ") and done.stderr.count("\n") == 1
    assert message in done.stderr


def test_a_bending_factor_that_is_not_positive_is_reported(run_here):
    done = run_here("parallelogram", "--bending-factor", "0")
    assert done.returncode == 2 and "--bending-factor" in done.stderr


def test_a_study_without_expected_results_has_no_errors():
    cases = example.default_cases()
    assert cases.loads.shape == (18, 3) and cases.expected is None
    without = example.Study(cases, np.zeros((18, 3)), example.RESULTS.successful, 1.0)
    with pytest.raises(
        ValueError, match=r"no expected results\. Add the columns ux_L, uy"
    ):
        without.medians()
