"""Motion against SciPy, the dissertation, closed forms, and conservation laws."""

from functools import partial

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from helpers import assert_close, mostly_slow, some_stiffness
from motion_helpers import oscillator
from scipy.integrate import solve_ivp

import twistorjax as tj
from twistorjax.examples import four_bar
from twistorjax.geometry import se2
from twistorjax.solve.integration import adjoint as motion_adjoint


def table(text):
    return np.array([[float(cell) for cell in row.split()] for row in text.split("\n")])


# Times, and x, y, angle of links 2, 3, and 4, for a damping time of 1 ms. They are from
# another program.
FOUR_BAR = {
    "identical": table(
        """0.09 -0.02492426146 0.03135173101 0.3064712409 -0.0148658459 0.0627447506 \
0.002349390197 0.01007548818 0.03139295793 0.2964555945
0.18 -0.01823824063 0.03248878621 0.02999954037 -0.00147720873 0.06497816175 \
3.409415187e-05 0.01676175906 0.03248938293 0.02914353862
0.405 -0.01754560165 0.03249994957 0.001933910937 -9.180402862e-05 0.06499991415 \
8.915162519e-07 0.01745439835 0.03249996516 0.001809271285"""
    ),
    "leaves-and-notches": table(
        """0.09 -0.02436254226 0.03643783615 0.3064712409 -0.01264399614 0.06121225566 \
0.009112280387 0.01104053526 0.03166441267 0.2576254709
0.18 -0.01817728215 0.03748964079 0.02999954037 -0.001246740268 0.06298273548 \
9.880922679e-05 0.01686103932 0.03249203067 0.02525869611
0.405 -0.01753106404 0.0374999617 0.001933910937 -6.759857563e-05 0.06299994209 \
1.138676162e-06 0.01746545588 0.03249998047 0.001373156189"""
    ),
}


@pytest.mark.parametrize("hinges", mostly_slow(["identical", "leaves-and-notches"]))
def test_driven_linkages_move_as_in_the_dissertation(hinges, validated):
    """Without `energies`, the dissipated energy and the work of the drives are zero."""
    expected = FOUR_BAR[hinges]
    linkage = four_bar.four_bar(hinges)
    energies = hinges == "identical"
    motion = four_bar.driven_motion(
        linkage, [0.0, *expected[:, 0]], tolerance=1e-8, energies=energies
    )
    for part in (motion.energies.dissipated, motion.energies.by_drives):
        assert bool(np.asarray(part).any()) == energies
    for k, name in enumerate("234"):
        x, y, angle = expected[:, 1 + 3 * k : 4 + 3 * k].T
        computed = np.asarray(motion.pose(name))[1:].T
        np.testing.assert_allclose(computed[1:], [x, y], rtol=0, atol=1e-7)
        np.testing.assert_allclose(computed[0], angle, rtol=0, atol=1e-6)
    x = np.asarray(motion.displacement("3"))[1:, 1], expected[:, 4]
    names = {"identical": "identical leaves", "leaves-and-notches": "leaves and notches"}
    what = f"displacement of link 3, {names[hinges]}"
    validated("Four-bar linkages", what, *x, "an independent derivation, by SciPy")


