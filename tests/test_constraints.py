"""Pins, sliders, and general constraints in statics, vibrations, and response."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import stage
from twistorjax.mechanism.constraints import AbstractConstraint


LENGTH, STIFFNESS, MASS, INERTIA = 0.3, 2.0, 1.5, 0.1
PIN = tj.Pin("pin", "wall", "arm", at=(0.0, 0.0))


def pendulum(stiffness=STIFFNESS, pose=(0.0, LENGTH, 0.0)):
    """An arm on a torsion spring that has no translational stiffness."""
    spring = tj.Quadratic(stiffness * np.diag([1.0, 0.0, 0.0]), "twist")
    arm = tj.Body("arm", pose=pose, mass=MASS, inertia=INERTIA)
    hinge = tj.Hinge("spring", "wall", "arm", spring, at=(0.0, 0.0, 0.0))
    return tj.Mechanism([tj.Body("wall"), arm], [hinge], fixed=["wall"])


def push(force):
    return tj.Load("arm", force=(0.0, force))


def angle(force, stiffness=STIFFNESS):
    """Return the angle at which the moments about the pin are in balance; rad."""
    root = scipy.optimize.brentq(
        lambda t: stiffness * t - force * LENGTH * np.cos(t), 0.0, np.pi / 2, xtol=1e-15
    )
    assert isinstance(root, float)
    return root


@pytest.mark.parametrize("force", [0.5, 5.0, 30.0])
def test_a_pinned_arm_balances_its_moments(force):
    arm = tj.equilibrium(pendulum(), loads=[push(force)], constraints=[PIN])
    t = angle(force)
    displacement = [t, LENGTH * (np.cos(t) - 1), LENGTH * np.sin(t)]
    assert_close(arm.displacement("arm"), displacement, digits=10)
    assert_close(arm.constraint_force("pin"), [0.0, -force], digits=10)
    moment = -force * LENGTH * np.cos(t)
    assert_close(arm.reaction("wall"), [moment, 0.0, -force], digits=10)


@pytest.mark.slow
def test_equilibria_with_constraints_have_derivatives():
    def rotation(force):
        arm = tj.equilibrium(pendulum(), loads=[push(force)], constraints=[PIN])
        return arm.displacement("arm")[0]

    def slope(force):
        t = angle(force)
        return LENGTH * np.cos(t) / (STIFFNESS + force * LENGTH * np.sin(t))

    @jax.jit
    @jax.vmap
    def derivatives(force):
        """In reverse mode, and those of the value and of the slope in forward mode."""
        return jax.jvp(jax.value_and_grad(rotation), (force,), (jnp.ones(()),))

    forces, step = np.array([1.0, 3.0, 5.0]), 1e-5
    (rotations, in_reverse_mode), (in_forward_mode, second) = derivatives(forces)
    assert_close(rotations, [angle(force) for force in forces], digits=10)
    for slopes in (in_reverse_mode, in_forward_mode):
        assert_close(slopes, [slope(force) for force in forces], digits=10)
    expected = [
        (slope(force + step) - slope(force - step)) / (2 * step) for force in forces
    ]
    assert_close(second, expected, digits=6)


def test_the_linearization_about_a_loaded_state_is_the_derivative():
    """The constraint force contributes to the stiffness as the arm rotates."""
    mechanism, loads = pendulum(), [push(5.0)]
    state = tj.equilibrium(mechanism, loads=loads, constraints=[PIN])
    small = tj.linearize(mechanism, about=state, loads=loads, constraints=[PIN])
    change = small(loads=[push(1.0)])
    t = angle(5.0)
    slope = LENGTH * np.cos(t) / (STIFFNESS + 5.0 * LENGTH * np.sin(t))
    assert_close(np.asarray(change.displacement("arm"))[0], slope, digits=10)
    assert_close(change.constraint_force("pin"), [0.0, -1.0], digits=10)


def test_a_pinned_arm_vibrates_and_responds_as_a_physical_pendulum():
    mechanism, loads = pendulum(), [push(5.0)]
    state = tj.equilibrium(mechanism, loads=loads, constraints=[PIN])
    found = tj.vibrations(mechanism, about=state, loads=loads, constraints=[PIN])
    t = angle(5.0)
    stiffness = STIFFNESS + 5.0 * LENGTH * np.sin(t)
    inertia = INERTIA + MASS * LENGTH**2
    assert found.frequencies.shape == (1,)
    assert_close(found.frequencies, [np.sqrt(stiffness / inertia) / (2 * np.pi)])
    shape = np.asarray(found.shapes)[0, 1]
    assert_close(np.vdot(shape, np.array([INERTIA, MASS, MASS]) * shape), 1.0)
    omega = 2 * np.pi * 0.3
    response = tj.frequency_response(
        mechanism, [0.3], about=state, static_loads=loads, loads=[push(1.0)],
        constraints=[PIN],
    )  # fmt: skip
    amplitude = LENGTH * np.cos(t) / (stiffness - omega**2 * inertia)
    assert_close(np.asarray(response.displacement("arm"))[0, 0], amplitude, digits=9)
    force = -1.0 - omega**2 * MASS * LENGTH * np.cos(t) * amplitude
    assert_close(np.asarray(response.constraint_force("pin"))[0, 1], force, digits=9)
    reaction = np.asarray(response.reaction("wall"))[0]
    along = omega**2 * MASS * LENGTH * np.sin(t) * amplitude
    assert_close(reaction, [-STIFFNESS * amplitude, along, force], digits=9)


@pytest.mark.slow
def test_frequencies_with_constraints_have_derivatives():
    def frequency(stiffness):
        return tj.vibrations(pendulum(stiffness), constraints=[PIN]).frequencies[0]

    value, slope = jax.value_and_grad(frequency)(STIFFNESS)
    assert_close(slope, value / (2 * STIFFNESS))


GUIDE = tj.Slider("guide", "wall", "arm", at=(0.2, LENGTH, 0.0))
ALONG = tj.Drive("arm", x=1e-3)
SLIDES = [0.0, 1e-3, 1e-3 * np.tan(0.2)]


def test_a_slider_transmits_a_prescribed_displacement():
    """The arm is displaced along x and slides on a guide at an angle of 0.2 rad."""
    solution = tj.equilibrium(pendulum(), drives=[ALONG], constraints=[GUIDE])
    assert_close(solution.displacement("arm"), SLIDES)


@pytest.mark.slow
def test_a_slider_transmits_a_prescribed_displacement_in_linear_models():
    small = tj.linearize(pendulum(), {"arm": ["x"]}, constraints=[GUIDE])
    assert_close(small(drives=[ALONG]).displacement("arm"), SLIDES)
    response = tj.frequency_response(
        pendulum(), [0.0], drives=[ALONG], constraints=[GUIDE]
    )
    assert_close(np.asarray(response.displacement("arm"))[0], SLIDES)


def test_a_general_constraint_depends_on_the_time():
    def violation_along_x(pose, time):
        return pose[1] - LENGTH - 0.01 * time

    along = tj.Constraint("along x", ["arm"], violation_along_x)
    across = tj.Constraint("across", ["arm"], lambda pose, time: pose[2])
    found = tj.equilibrium(pendulum(), constraints=[along, across], time=2.0)
    assert_close(found.displacement("arm"), [0.0, 0.02, 0.0])


@pytest.mark.release
def test_a_stage_of_rigid_levers_on_pins_has_the_gain_of_the_levers():
    """The gain is 328 / 9 for any stiffness of the pivots.

    The hinges a, b, and c of body 2 lie on a line along y. One constraint along this line
    is enough, so the constraints at a and b act along x only.
    """
    flexible = stage.microstage()
    bodies = [
        tj.Body(name, pose=flexible.reference[row])
        for row, name in enumerate(flexible.names)
    ]
    pivot = tj.Quadratic(jnp.diag(jnp.array([3.0, 0.0, 0.0])))
    hinges, constraints = [], []
    for row, name in enumerate(flexible.hinge_names):
        first, second = (flexible.names[k] for k in flexible.hinge_assembly.ends[row])
        frame = flexible.at[row]
        hinges.append(tj.Hinge(name, first, second, pivot, at=frame))
        pin = tj.Pin(f"pin {name}", first, second, at=frame[1:])
        constraints.append(AcrossLine(f"joint {name}", pin) if name in "ab" else pin)
    fixed = {"1": ("angle", "x", "y"), "6": ("angle", "y")}
    rigid = tj.Mechanism(bodies, hinges, fixed)
    travel = 1e-9
    drive = tj.Drive("6", x=travel)
    solution = tj.equilibrium(rigid, drives=[drive], constraints=constraints)
    assert_close(abs(solution.displacement("4")[1]) / travel, 328 / 9, digits=6)
    linear = tj.linearize(rigid, {"6": ["x"]}, constraints=constraints)
    small = linear(drives=[drive])
    assert_close(abs(small.displacement("4")[1]) / travel, 328 / 9)


class AcrossLine(AbstractConstraint):
    """Constraint of a pin along x only."""

    name: str = eqx.field(static=True)
    pin: tj.Pin

    def __init__(self, name, pin):
        self.name, self.pin = name, pin

    @property
    def bodies(self):
        return self.pin.bodies

    def violation(self, poses, references, time):
        return self.pin.violation(poses, references, time)[:1]


TWICE = [PIN, tj.Pin("again", "wall", "arm", at=(0.0, 0.0))]


def test_redundant_constraints_have_a_result():
    found = tj.equilibrium(pendulum(), constraints=TWICE, throw=False)
    assert tj.result_names(found.result) == "inconsistent_constraints"
    assert np.isnan(np.asarray(found.displacements)).all()


@pytest.mark.slow
def test_redundant_constraints_are_named():
    for solve in (
        lambda: tj.equilibrium(pendulum(), constraints=TWICE),
        lambda: tj.linearize(pendulum(), constraints=TWICE),
        lambda: tj.frequency_response(pendulum(), [1.0], constraints=TWICE),
    ):
        with pytest.raises(ValueError, match="'again' is redundant: 2 of its 2"):
            solve()
    response = tj.frequency_response(pendulum(), [1.0], constraints=TWICE, throw=False)
    assert tj.result_names(response.result) == "inconsistent_constraints"


def rotating_guide():
    """A point mass on springs, on a line whose normal turns by 1 rad/s; rad, m."""
    spring = tj.Quadratic(np.diag([1.0, 100.0, 400.0]))
    block = tj.Body("block", mass=MASS, inertia=INERTIA)
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0.0, 0.0, 0.0))
    fixed = {"wall": ("angle", "x", "y"), "block": ("angle",)}
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed)

    def distance(pose, time):
        return jnp.cos(time) * pose[1] + jnp.sin(time) * pose[2] - 0.1

    return mechanism, tj.Constraint("guide", ["block"], distance)


@pytest.mark.slow
def test_linear_models_evaluate_constraints_at_the_given_time():
    """Along the guide the stiffness is 100 sin(t)^2 + 400 cos(t)^2."""
    time = 0.7
    mechanism, guide = rotating_guide()
    about = tj.equilibrium(mechanism, constraints=[guide], time=time)
    settings: Any = dict(about=about, constraints=[guide], time=time)
    along = np.array([-np.sin(time), np.cos(time)])
    stiffness = 100.0 * np.sin(time) ** 2 + 400.0 * np.cos(time) ** 2
    push = tj.Load("block", force=tuple(along))
    small = tj.linearize(mechanism, **settings)(loads=[push])
    assert_close(small.displacement("block")[1:], along / stiffness)
    frequency = np.sqrt(stiffness / MASS) / (2 * np.pi)
    modes = tj.vibrations(mechanism, **settings)
    assert_close(modes.frequencies, [frequency])
    response = tj.frequency_response(
        mechanism,
        [frequency / 2],
        loads=[push],
        **settings,
    )
    assert_close(response.displacement("block")[0, 1:].real, along / (0.75 * stiffness))


@pytest.mark.slow
@pytest.mark.parametrize("solve", [
    tj.linearize,
    tj.vibrations,
    lambda mechanism, **settings: tj.frequency_response(mechanism, [1.0], **settings),
])  # fmt: skip
def test_linear_models_refuse_a_state_that_violates_constraints(solve):
    mechanism, guide = rotating_guide()
    about = tj.equilibrium(mechanism, constraints=[guide], time=0.7)
    with pytest.raises(ValueError, match="'guide' is violated by"):
        solve(mechanism, about=about, constraints=[guide])


def test_a_traced_state_that_violates_constraints_has_a_result():
    mechanism, guide = rotating_guide()
    about = tj.equilibrium(mechanism, constraints=[guide], time=0.7)

    def result(poses):
        found = tj.linearize(mechanism, about=poses, constraints=[guide])
        return found(throw=False).result

    traced = jax.jit(result)(about.poses)
    assert tj.result_names(traced) == "inconsistent_constraints"


def test_constraint_forces_of_nearly_parallel_constraints_keep_their_digits():
    """Two guides whose normals differ by 1e-5 rad share the force on the block."""
    mechanism, guide = rotating_guide()
    slope = 1e-5
    other = tj.Constraint(
        "other", ["block"], lambda pose, time: pose[1] + slope * pose[2] - 0.1
    )
    about = tj.equilibrium(mechanism, constraints=[guide])
    linear = tj.linearize(mechanism, about=about, constraints=[guide, other])
    small = linear(loads=[tj.Load("block", force=(1.0, 2.0))])
    forces = [*small.constraint_force("guide"), *small.constraint_force("other")]
    assert_close(np.array(forces), [-1.0 + 2.0 / slope, -2.0 / slope], digits=10)


def test_complex_amplitudes_raise_an_error():
    for make in (
        lambda: tj.Load("block", force=(1j, 0.0)),
        lambda: tj.Drive("block", x=jnp.asarray(1e-3j)),
    ):
        with pytest.raises(TypeError, match="is complex, but real numbers are needed"):
            make()


def test_a_body_may_be_supported_by_constraints_only():
    spring = tj.Quadratic(np.diag([1.0, 100.0, 100.0]))
    bodies = [tj.Body("wall"), tj.Body("block"), tj.Body("rider", (0.0, 0.1, 0.0))]
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0.0, 0.0, 0.0))
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    rail = tj.Slider("rail", "block", "rider", at=(np.pi / 2, 0.1, 0.0))
    stop = tj.Constraint("stop", ["rider"], lambda pose, time: pose[2])
    load = tj.Load("rider", force=(2.0, 0.0))
    found = tj.equilibrium(mechanism, loads=[load], constraints=[rail, stop])
    assert_close(found.displacement("rider"), [0.0, 0.02, 0.0])
    with pytest.raises(ValueError, match="The body 'rider' is not connected"):
        tj.equilibrium(mechanism, loads=[load])


@pytest.mark.parametrize("angle", [0.1, 0.7, 1.1, 2.3])
def test_a_force_that_the_constraint_carries_alone_moves_nothing(angle):
    """The violation has rounding errors, beside which the displacement is zero."""
    spring = tj.Quadratic(np.diag([1.0, 100.0, 100.0]))
    block = tj.Body("block", pose=(0.0, 0.1, 0.05))
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0.3, 0.05, 0.0))
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
    rail = tj.Slider("rail", "wall", "block", at=(angle, 0.1, 0.05))
    normal = tj.Load("block", force=(-np.sin(angle), np.cos(angle)))
    found = tj.equilibrium(mechanism, loads=[normal], constraints=[rail])
    np.testing.assert_allclose(found.displacement("block"), 0.0, atol=1e-14)
    force = np.asarray(found.constraint_force("rail"))[-1]
    np.testing.assert_allclose(np.abs(force), 1.0)


@pytest.mark.parametrize(("share", "stable"), [(0.99, True), (1.01, False), (1.5, False)])
def test_a_pinned_column_is_unstable_above_its_critical_load(share, stable):
    """The critical force at the end of the column is stiffness over total length."""
    column = pendulum(pose=(0.0, 0.0, 0.1))
    load = tj.Load("arm", force=(0.0, -share * STIFFNESS / 0.2), at=(0.0, 0.1))
    found = tj.equilibrium(column, loads=[load], constraints=[PIN], throw=False)
    assert bool(found.succeeded) == stable
