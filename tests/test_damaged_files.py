"""Random damage to files: they are read correctly, or rejected with a clear message."""

import pytest
from random_damage import (
    check_examples,
    damaged_bytes,
    damaged_columns,
    damaged_trees,
    energies,
    MEASUREMENTS,
    mechanism,
    random_examples,
    TRIALS,
)

import twistorjax as tj


pytestmark = [
    pytest.mark.untyped,
    # The outlines of the saved models are those of no real body.
    pytest.mark.filterwarnings("ignore:The mass of the body"),
    pytest.mark.filterwarnings("ignore:`inertia` of the body"),
    pytest.mark.filterwarnings("ignore:The size of the outline"),
    pytest.mark.filterwarnings("ignore:The (start of the )?hinge"),
]


def assert_clear(error, path):
    """The message is one line that names the file and can be printed."""
    message = str(error)
    assert str(path) in message
    assert "\n" not in message and len(message) < 1500
    message.encode()


@pytest.mark.filterwarnings("ignore:.*more than a full turn")
@pytest.mark.parametrize("damaged", [damaged_trees, damaged_bytes])
@random_examples(slow=100, release=3000)
def test_a_damaged_file_of_a_mechanism_or_energy(tmp_path, damaged, examples):
    """It is rejected, or its content does not change when it is written and read."""
    path, again = tmp_path / "damaged.json", tmp_path / "again.json"
    tj.io.save_mechanism(mechanism(), path)
    originals = [path.read_bytes()]
    for energy in energies():
        tj.io.save_energy(energy, path)
        originals.append(path.read_bytes())

    def check_as(load, save):
        try:
            loaded = load(path)
        except ValueError as error:
            assert_clear(error, path)
            return
        save(loaded, path)
        save(load(path), again)
        assert again.read_bytes() == path.read_bytes()

    def check(content):
        path.write_bytes(content)
        check_as(tj.io.load_mechanism, tj.io.save_mechanism)
        check_as(tj.io.load_energy, tj.io.save_energy)

    check_examples(examples, damaged(originals), check)


@pytest.mark.filterwarnings("ignore:.*more than a full turn")
@pytest.mark.parametrize("damaged", [damaged_columns, damaged_bytes])
@random_examples(slow=120, release=1200)
def test_a_damaged_csv_file(tmp_path, damaged, examples):
    """It is read, or raises an error with a short message."""
    path = tmp_path / "damaged.csv"
    arguments = {
        "standard_deviations": {"a.force_1": 1e-3},
        "velocities": {"3": (0.0, 1.0, 0.0)},
    }

    def check(content):
        path.write_bytes(content)
        options = arguments if b"time" in content else {}
        for read in (
            tj.energies.read_trials,
            lambda path: tj.identification.read_measurements(path, **options),
        ):
            try:
                read(path)
            except ValueError as error:
                message = str(error)
                assert "\n" not in message and len(message) < 1500
            except TypeError as error:  # the arguments belong to another kind of test
                assert "unexpected keyword argument" in str(error)

    originals = [text.encode() for text in (TRIALS, *MEASUREMENTS)]
    check_examples(examples, damaged(originals), check)