@pytest.mark.parametrize("coordinates", mostly_slow(["twistor", "twist"]))
def test_motion_of_a_body_agrees_with_scipy(coordinates, validated):
    """SciPy integrates the gradient of the energy and the closed form of the damping."""
    pose, at = jnp.array([0.2, 0.1, 0.3]), jnp.array([0.4, -0.3, 0.1])
    mass = np.array([2e-3, 0.5, 0.5])
    port = se2.between(pose, at)
    times = np.linspace(0, 0.6, 7)
    start = np.array([0.0, 0, 0, 3.0, 0.5, -1.0])
    energy = tj.Quadratic(some_stiffness(3), coordinates)
    damping = tj.energies.ViscousDamping(0.02 * some_stiffness(4), coordinates)

    def frame_b(displacement):
        return se2.compose(pose + displacement, port)

    @jax.jit
    def acceleration(displacement, rate):
        def stored_energy(displacement):
            return energy(se2.between(at, frame_b(displacement)))

        frame, slope = jax.jvp(frame_b, (displacement,), (rate,))
        velocity = jnp.concatenate([slope[:1], se2.rotate(-frame[0], slope[1:])])
        wrench = damping.wrench(se2.between(at, frame), jnp.zeros(3), velocity)
        in_world = jnp.concatenate([wrench[:1], se2.rotate(frame[0], wrench[1:])])
        _, transpose = jax.vjp(frame_b, displacement)
        forces = -jax.grad(stored_energy)(displacement) - transpose(in_world)[0]
        return forces / mass

    def derivative(_, state):
        return np.concatenate([state[3:], acceleration(state[:3], state[3:])])

    exact = solve_ivp(
        derivative, (0, 0.6), start, "DOP853", times, rtol=1e-11, atol=1e-12
    ).y.T
    body = tj.Body("body", pose=pose, mass=0.5, inertia=2e-3)
    hinge = tj.Hinge("hinge", "wall", "body", energy, at, damping=damping)
    mechanism = tj.Mechanism([tj.Body("wall"), body], [hinge], fixed=["wall"])
    velocities = {"body": start[3:]}
    motion = tj.simulate(mechanism, times, velocities=velocities, tolerance=1e-9)
    found = motion.displacement("body")
    np.testing.assert_allclose(found, exact[:, :3], atol=1e-6)
    np.testing.assert_allclose(motion.velocity("body"), exact[:, 3:], atol=2e-5)
    what = f"body on a damped hinge with a full stiffness matrix, {coordinates}"
    validated("Motion", what, found, exact[:, :3], "DOP853 of SciPy, tolerance 1e-11")


def pushed_oscillator(damping_time, force, times):
    """Return the displacement of a damped oscillator under a force from the time 0 on."""
    push = tj.Load("block", force=(force, 0.0))
    motion = tj.simulate(oscillator(damping_time), times, loads=[push], tolerance=1e-9)
    return motion.displacement("block")[:, 1]


def step_response(damping_time, force, times):
    """Return the solution of m x'' + c x' + k x = f with c = damping_time * k."""
    decay = damping_time * 50 / 4
    omega = jnp.sqrt(25 - decay**2)
    oscillation = jnp.cos(omega * times) + decay / omega * jnp.sin(omega * times)
    return force / 50 * (1 - jnp.exp(-decay * times) * oscillation)


def test_step_response_of_a_damped_oscillator_is_the_closed_form():
    at = 0.05, 3.0, np.linspace(0, 2, 9)
    np.testing.assert_allclose(pushed_oscillator(*at), step_response(*at), atol=1e-8)


def test_the_gradient_of_a_motion_is_that_of_the_closed_form():
    """By the damping time, the force, and the time at which the motion ends."""

    @partial(jax.jit, static_argnums=0)
    def gradient(motion, *at):
        return jax.grad(lambda *at: motion(*at)[-1], argnums=(0, 1, 2))(*at)

    at = 0.05, 3.0, jnp.array([0.0, 0.7])
    found, exact = gradient(pushed_oscillator, *at), gradient(step_response, *at)
    assert_close(found[:2], exact[:2], digits=6)
    assert_close(found[2][1], exact[2][1], digits=6)  # the end; the start is fixed


@pytest.fixture(scope="module")
def driven_block():
    """Motion of an oscillator that is driven along x and loaded along y."""

    def drives(time):
        return [tj.Drive("block", x=0.01 * jnp.sin(3 * time), angle=0.0)]

    times, loads = np.linspace(0, 1, 5), [tj.Load("block", force=(0.0, -1.0))]
    return tj.simulate(
        oscillator(0.05), times, drives=drives, loads=loads, tolerance=1e-11
    )


def test_reaction_of_a_driven_block_is_that_of_spring_damper_and_inertia(driven_block):
    """k x + c x' + m x''."""
    times = np.asarray(driven_block.times)
    x, rate = 0.01 * np.array([np.sin(3 * times), 3 * np.cos(3 * times)])
    force = 50 * x + 0.05 * 50 * rate - 2 * 9 * x
    of_block, of_wall = (
        np.asarray(driven_block.reaction(name))[:, 1] for name in ("block", "wall")
    )
    assert_close(of_block, force, digits=10)
    assert_close(of_wall, -50 * x - 2.5 * rate, digits=10)


