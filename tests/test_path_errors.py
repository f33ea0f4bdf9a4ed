"""Messages of `path` about wrong arguments and about failures."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from path_helpers import parallel_links

import twistorjax as tj
from twistorjax.examples.truss import von_mises_truss
from twistorjax.solve.continuation.solution import CriticalPoint


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


@pytest.mark.untyped
def test_a_limit_point_is_no_start():
    truss = von_mises_truss()
    limit: Any = CriticalPoint(
        load_factor=jnp.array(0.4975),
        displacements=jnp.zeros((2, 3)),
        reference=truss.reference,
        energy=jnp.array(1.0),
        names=truss.names,
        mode=jnp.zeros((2, 3)),
        reactions=jnp.zeros((2, 3)),
        is_branch=jnp.array(False),
        length=jnp.array(1.0),
    )
    with pytest.raises(ValueError, match="no other path leaves at a limit point"):
        tj.path(truss, loads=[PUSH], start=limit)
    with pytest.raises(ValueError, match="`start` is a critical point"):
        tj.bistability(truss, loads=[PUSH], start=limit)


@pytest.mark.untyped
def test_a_comparison_does_not_end_a_path():
    with pytest.raises(TypeError, match="instead of `a < b`"):
        tj.path(
            von_mises_truss(),
            loads=[PUSH],
            until=lambda point: point.pose("apex")[2] < 0.0,
        )


def test_an_array_does_not_end_a_path():
    with pytest.raises(TypeError, match=r"returns an array of shape \(3,\)"):
        tj.path(von_mises_truss(), loads=[PUSH], until=lambda point: point.pose("apex"))


@pytest.mark.slow
def test_critical_points_that_are_not_located_are_reported():
    links, loads = parallel_links([0.3, 0.5, 0.7])
    with pytest.warns(UserWarning, match="`max_critical` is 2, but the stability"):
        found = tj.path(links, loads=loads, max_critical=2)
    np.testing.assert_allclose(found.critical_points.load_factors, [0.3, 0.5], rtol=1e-8)
    tj.path(links, loads=loads, max_critical=3)


def before(end, limit, point):
    """Function that is zero at the angle `end`, and not a number above `limit`; rad."""
    angle = point.displacement("block")[0]
    return jnp.where(angle > limit, jnp.nan, angle - end)


def turn_a_block(stiffness=1.0, largest_step=0.1, end=9.0, limit=9.0, **arguments):
    """Follow the path of a block under a moment, on a spring valid to 0.5 rad."""
    until = jax.tree_util.Partial(before, *map(jax.device_put, (end, limit)))
    spring = tj.Quadratic(np.diag([stiffness, 1.0, 1.0]))
    narrow = tj.energies.WithValidityRange(
        spring, rotation=0.5, force=1e6, error=[0.0, 0.0, 0.0]
    )
    hinge = tj.Hinge("spring", "wall", "block", narrow, at=(0.0, 0.0, 0.0))
    block = tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])
    turn = [tj.Load("block", moment=1.0)]
    return tj.path(
        block, loads=turn, max_points=16, largest_step=largest_step, until=until,
        **arguments,
    )  # fmt: skip


@pytest.mark.slow
def test_a_body_that_nothing_supports():
    with pytest.raises(RuntimeError, match=r"Nothing resists .* angle of 'block'"):
        turn_a_block(stiffness=0.0)


@pytest.mark.slow
def test_too_few_points():
    with pytest.raises(RuntimeError, match="largest number of points") as error:
        turn_a_block(largest_step=0.01)
    assert "16 points up to the load factor" in error.value.__notes__[0]
    found = turn_a_block(largest_step=0.01, throw=False)
    assert len(found.load_factors) == 16 and not bool(found.succeeded)


@pytest.mark.slow
def test_a_hinge_that_leaves_its_validity_range_is_named():
    with pytest.raises(RuntimeError, match=r"The hinge 'spring': its rotation is 0\.5"):
        turn_a_block()


def test_a_path_ends_before_a_hinge_leaves_its_validity_range():
    found = turn_a_block(throw=False)
    assert str(tj.result_names(found.result)) == "out_of_range"
    assert 0.3 < np.asarray(found.displacement("block"))[-1, 0] <= 0.5


@pytest.mark.parametrize("limit", [0.3, -1.0])
def test_a_condition_that_is_not_a_number(limit):
    """At the first point, or behind a point of the path."""
    with pytest.raises(RuntimeError, match="`until` returned NaN"):
        turn_a_block(end=0.45, limit=limit)
    found = turn_a_block(end=0.45, limit=limit, throw=False)
    assert str(tj.result_names(found.result)) == "until_not_a_number"


class JumpingStiffness(tj.energies.AbstractEnergy):
    """The transverse stiffness changes its sign at an angle of 0.3 rad."""

    def stored_energy(self, displacement):
        angle, x, y = displacement.angle, displacement.x1, displacement.x2
        return (angle**2 + x**2 + jnp.sign(0.3 - angle) * y**2) / 2


@pytest.mark.slow
def test_a_change_of_stability_without_a_critical_point_ends_a_path():
    hinge = tj.Hinge("spring", "wall", "block", JumpingStiffness(), at=(0.0, 0.0, 0.0))
    block = tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])
    turn = [tj.Load("block", moment=1.0)]
    with pytest.raises(RuntimeError, match="explains this change"):
        tj.path(block, loads=turn)
    found = tj.path(block, loads=turn, throw=False)
    assert str(tj.result_names(found.result)) == "critical_point_not_found"
    assert found.stable.all() and 0.2 < float(found.load_factors[-1]) < 0.3
