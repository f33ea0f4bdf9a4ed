"""Motions that cannot start or continue, and invalid arguments."""

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, mostly_slow
from motion_helpers import oscillator

import twistorjax as tj
from twistorjax.examples import four_bar


GRAVITY = 9.81


def pendulum(spring=1e-3, mass=1.0):
    """Return a bob on a weak spring at its pivot, where a pin may be added."""
    energy = tj.Quadratic(spring * np.eye(3))
    hinge = tj.Hinge("spring", "wall", "bob", energy, at=(0.0, 0.0, 0.0))
    bob = tj.Body("bob", (0.0, 0.5, 0.0), mass=mass, inertia=0.01)
    return tj.Mechanism([tj.Body("wall"), bob], [hinge], fixed=["wall"])


@jax.jit
@jax.vmap
def simulate_pendulum(values):
    mechanism = pendulum(values["spring"], values["mass"])
    return tj.simulate(
        mechanism,
        [0.0, 1.0],
        start=mechanism.reference.at[1, 0].add(values["rotation"]),
        velocities={"bob": (values["rate"], 0.0, 0.5 * values["rate"])},
        loads=[tj.Load("bob", force=(0.0, -GRAVITY))],
        constraints=[tj.Pin("pin", "wall", "bob", at=(values["pin"], 0.0))],
        tolerance=values["tolerance"],
        throw=False,
    )


USUAL = {
    "spring": 1e-3, "mass": 1.0, "rotation": 0.0, "rate": 1.0, "pin": 0.0,
    "tolerance": 1e-4,
}  # fmt: skip
CASES = [
    ({}, "successful"),
    ({"rotation": np.nan}, "not_finite"),
    ({"rate": np.inf}, "not_finite"),
    ({"pin": np.nan}, "not_finite"),
    ({"tolerance": np.nan}, "not_finite"),
    ({"tolerance": np.inf}, "not_finite"),
    ({"tolerance": -1e-4}, "not_finite"),
    ({"rotation": 0.1}, "inconsistent_constraints"),
    ({"spring": np.nan}, "not_finite"),
    ({"mass": -1.0}, "not_finite"),
]


def motions(changes):
    """Simulate a batch, each motion of which has some unusual values."""
    rows = [USUAL | change for change in changes]
    return simulate_pendulum({name: np.array([r[name] for r in rows]) for name in USUAL})


@pytest.fixture(scope="module")
def batch():
    """Return ten motions, all but the first of which have an invalid value."""
    return motions([change for change, _ in CASES])


@pytest.mark.slow
def test_motions_that_cannot_start_take_no_step(batch):
    names = tj.result_names(batch.result)
    assert names is not None and names.tolist() == [result for _, result in CASES]
    # A mechanism that is not finite is found in the first step, other values before it.
    assert batch.steps[0] > 3
    np.testing.assert_array_equal(batch.steps[1:8], 0)
    assert batch.steps[8] <= 1
    assert np.all(np.isfinite(batch.displacements[0]))
    assert np.all(np.isnan(batch.displacements[1:8]))
    assert np.all(np.isnan(batch.solution.ys[1].position[1:8]))


def test_failed_motion_does_not_affect_the_rest_of_a_batch(batch):
    valid = motions([{}] * len(CASES))
    assert np.asarray(valid.succeeded).all()
    found, expected = np.asarray(batch.displacements), np.asarray(valid.displacements)
    assert_close(found[0], expected[0], digits=9)
    assert np.all(np.isnan(found[9]))


@pytest.mark.slow
def test_invalid_drives_do_not_delay_the_rest_of_a_batch():
    """The second drive jumps at the start; the third becomes NaN."""
    spring = tj.Quadratic(jnp.diag(jnp.array([1.0, 100.0, 100.0])))
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
    block = tj.Body("block", mass=1.0, inertia=0.1)
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])

    def simulate(values):
        jump, end = values

        def drives(time):
            late = jnp.where(time > 0.05, end, 0.0)
            return [tj.Drive("block", x=jump + 1e-3 * time**2 + late)]

        return tj.simulate(mechanism, [0.0, 0.1], drives=drives, throw=False)

    motions = jax.vmap(simulate)(jnp.array([[0.0, 0.0], [1e-3, 0.0], [0.0, np.nan]]))
    names = tj.result_names(motions.result)
    assert names is not None
    assert names.tolist() == ["successful", "drive_jumps", "not_finite"]
    assert motions.steps[1] == 0
    assert motions.steps[2] < 100


@pytest.mark.parametrize(
    "solver", mostly_slow([dfx.Tsit5(), tj.solve.Radau()]), ids=["tsit5", "radau"]
)
def test_every_solver_stops_where_a_load_is_not_finite(solver):
    def loads(time):
        return [tj.Load("bob", force=(0.0, jnp.where(time > 0.1, jnp.nan, 1.0)))]

    motion = tj.simulate(
        pendulum(), [0.0, 0.2], loads=loads, solver=solver, tolerance=1e-4, throw=False
    )
    assert not motion.succeeded
    assert 0.05 < motion.reached < 0.1 + 1e-6
    assert motion.steps < 100