def check_energy_balance(balance, by_loads):
    """Check the energies of a motion, in which loads that keep their direction work."""
    assert np.max(np.abs(balance.imbalance)) < 1e-5 * np.max(np.asarray(balance.elastic))
    assert np.all(np.diff(np.asarray(balance.dissipated, float)) > 0)
    assert np.asarray(balance.by_drives).any()
    assert_close(balance.by_loads, by_loads, digits=9)


def test_energy_balance_of_a_driven_and_loaded_block(driven_block):
    y = np.asarray(driven_block.displacement("block"))[:, 2]
    check_energy_balance(driven_block.energies, -y)


@pytest.mark.slow
def test_resonant_load_gives_an_oscillation_that_grows_linearly():
    """x = t sin(w t) / (2 w) for a load cos(w t) on a unit mass."""

    def loads(time):
        force = 2 * jnp.cos(5 * time)
        return [tj.Load("block", force=(force, 0.0))]

    times = np.array([0.0, 1.0, 2.0])
    motion = tj.simulate(oscillator(), times, loads=loads, tolerance=1e-9)
    expected = times * np.sin(5 * times) / 10
    np.testing.assert_allclose(motion.displacement("block")[:, 1], expected, atol=1e-7)


@pytest.mark.slow
def test_energy_balance_of_a_driven_and_loaded_linkage():
    def loads(time):
        return [tj.Load("3", force=(0.0, -1.0)), tj.Load("4", moment=1e-3)]

    motion = tj.simulate(
        four_bar.four_bar(),
        np.linspace(0, 0.2, 9),
        drives=four_bar.crank_rotation,
        loads=loads,
        tolerance=1e-9,
    )
    y = np.asarray(motion.displacement("3"))[:, 2]
    angle = np.asarray(motion.displacement("4"))[:, 0]
    check_energy_balance(motion.energies, -y + 1e-3 * angle)


@pytest.mark.slow
def test_gauss_conserves_energy_over_a_hundred_thousand_steps(validated):
    """The error of the energy neither grows nor drifts while an arm swings by 0.5 rad."""
    hinge = tj.Hinge(
        "h", "wall", "arm", tj.Quadratic(some_stiffness(3)), at=(0.4, -0.3, 0.1)
    )
    arm = tj.Body("arm", pose=(0.2, 0.1, 0.3), mass=0.5, inertia=2e-2)
    motion = tj.simulate(
        tj.Mechanism([tj.Body("wall"), arm], [hinge], fixed=["wall"]),
        np.linspace(0, 400.0, 101),
        velocities={"arm": (3.0, 0.5, -1.0)},
        solver=tj.solve.Gauss(),
        step=4e-3,
        max_steps=200_000,
        energies=False,
    )
    assert np.max(np.abs(motion.displacement("arm")[:, 0])) > 0.5
    assert int(motion.steps) >= 99_999
    total = motion.energies.elastic + motion.energies.kinetic
    error = np.asarray(total / total[0] - 1)
    assert np.max(np.abs(error)) < 1e-8
    assert abs(np.mean(error[51:]) - np.mean(error[1:51])) < 1e-9
    what = "energy after 1e5 undamped steps (`Gauss`)"
    validated("Motion", what, total, total[0] * np.ones(101), "energy at the start")


def test_constant_steps_may_be_longer_than_the_axial_period_of_a_leaf():
    """The steps are 1 ms, a period is 0.7 ms; the energy is conserved.

    If the Newton iteration of a step did not converge, the motion would end.
    """
    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.2e-3, width=10e-3)
    block = tj.Body("block", pose=(0.0, 25e-3, 0.0), mass=0.1, inertia=1e-5)
    hinge = tj.Hinge("leaf", "wall", "block", leaf, at=(0.0, 0.0, 0.0))
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
    step = 1e-3
    assert float(tj.vibrations(mechanism).frequencies[-1]) > 1.4 / step
    start = {"block": (0.0, 0.0, 0.5)}
    motion = tj.simulate(mechanism, [0.0, 0.01, 0.02], velocities=start, step=step)
    energy = np.asarray(motion.energies.kinetic + motion.energies.elastic)
    np.testing.assert_allclose(energy[1:], energy[0], rtol=2e-4)


