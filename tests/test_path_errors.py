"""Messages of `path` about wrong arguments and about failures."""

import numpy as np
import pytest
from path_helpers import bars_of_a_truss, truss_of

import twistorjax as tj
from twistorjax.examples.truss import von_mises_truss


PUSH = tj.Load("apex", force=(0.0, -20.0))


def test_nothing_is_multiplied():
    with pytest.raises(ValueError, match="Nothing is multiplied by the load factor"):
        tj.path(von_mises_truss())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"direction": 2}, "`direction` is 2, but must be 1 or -1"),
        ({"load_factors": (1, 0)}, r"`load_factors` is \(1, 0\)"),
        ({"max_points": 2}, "`max_points` must be at least 3"),
        ({"largest_step": 0.0}, "`largest_step`"),
        ({"load_factors": (0.5, 1)}, "must contain the load factor 0"),
        ({"load_factors": np.linspace(0, 1, 5)}, r"has the shape \(5,\)"),
    ],
)
def test_settings(arguments, message):
    with pytest.raises(ValueError, match=message):
        tj.path(von_mises_truss(), loads=[PUSH], **arguments)


def test_a_limit_point_is_no_start():
    limit = tj.path(von_mises_truss(), loads=[PUSH]).critical_points[0]
    with pytest.raises(ValueError, match="no other path leaves at a limit point"):
        tj.path(von_mises_truss(), loads=[PUSH], start=limit)


@pytest.mark.untyped
def test_a_comparison_does_not_end_a_path():
    with pytest.raises(TypeError, match="instead of `a < b`"):
        tj.path(
            von_mises_truss(),
            loads=[PUSH],
            until=lambda point: point.pose("apex")[2] < 0.0,
        )


def test_a_body_that_nothing_supports():
    free = truss_of(bars_of_a_truss(), apex=())
    with pytest.raises(RuntimeError, match=r"Nothing resists .* angle of 'apex'"):
        tj.path(free, loads=[PUSH])


def test_too_few_points():
    with pytest.raises(RuntimeError, match="largest number of points") as error:
        tj.path(von_mises_truss(), loads=[PUSH], max_points=20)
    assert "20 points up to the load factor" in str(error.value)
    found = tj.path(von_mises_truss(), loads=[PUSH], max_points=20, throw=False)
    assert len(found.load_factors) == 20 and not bool(found.succeeded)


def test_a_hinge_leaves_its_validity_range():
    narrow = tj.energies.WithValidityRange(
        tj.Quadratic(np.eye(3)), rotation=0.5, force=1e6, error=[0.0, 0.0, 0.0]
    )
    hinge = tj.Hinge("spring", "wall", "block", narrow, at=(0.0, 0.0, 0.0))
    block = tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])
    turn = [tj.Load("block", moment=1.0)]
    with pytest.raises(RuntimeError, match="outside the validity range"):
        tj.path(block, loads=turn)
    found = tj.path(block, loads=turn, throw=False)
    assert 0.3 < float(found.displacement("block")[-1, 0]) <= 0.5
