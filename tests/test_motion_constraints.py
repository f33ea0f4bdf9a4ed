"""Motion with pins, sliders, and other constraints."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from motion_helpers import oscillator

import twistorjax as tj
from twistorjax.examples import four_bar


GRAVITY = 9.81
MASS, INERTIA, ARM = 2.0, 0.3, 0.5  # of the pendulum; kg, kg m2, m


def released_bar(angle, times, step):
    """Simulate a bar that only a pin supports, beside a block on a spring."""
    bar = tj.Body("bar", pose=(0.0, 0.0, -ARM), mass=MASS, inertia=INERTIA)
    block = tj.Body("block", mass=1.0, inertia=1.0)
    hinge = tj.Hinge("spring", "wall", "block", tj.Quadratic(np.eye(3)), at=(0, 0, 0))
    mechanism = tj.Mechanism([tj.Body("wall"), block, bar], [hinge], fixed=["wall"])
    start = np.array(mechanism.reference)
    start[2] = angle, ARM * np.sin(angle), -ARM * np.cos(angle)
    return tj.simulate(
        mechanism,
        times,
        loads=[tj.Load("bar", force=(0, -MASS * GRAVITY))],
        constraints=[tj.Pin("pin", "wall", "bar", at=(0, 0))],
        start=start,
        step=step,
        energies=False,
    )


@pytest.fixture(scope="module")
def pendulum_motion():
    """Motion of a bar that is released at an angle of 1 rad, for 20 s."""
    return released_bar(1.0, np.linspace(0, 20, 51), step=2e-3)


def test_pendulum_conserves_energy_and_its_pin_carries_weight_and_inertia(
    pendulum_motion,
):
    motion = pendulum_motion
    angle, x, y = np.asarray(motion.displacement("bar")).T
    omega = np.asarray(motion.velocity("bar"))[:, 0]
    inertia_about_pin = INERTIA + MASS * ARM**2
    released_energy = MASS * GRAVITY * ARM * (np.cos(angle) - np.cos(1.0))
    assert_close(inertia_about_pin * omega**2 / 2, released_energy, digits=6)
    assert_close(x, ARM * np.sin(angle), digits=10)
    assert_close(y - ARM, -ARM * np.cos(angle), digits=10)
    along = MASS * (GRAVITY * np.cos(angle) + ARM * omega**2)
    acceleration = -MASS * GRAVITY * ARM * np.sin(angle) / inertia_about_pin
    across = MASS * (ARM * acceleration + GRAVITY * np.sin(angle))
    force_x = -along * np.sin(angle) + across * np.cos(angle)
    force_y = along * np.cos(angle) + across * np.sin(angle)
    expected = np.stack([force_x, force_y], axis=1)
    assert_close(motion.constraint_force("pin"), expected, digits=5)


def test_pin_does_not_drift_in_ten_thousand_steps(pendulum_motion):
    assert int(pendulum_motion.steps) == 10_000
    angle, x, y = np.asarray(pendulum_motion.displacement("bar"))[-1]
    distance = np.hypot(x - ARM * np.sin(angle), y - ARM + ARM * np.cos(angle))
    assert distance < 1e-10


def test_rod_that_only_a_pin_supports_is_a_physical_pendulum():
    inertia_about_pin = INERTIA + MASS * ARM**2
    period = 2 * np.pi * np.sqrt(inertia_about_pin / (MASS * GRAVITY * ARM))
    times, small = np.linspace(0.0, period, 51), 1e-3
    motion = released_bar(small, times, period / 1000)
    angle = np.asarray(motion.displacement("bar"))[::25, 0]
    np.testing.assert_allclose(angle, small * np.array([1, -1, 1]), atol=1e-8)


@pytest.mark.parametrize(
    "solver",
    [
        pytest.param(dfx.Tsit5(), id="tsit5", marks=pytest.mark.slow),
        pytest.param(dfx.Kvaerno5(), id="kvaerno5", marks=pytest.mark.release),
    ],
)
def test_pin_does_not_drift_with_solvers_of_diffrax(solver):
    """In twenty oscillations the bob stays on its circle and conserves its energy."""
    length, inertia = 0.5, 0.01
    spring = tj.Quadratic(1e-9 * np.eye(3))
    hinge = tj.Hinge("spring", "wall", "bob", spring, at=(0.0, 0.0, 0.0))
    bob = tj.Body("bob", (0.0, length, 0.0), mass=1.0, inertia=inertia)
    mechanism = tj.Mechanism([tj.Body("wall"), bob], [hinge], fixed=["wall"])
    motion = tj.simulate(
        mechanism,
        np.linspace(0, 30.0, 31),
        loads=[tj.Load("bob", force=(0.0, -GRAVITY))],
        constraints=[tj.Pin("pin", "wall", "bob", at=(0.0, 0.0))],
        solver=solver,
        tolerance=1e-4,
    )
    # These are the integrated states. The reported ones are projected once more.
    assert motion.solution.ys is not None
    angle, x, y = np.asarray(motion.solution.ys[0].position).T
    distance = np.hypot(length + x - length * np.cos(angle), y - length * np.sin(angle))
    assert np.max(distance) < 1e-5
    potential = GRAVITY * length * np.sin(angle)
    rate = np.asarray(motion.velocity("bob"))[:, 0]
    energy = (inertia + length**2) * rate**2 / 2 + potential
    assert np.max(np.abs(energy)) < 1e-3 * GRAVITY * length


@pytest.mark.slow
def test_slider_allows_one_translation():
    spring = tj.Quadratic(jnp.diag(jnp.array([0.0, 30.0, 0.0])))
    block = tj.Body("block", mass=2.0, inertia=0.1)
    hinge = tj.Hinge("spring", "wall", "block", spring, (0, 0, 0))
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], ["wall"])
    rail = tj.Slider("rail", "wall", "block", at=(np.pi / 6, 0, 0))
    times = np.array([0.0, 0.3, 0.7])
    motion = tj.simulate(
        mechanism,
        times,
        constraints=[rail],
        tolerance=1e-9,
        loads=[tj.Load("block", (0.2, 0.0, -4.0))],
        velocities={"block": (0.0, 0.0, 0.0)},
    )
    angle, x, y = motion.displacement("block").T
    assert_close(angle, np.zeros(3), digits=12)
    assert_close(y, np.tan(np.pi / 6) * x, digits=10)
    # Along the rail: m s'' = -4 sin(30 deg) - 30 cos^2(30 deg) s.
    omega = np.sqrt(30 * 0.75 / 2)
    along_rail = -2 / 22.5 * (1 - np.cos(omega * times))
    np.testing.assert_allclose(x / np.cos(np.pi / 6), along_rail, atol=1e-8)
    spring_moment = jax.vmap(mechanism.wrenches)(motion.poses)[:, 1, 0]
    moment = motion.constraint_force("rail")[:, 0]
    assert_close(moment, -0.2 - spring_moment, digits=10)


def test_a_constraint_that_moves_a_block_does_the_work_of_its_inertia_and_spring():
    """The block is moved to 0.02 m and most of the way back: `0.01 (1 - cos 3 t)`."""
    move = tj.Constraint(
        "move", ["block"], lambda pose, time: pose[1] - 0.01 * (1 - jnp.cos(3 * time))
    )
    times = np.array([0.0, 0.4, 1.1, 1.9])
    motion = tj.simulate(oscillator(), times, constraints=[move], tolerance=1e-9)
    x, rate = 0.01 * (1 - np.cos(3 * times)), 0.03 * np.sin(3 * times)
    assert_close(motion.displacement("block")[:, 1], x, digits=9)
    force = 2.0 * 0.09 * np.cos(3 * times) + 50 * x
    assert_close(motion.constraint_force("move")[:, 0], force, digits=7)
    work = 2.0 * rate**2 / 2 + 50 * x**2 / 2
    assert_close(motion.energies.by_drives, work, digits=7)


@pytest.mark.slow
def test_constraint_that_depends_on_time_is_the_same_as_a_drive(validated):
    times = np.linspace(0, 0.1, 4)
    linkage = four_bar.four_bar()
    crank = tj.Constraint(
        "crank",
        ["2"],
        lambda pose, time: pose[0] - four_bar.crank_rotation(time)[0].angle,
    )
    driven = four_bar.driven_motion(linkage, times, tolerance=1e-10)
    constrained = tj.simulate(linkage, times, constraints=[crank], tolerance=1e-10)
    assert_close(constrained.displacements, driven.displacements, digits=8)
    moment = constrained.constraint_force("crank")[:, 0]
    assert_close(moment, driven.reaction("2")[:, 0], digits=6)
    work = constrained.energies.by_drives
    assert_close(work, driven.energies.by_drives, digits=8)
    both = constrained.displacements, driven.displacements
    what = "displacements, rotation of link 2 prescribed by a constraint"
    validated("Motion", what, *both, "prescribed by a drive")


@pytest.mark.slow
def test_pseudo_rigid_body_model_approximates_the_elastic_linkage():
    """Pins with torsion springs replace the leaves; section 5.4 of the dissertation.

    The linkage on pins is a parallelogram, whose inertia does not depend on its rotation,
    so that it oscillates harmonically. Its frequency is close to that of the leaves.
    """
    linkage = four_bar.four_bar(damping=None)
    stiffness, length = 0.14375, 50e-3  # of a leaf; between the pins of links 2 and 4
    torsion = tj.Quadratic(jnp.diag(jnp.array([stiffness, 0.0, 0.0])), "twist")
    bodies = [
        tj.Body(name, linkage.reference[k], linkage.masses[k], linkage.inertias[k])
        for k, name in enumerate("1234")
    ]
    ends = {"A": "12", "B": "23", "C": "34", "D": "41"}
    hinges = [
        tj.Hinge(name, first, second, torsion, linkage.at[k])
        for k, (name, (first, second)) in enumerate(ends.items())
    ]
    pins = [
        tj.Pin(name, first, second, linkage.at[k, 1:])
        for k, (name, (first, second)) in enumerate(ends.items())
    ]
    model = tj.Mechanism(bodies, hinges, fixed=["1"])
    times = np.linspace(0, 0.02, 3)
    velocities = {"2": (-20.0, 0.5, 0.0), "3": (0.0, 1.0, 0.0), "4": (-20.0, 0.5, 0.0)}
    motion = tj.simulate(
        model, times, constraints=pins, velocities=velocities, tolerance=1e-9
    )
    (of_rocker, rocker, _), (_, coupler, _) = linkage.inertia()[3], linkage.inertia()[2]
    inertia = 2 * (of_rocker + rocker * length**2 / 4) + coupler * length**2
    omega = np.sqrt(4 * stiffness / inertia)
    rotation = -20.0 / omega * np.sin(omega * times)
    assert np.max(np.abs(rotation)) > 0.05
    assert_close(motion.displacement("2")[:, 0], rotation, digits=7)
    assert_close(motion.displacement("3")[:, 1], -length * np.sin(rotation), digits=8)
    elastic = tj.vibrations(linkage).frequencies[0]
    assert abs(omega / (2 * np.pi) - elastic) < 0.01 * elastic


@pytest.mark.slow
def test_tolerance_of_constraints_at_the_start_scales_with_the_mechanism():
    for size in (1e-7, 1.0, 1e3):
        _check_start_on_a_rail(size)


def _check_start_on_a_rail(size):
    """Start a block on a rail, with masses and times that do not depend on its size."""
    spring = tj.Quadratic(jnp.diag(jnp.array([size**2, 1.0, 1.0])))
    block = tj.Body("block", (0.0, size, 0.0), mass=1.0, inertia=size**2)
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0.0, size / 2, 0.0))
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
    rail = tj.Slider("rail", "wall", "block", at=(0.0, size, 0.0))

    def move(offset=0.0, across=0.0, along=0.0):
        return tj.simulate(
            mechanism,
            [0.0, 1.0],
            start=mechanism.reference.at[1, 2].add(offset),
            velocities={"block": (0.0, along, across)},
            constraints=[rail],
            loads=[tj.Load("block", force=(0.0, 0.0))],
        )

    assert move(offset=1e-11 * size, along=0.1 * size).succeeded
    with pytest.raises(ValueError, match="'rail' is violated by"):
        move(offset=1e-5 * size)
    for share in (1.0, 5e-6):
        with pytest.raises(ValueError, match="velocities at the start violate"):
            move(across=share * size)
    with pytest.raises(ValueError, match="velocities at the start violate"):
        move(across=1e-5 * size, along=size)