@pytest.mark.slow
def test_derivatives_of_a_stiff_motion_agree_with_differences():
    """Hinges vibrate at 10 kHz, links at 36 Hz; reverse and forward derivatives."""
    times = np.array([0.0, 0.01])

    def angle(damping, speed, tolerance=1e-9, adjoint=None):
        motion = four_bar.released_motion(
            four_bar.four_bar(damping=damping),
            times,
            speed,
            tolerance=tolerance,
            energies=False,
            adjoint=adjoint,
        )
        return motion.displacement("2")[-1, 0]

    @jax.jit
    def value_and_slope(at, tangent, tolerance):
        in_forward_mode = partial(angle, tolerance=tolerance, adjoint=dfx.ForwardMode())
        return jax.jvp(in_forward_mode, at, tangent)

    at = (1e-4, 5.0)
    reverse = jax.jit(jax.grad(angle, argnums=(0, 1)))(*at)
    for k, step in enumerate((1e-6, 1e-3)):
        tangent = tuple(float(k == j) for j in range(2))
        _, forward = value_and_slope(at, tangent, 1e-9)
        assert_close(forward, reverse[k], digits=8)
        after, before = (
            value_and_slope(
                (at[0] + change * tangent[0], at[1] + change * tangent[1]), tangent, 1e-11
            )[0]
            for change in (step, -step)
        )
        difference = (after - before) / (2 * step)
        assert_close(forward / difference, jnp.ones(()), digits=5)


@pytest.mark.slow
def test_solvers_output_and_events_of_diffrax_can_be_used():
    """The oracle is the damped oscillation of a block that is released with 1 m/s."""
    mechanism = oscillator(0.02)
    start = {"block": (0.0, 1.0, 0.0)}
    decay = 0.02 * 50 / 4
    omega = np.sqrt(25 - decay**2)
    exact = [0.0, np.exp(-decay) * np.sin(omega) / omega, 0.0]
    explicit = tj.simulate(
        mechanism, [0.0, 1.0], velocities=start, solver=dfx.Tsit5(), tolerance=1e-8
    )
    assert_close(explicit.displacement("block")[-1], exact, digits=6)
    every_step = tj.simulate(
        mechanism,
        [0.0, 1.0],
        velocities=start,
        max_steps=300,
        tolerance=1e-9,
        saveat=dfx.SaveAt(steps=True, dense=True),
    )
    accepted = np.isfinite(every_step.times)
    assert accepted.sum() == int(every_step.steps) - int(every_step.rejected)
    assert np.max(np.abs(every_step.energies.imbalance[accepted])) < 1e-7
    assert_close(every_step.at(1.0)[1], exact, digits=8)
    stopped = tj.simulate(
        mechanism,
        [0.0, 1.0],
        velocities=start,
        tolerance=1e-9,
        saveat=dfx.SaveAt(t1=True),
        event=dfx.Event(
            lambda t, now, args, **_: now.velocities[1, 1], optx.Newton(1e-9, 1e-9)
        ),
    )
    assert str(tj.result_names(stopped.result)) == "event_occurred"
    assert stopped.succeeded
    # First zero of the velocity.
    assert_close(float(stopped.times[0]), np.arctan(omega / decay) / omega, digits=6)


def test_motion_is_printed_and_converted_to_a_table():
    motion = four_bar.driven_motion(
        four_bar.four_bar("identical"), [0.0, 0.03, 0.06, 0.09], tolerance=1e-8
    )
    assert repr(motion).startswith("successful: 0 to 0.09 s in ")
    dataset = motion.to_xarray()
    assert dataset.x.attrs["units"] == "m" and dataset.moment.attrs["units"] == "N m"
    angle = float(dataset.angle.sel(body="2", time=0.09))
    assert angle == np.asarray(motion.pose("2"))[-1, 0]
    assert int(dataset.steps) == int(motion.steps)


def test_a_motion_of_microseconds_may_begin_at_a_late_time():
    """The steps are a hundred times the spacing of numbers at this time."""
    times = 1e6 + np.linspace(0.0, 2e-6, 9)
    frequency = 6 * np.pi / 2e-6  # rad/s
    motion = tj.simulate(
        oscillator(damping=0.0, mass=50.0 / frequency**2),
        times,
        loads=[tj.Load("block", force=(0.0, 0.0))],
        start=[[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]],
        tolerance=1e-9,
    )
    expected = 0.1 * np.cos(frequency * (times - times[0]))
    found = np.asarray(motion.displacement("block"))[:, 1]
    assert_close(found[-1], expected[-1], digits=7)