def test_errors_are_measured_with_the_moving_bodies_only():
    """Neither the position of a fixed body nor a rounding error counts as a length."""
    size = 1e-6
    spring = tj.Quadratic(np.diag([size**2, 1.0, 1.0]))

    def simulate(wall, arm):
        hinge = tj.Hinge("spring", "wall", "block", spring, at=(0.0, size, 0.0))
        block = tj.Body("block", (0.0, size + arm, 0.0), mass=1.0, inertia=size**2)
        bodies = [tj.Body("wall", (0.0, wall, 0.0)), block]
        mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        start = np.array(mechanism.reference)
        start[1, 1] += 0.1 * size
        half_period = [0.0, np.pi]
        motion = tj.simulate(mechanism, half_period, start=start)
        return np.asarray(motion.displacement("block"))[1, 1] / size, motion.steps

    for wall, arm in ((0.0, 0.5 * size), (10.0, 0.5 * size), (0.0, 1e-22)):
        end, steps = simulate(wall, arm)
        assert abs(end + 0.1) < 1e-4
        assert steps < 200


INVALID_ARGUMENTS = {
    "increase": dict(times=[0.0, 1.0, 1.0]),
    "comes after `times[1]` = 2": dict(times=[0.0, 2.0, 1.0]),
    "a list of at least two times": dict(times=[0.0]),
    "`times` must be finite": dict(times=[0.0, np.nan]),
    "The x of 'block' starts at 0, but 0.1 is prescribed.": dict(
        drives=[tj.Drive("block", x=0.1)]
    ),
    "names the body 'blok'": dict(velocities={"blok": (0, 0, 0)}),
    "but must be a mapping": dict(velocities=[0, 0, 0]),
    "x of 'wall', but this coordinate is fixed": dict(velocities={"wall": (0, 1, 0)}),
    "must be finite": dict(velocities={"block": (0, np.nan, 0)}),
    "`tolerance` is 0": dict(tolerance=0),
    "'q' is redundant: 2 of its 2 equations": dict(
        constraints=[tj.Pin(name, "wall", "block", (0, 0)) for name in "pq"]
    ),
    "'c' is violated by 0.1": dict(
        constraints=[tj.Constraint("c", ["block"], lambda pose, time: pose[0] - 0.1)]
    ),
    "'q' contradicts": dict(
        constraints=[
            tj.Pin("p", "wall", "block", (0, 0)),
            tj.Constraint("q", ["block"], lambda pose, time: pose[1] - 0.1),
        ]
    ),
    "names the body 'no'": dict(constraints=[tj.Pin("p", "wall", "no", (0, 0))]),
    "several `subs` or a `fn`": dict(saveat=dfx.SaveAt(t1=True, fn=lambda t, y, a: t)),
}


# Those of constraints compile a program of each operation.
OF_CONSTRAINTS = "'q' is redundant: 2 of its 2 equations", "'q' contradicts"


@pytest.mark.parametrize(
    "message",
    [
        pytest.param(
            message, marks=[pytest.mark.slow] if message in OF_CONSTRAINTS else []
        )
        for message in INVALID_ARGUMENTS
    ],
)
@pytest.mark.untyped
def test_invalid_arguments_are_reported(message):
    settings = {"times": [0.0, 0.1], **INVALID_ARGUMENTS[message]}
    with pytest.raises(ValueError) as error:
        tj.simulate(oscillator(0.1), settings.pop("times"), **settings)
    assert message in str(error.value)


@pytest.mark.parametrize(
    "drives",
    [
        lambda time: [tj.Drive("2", angle=0.1 if time > 1 else 0.0)],
        lambda time: [tj.Drive("2", angle=np.sin(time))],
    ],
)
def test_drives_that_jax_cannot_compile_are_reported(drives):
    with pytest.raises(ValueError, match="`drives` is a function that JAX cannot comp"):
        tj.simulate(four_bar.four_bar(), [0.0, 0.1], drives=drives)


def few_steps(mechanism):
    """Simulate a block that is released with 1 m/s, in at most ten steps."""
    times, velocities = np.linspace(0, 9, 61), {"block": (0, 1.0, 0)}
    return tj.simulate(mechanism, times, velocities=velocities, max_steps=10)


def test_error_of_a_stopped_motion_names_time_and_hinge():
    with pytest.raises(RuntimeError, match=r"reached t = .* in 10 steps.*'spring'"):
        few_steps(oscillator(0.1))


def test_error_of_a_mass_that_is_not_finite_names_its_body():
    nan = jnp.array(jnp.nan, float)
    broken = eqx.tree_at(lambda m: m.masses[1], oscillator(0.1), nan)
    with pytest.raises(RuntimeError, match="body 'block'"):
        few_steps(broken)


def test_damping_that_supplies_energy_is_an_error():
    with pytest.raises(ValueError, match="negative eigenvalue"):
        tj.energies.ViscousDamping(-jnp.eye(3))
    damping = tj.energies.ViscousDamping(jnp.eye(3))
    wrong = eqx.tree_at(lambda damping: damping.damping, damping, -jnp.eye(3))
    with pytest.raises(ValueError, match="supply energy"):
        few_steps(oscillator(wrong))
