"""Line vectors, and wrenches as line vectors."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close

from twistorjax.geometry import lines, se2


ROOT = np.sqrt(3)


def test_a_line_does_not_know_its_points():
    start, along = jnp.array([1.0, 2.0]), jnp.array([0.3, -0.4])
    moved = start + 2.5 * along
    assert_close(lines.line(moved, moved + along), lines.line(start, start + along))


def test_its_moment_is_the_distance_times_the_length():
    vector = lines.line(jnp.array([4.0, 7.0]), jnp.array([4.0, 9.0]))
    assert_close(vector, [8.0, 0.0, 2.0])  # equation 2.47: 4 m from the origin


def test_the_resultant_of_section_2_4():
    first = lines.force(jnp.array([4.0, 0.0]), 3 * jnp.array([ROOT / 2, 0.5]))
    second = lines.force(jnp.array([2.0, 0.0]), 3 * jnp.array([0.5, ROOT / 2]))
    total = first + second
    assert_close(total, [6 + 3 * ROOT, 1.5 * (1 + ROOT), 1.5 * (1 + ROOT)])
    found = lines.resultant(total)
    assert_close(found.magnitude, 1.5 * (1 + ROOT) * np.sqrt(2))
    assert_close(found.direction, np.pi / 4)
    # through (sqrt(3) + 1, 0): seen from there the force has no moment
    there = jnp.array([0.0, -(ROOT + 1), 0.0])
    assert_close(se2.transform_wrench(there, total)[0], 0.0)


def test_the_resultant_acts_at_its_foot():
    wrench = jnp.array([2.0, -0.7, 1.9])
    found = lines.resultant(wrench)
    force = found.magnitude * jnp.stack(
        [jnp.cos(found.direction), jnp.sin(found.direction)]
    )
    assert_close(lines.force(found.foot, force), wrench)
    assert_close(found.foot @ force, 0.0)


def test_a_couple_is_a_force_on_the_line_at_infinity():
    pair = lines.force(jnp.array([0.0, 1.0]), jnp.array([2.0, 0.0]))
    pair += lines.force(jnp.array([0.0, 4.0]), jnp.array([-2.0, 0.0]))
    assert_close(pair, [6.0, 0.0, 0.0])
    found = lines.resultant(pair)
    assert found.magnitude == 0.0
    assert np.all(np.isinf(found.foot))


@pytest.mark.parametrize("wrench", [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
def test_no_force_has_no_direction_but_also_no_nan(wrench):
    assert lines.resultant(jnp.array(wrench)).direction == 0.0