def test_motion_that_starts_at_an_equilibrium_stays_there_under_the_same_loads():
    mechanism, push = oscillator(damping=0.0), tj.Load("block", force=(1.0, 0.0))
    equilibrium = tj.equilibrium(mechanism, loads=[push])
    share = np.linspace(0.0, 1.0, 9)
    constant = tj.simulate(mechanism, share, loads=[push], start=equilibrium)
    last = np.asarray(constant.displacements)[-1]
    assert_close(last, equilibrium.displacements, digits=12)
    half_period, no_load = np.pi / 5, tj.Load("block", force=(0.0, 0.0))
    released = tj.simulate(
        mechanism, half_period * share, loads=[no_load], start=equilibrium,
        tolerance=1e-9,
    )  # fmt: skip
    expected = 0.02 * np.cos(np.pi * share)
    found = np.asarray(released.displacement("block"))[:, 1]
    assert_close(found, expected, digits=7)


@pytest.fixture
def few_recorded_states(monkeypatch):
    """Record so few states that the backward pass has to replay steps."""
    monkeypatch.setattr(motion_adjoint, "_RECORDED_STATES", 8)
    jax.clear_caches()
    yield
    jax.clear_caches()


def loaded_motion(inputs, adjoint=None):
    """Return a sum that depends on all results of a motion of at least 300 steps."""
    mechanism, force, end = inputs
    motion = tj.simulate(
        mechanism,
        jnp.linspace(0.0, 1.0, 5) * end,
        loads=lambda time: [tj.Load("block", force=(force * time, 0.0))],
        step=1 / 300,
        max_steps=1000,
        adjoint=adjoint,
    )
    values = motion.displacements, motion.energies.dissipated, motion.times
    return sum(jnp.sum(value**2) for value in values)


@pytest.mark.release
def test_gradients_of_long_motions_agree_with_those_of_diffrax(few_recorded_states):
    """Eight of 300 states are recorded; the load closes over a differentiated value."""
    inputs = oscillator(0.02), 2.0, 0.999
    exact = eqx.filter_jit(eqx.filter_grad(loaded_motion))
    expected = jax.tree.leaves(exact(inputs, dfx.RecursiveCheckpointAdjoint()))
    for gradient, by_diffrax in zip(
        jax.tree.leaves(exact(inputs)), expected, strict=True
    ):
        assert_close(gradient, by_diffrax, digits=8)
    assert max(float(jnp.max(jnp.abs(value))) for value in expected) > 0.01


@pytest.mark.release
def test_gradients_of_batches_and_second_derivatives_of_motions():
    mechanism = oscillator(0.02)

    def loss(force):
        return loaded_motion((mechanism, force, 1.0))

    @jax.jit
    @jax.vmap
    def derivatives(force):
        slope, curvature = jax.jvp(jax.grad(loss), (force,), (jnp.ones(()),))
        return loss(force), slope, curvature

    forces, step = jnp.array([-1.0, 2.0, 5.0]), 1e-3
    before, after = derivatives(forces - step), derivatives(forces + step)
    # The loss is nearly quadratic in the force, so differences are exact to rounding.
    for order in (1, 2):
        exact = (after[order - 1] - before[order - 1]) / (2 * step)
        assert jnp.all(jnp.abs(exact) > 1e-3)
        assert_close(derivatives(forces)[order] / exact, jnp.ones(3), digits=8)


@pytest.mark.slow
def test_motions_of_a_large_batch_are_those_of_single_mechanisms():
    """XLA arranges the operations of a batch differently."""

    def position(thickness):
        linkage = four_bar.four_bar(thickness=thickness, damping=1e-4)
        motion = four_bar.released_motion(
            linkage, [0.0, 0.004], tolerance=1e-9, energies=False
        )
        return motion.displacement("3")[-1, 1] / 0.065

    batch = jnp.linspace(0.8e-3, 0.99e-3, 24)
    positions, single = jax.jit(jax.vmap(position))(batch), jax.jit(position)
    assert jnp.ptp(positions) > 0.01
    for at in (0, 23):
        assert_close(positions[at], single(batch[at]), digits=9)
