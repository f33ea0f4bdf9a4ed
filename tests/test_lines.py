"""Line vectors, and wrenches as line vectors."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close

from twistorjax.geometry import lines, se2


ROOT = np.sqrt(3)


def test_a_line_vector_does_not_change_if_it_is_shifted_along_its_line():
    start, vector = jnp.array([1.0, 2.0]), jnp.array([0.3, -0.4])
    shifted = start + 2.5 * vector
    assert_close(lines.line(shifted, shifted + vector), lines.line(start, start + vector))


def test_the_moment_of_a_line_vector_is_its_distance_times_its_length():
    vector = lines.line(jnp.array([4.0, 7.0]), jnp.array([4.0, 9.0]))
    assert_close(vector, [8.0, 0.0, 2.0])  # equation 2.47: 4 m from the origin


def test_the_resultant_of_section_2_4():
    first = lines.force(jnp.array([4.0, 0.0]), 3 * jnp.array([ROOT / 2, 0.5]))
    second = lines.force(jnp.array([2.0, 0.0]), 3 * jnp.array([0.5, ROOT / 2]))
    total = first + second
    assert_close(total, [6 + 3 * ROOT, 1.5 * (1 + ROOT), 1.5 * (1 + ROOT)])
    resultant = lines.resultant(total)
    assert_close(resultant.magnitude, 1.5 * (1 + ROOT) * np.sqrt(2))
    assert_close(resultant.direction, np.pi / 4)
    # The line passes through (sqrt(3) + 1, 0), about which the force has no moment.
    shift = jnp.array([0.0, -(ROOT + 1), 0.0])
    assert_close(se2.transform_wrench(shift, total)[0], 0.0)


def test_the_resultant_at_its_foot_is_the_wrench():
    wrench = jnp.array([2.0, -0.7, 1.9])
    resultant = lines.resultant(wrench)
    force = resultant.magnitude * jnp.stack(
        [jnp.cos(resultant.direction), jnp.sin(resultant.direction)]
    )
    assert_close(lines.force(resultant.foot, force), wrench)
    assert_close(resultant.foot @ force, 0.0)


def test_the_line_of_action_of_a_couple_is_at_infinity():
    couple = lines.force(jnp.array([0.0, 1.0]), jnp.array([2.0, 0.0]))
    couple += lines.force(jnp.array([0.0, 4.0]), jnp.array([-2.0, 0.0]))
    assert_close(couple, [6.0, 0.0, 0.0])
    resultant = lines.resultant(couple)
    assert resultant.magnitude == 0.0
    assert np.all(np.isinf(resultant.foot))


@pytest.mark.parametrize("wrench", [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
def test_the_direction_of_a_zero_force_is_zero(wrench):
    assert lines.resultant(jnp.array(wrench)).direction == 0.0
