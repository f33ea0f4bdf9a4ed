"""Compliance, stiffness, and center of compliance at a port."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, some_stiffness

import twistorjax as tj
from twistorjax.geometry import se2


UP = np.pi / 2
MODULUS, LENGTH, THICKNESS, WIDTH, SPACING = 210e9, 0.05, 0.5e-3, 0.01, 0.04
STEEL = tj.Material(MODULUS, poisson=0.3)


def guide(thickness=THICKNESS):
    """Return a table on two parallel leaves along y."""
    leaf = tj.flexures.leaf(STEEL, length=LENGTH, thickness=thickness, width=WIDTH)
    hinges = [
        tj.Hinge(name, "base", "table", leaf, (UP, x, LENGTH / 2))
        for name, x in (("left", -SPACING / 2), ("right", SPACING / 2))
    ]
    bodies = [tj.Body("base"), tj.Body("table", (0.4, 0.01, LENGTH + 0.02))]
    return tj.Mechanism(bodies, hinges, fixed=["base"])


def test_stiffness_of_one_hinge_is_transformed_to_the_port():
    stiffness = some_stiffness(3)
    frame, body, port = np.array([[0.3, 0.2, 0.1], [-0.5, 0.4, 0.7], [0.8, -0.2, 0.3]])
    hinge = tj.Hinge("h", "a", "b", tj.Quadratic(stiffness), frame)
    mechanism = tj.Mechanism([tj.Body("a"), tj.Body("b", body)], [hinge], fixed=["a"])
    found = tj.port_compliance(mechanism, "b", port)

    @jax.jit
    def transformed(frame, body, port):
        to_frame = se2.between(se2.compose(body, port), frame)
        return se2.transform_stiffness(to_frame, jnp.asarray(stiffness))

    expected = np.asarray(transformed(frame, body, port))
    assert_close(found.stiffness, expected, digits=10)
    assert_close(np.asarray(found.compliance) @ expected, np.eye(3), digits=10)


def test_center_of_a_parallel_guide_is_between_its_leaves():
    """Stiffnesses of beams: 24 EI/L^3 across, 2 EA/L along, 2 EI/L + EA s^2/(2 L)."""
    mechanism = guide()
    port = jax.jit(se2.inverse)(mechanism.reference[1])
    found = tj.port_compliance(mechanism, "table", port)
    area, inertia = WIDTH * THICKNESS, WIDTH * THICKNESS**3 / 12
    np.testing.assert_allclose(found.center, [0.0, LENGTH / 2], atol=1e-12)
    along, across = 2 * MODULUS * area / LENGTH, 24 * MODULUS * inertia / LENGTH**3
    assert_close(np.asarray(found.principal_stiffnesses) / [along, across], [1, 1])
    directions = np.abs(np.asarray(found.principal_directions))
    assert_close(directions, np.eye(2)[::-1], digits=10)
    rotational = 2 * MODULUS * inertia / LENGTH
    rotational += MODULUS * area * SPACING**2 / (2 * LENGTH)
    ratio = np.asarray(found.rotational_stiffness) / rotational
    assert_close(ratio, 1.0, digits=11)


def test_a_force_through_the_center_does_not_rotate_the_port():
    mechanism = guide()
    load = tj.Load("table", force=(3.0, 1.0))
    state = tj.equilibrium(mechanism, loads=[load])
    found = tj.port_compliance(mechanism, "table", about=state, loads=[load])
    push = tj.Load("table", force=(0.3, -0.7), at=found.center)
    linear = tj.linearize(mechanism, about=state, loads=[load])
    small = linear(loads=[push])
    assert abs(np.asarray(small.displacement("table"))[0]) < 1e-16
    turn = tj.Load("table", moment=1e-3)
    change = np.asarray(linear(loads=[turn]).displacement("table"))
    angle = np.asarray(state.pose("table"))[0]
    cos, sin = np.cos(angle), np.sin(angle)
    arm = np.array([[cos, -sin], [sin, cos]]) @ np.asarray(found.center)
    still = change[1:] + change[0] * np.array([-arm[1], arm[0]])
    np.testing.assert_allclose(still, 0.0, atol=1e-15)
    assert_close(change[0], 1e-3 / np.asarray(found.rotational_stiffness))


@pytest.mark.slow
def test_the_compliance_is_differentiable_and_batched():
    def stiffness(thickness):
        found = tj.port_compliance(guide(thickness), "table")
        return found.principal_stiffnesses[1]

    thicknesses = jnp.array([0.3e-3, 0.5e-3])
    values, slopes = jax.vmap(jax.value_and_grad(stiffness))(thicknesses)
    assert_close(slopes * thicknesses / values, [3.0, 3.0], digits=10)


def test_constraints_and_prescribed_coordinates_stiffen_the_port():
    positions = {"base": 0.0, "arm": 0.1, "tip": 0.2}
    bodies = [tj.Body(name, (0.0, x, 0.0)) for name, x in positions.items()]
    spring = tj.Quadratic(np.diag([2.0, 50.0, 80.0]))
    hinges = [
        tj.Hinge("one", "base", "arm", spring, (0.0, 0.1, 0.0)),
        tj.Hinge("two", "arm", "tip", spring, (0.0, 0.2, 0.0)),
    ]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["base"])
    held = tj.port_compliance(mechanism, "tip", prescribed=["arm"])
    assert_close(held.stiffness, np.diag([2.0, 50.0, 80.0]))
    pin = tj.Pin("pin", "base", "arm", at=(0.1, 0.0))
    pinned = tj.port_compliance(mechanism, "tip", constraints=[pin])
    expected = 1 / 80.0 + 0.1**2 / 2.0
    assert_close(np.asarray(pinned.compliance)[2, 2], expected, digits=10)


def test_ports_without_compliance_are_reported():
    with pytest.raises(ValueError, match="on 'base', but angle of 'base' and x of"):
        tj.port_compliance(guide(), "base")
    with pytest.raises(ValueError, match="`body` names the body 'lid'"):
        tj.port_compliance(guide(), "lid")
