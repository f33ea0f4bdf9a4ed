"""Motion: against SciPy, the dissertation's linkages, exact motions, and itself."""

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from helpers import assert_close, some_stiffness
from scipy.integrate import solve_ivp

import twistorjax as tj
from twistorjax.examples import four_bar


pytestmark = pytest.mark.slow


def numbers(text):
    return np.array([[float(cell) for cell in row.split()] for row in text.split("\n")])


# Positions and angles of links 2, 3 and 4 for a damping time of 1 ms, by another program
PANELS = {
    "identical": numbers(
        """0.09 -0.02492426146 0.03135173101 0.3064712409 -0.0148658459 0.0627447506 \
0.002349390197 0.01007548818 0.03139295793 0.2964555945
0.18 -0.01823824063 0.03248878621 0.02999954037 -0.00147720873 0.06497816175 \
3.409415187e-05 0.01676175906 0.03248938293 0.02914353862
0.405 -0.01754560165 0.03249994957 0.001933910937 -9.180402862e-05 0.06499991415 \
8.915162519e-07 0.01745439835 0.03249996516 0.001809271285"""
    ),
    "mixed": numbers(
        """0.09 -0.02436254226 0.03643783615 0.3064712409 -0.01264399614 0.06121225566 \
0.009112280387 0.01104053526 0.03166441267 0.2576254709
0.18 -0.01817728215 0.03748964079 0.02999954037 -0.001246740268 0.06298273548 \
9.880922679e-05 0.01686103932 0.03249203067 0.02525869611
0.405 -0.01753106404 0.0374999617 0.001933910937 -6.759857563e-05 0.06299994209 \
1.138676162e-06 0.01746545588 0.03249998047 0.001373156189"""
    ),
}


@pytest.mark.parametrize("hinges", ["identical", "mixed"])
def test_the_driven_linkage_moves_as_the_dissertation_tells(hinges, validated):
    table = PANELS[hinges]
    motion = four_bar.driven_motion(
        four_bar.four_bar(hinges), [0.0, *table[:, 0]], tolerance=1e-8
    )
    for k, name in enumerate("234"):
        x, y, angle = table[:, 1 + 3 * k : 4 + 3 * k].T
        moved = motion.pose(name)[1:].T
        np.testing.assert_allclose(moved[1:], [x, y], rtol=0, atol=1e-7)
        np.testing.assert_allclose(moved[0], angle, rtol=0, atol=1e-6)
    links = motion.displacement("3")[1:, 1], table[:, 4]
    what = f"driven, {hinges} hinges: travel of link 3"
    validated("Four-bar linkages", what, *links, "a derivation of its own, by SciPy")


def swinging(damping=None, coordinates="twistor", inertia=2e-3):
    """One body on one hinge of every coupling, off its middle."""
    hinge = tj.Hinge(
        "h", "wall", "arm", tj.Quadratic(some_stiffness(3), coordinates),
        (0.4, -0.3, 0.1), damping=damping,
    )  # fmt: skip
    arm = tj.Body("arm", pose=(0.2, 0.1, 0.3), mass=0.5, inertia=inertia)
    return tj.Mechanism([tj.Body("wall"), arm], [hinge], fixed=["wall"])


@pytest.mark.parametrize("coordinates", ["twist", "twistor"])
def test_one_body_moves_as_by_scipy(coordinates, validated):
    """Forces from differences of the energy, drag from the closed form of the wrench."""
    energy = tj.Quadratic(some_stiffness(3), coordinates)
    damping = tj.energies.ViscousDamping(0.02 * some_stiffness(4), coordinates)
    mechanism = swinging(damping, coordinates)
    mass = np.array([2e-3, 0.5, 0.5])
    solution, at = mechanism.reference[1], mechanism.at[0]
    arm = tj.geometry.se2.between(solution, at)

    @jax.jit
    def acceleration(place, rate):
        def stored_energy(place):
            return energy(
                tj.geometry.se2.between(
                    at, tj.geometry.se2.compose(solution + place, arm)
                )
            )

        def port(place):
            return tj.geometry.se2.compose(solution + place, arm)

        here, moving = jax.jvp(port, (place,), (rate,))
        own = jnp.concatenate([moving[:1], tj.geometry.se2.rotate(-here[0], moving[1:])])
        wrench = damping.wrench(tj.geometry.se2.between(at, here), jnp.zeros(3), own)
        to_world = jnp.concatenate(
            [wrench[:1], tj.geometry.se2.rotate(here[0], wrench[1:])]
        )
        _, back = jax.vjp(port, place)
        return (-jax.grad(stored_energy)(place) - back(to_world)[0]) / mass

    def slope(_, state):
        return np.concatenate([state[3:], acceleration(state[:3], state[3:])])

    times = np.linspace(0, 0.6, 7)
    start = np.array([0.0, 0, 0, 3.0, 0.5, -1.0])
    exact = solve_ivp(slope, (0, 0.6), start, "DOP853", times, rtol=1e-11, atol=1e-12).y.T
    moved = tj.simulate(mechanism, times, velocities={"arm": start[3:]}, tolerance=1e-9)
    np.testing.assert_allclose(moved.displacement("arm"), exact[:, :3], atol=1e-6)
    np.testing.assert_allclose(moved.velocity("arm"), exact[:, 3:], atol=2e-5)
    what = f"a body on a damped {coordinates} hinge of all couplings"
    found = moved.displacement("arm")
    validated("Motion", what, found, exact[:, :3], "DOP853 of SciPy, to 1e-11")


def oscillator(damping=None, mass=2.0):
    spring = tj.Quadratic(jnp.diag(jnp.array([1.0, 50.0, 80.0])))
    hinge = tj.Hinge("spring", "wall", "block", spring, (0, 0, 0), damping=damping)
    block = tj.Body("block", mass=mass, inertia=0.1)
    return tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])


def test_a_damped_block_follows_the_textbook():
    """m x'' + c x' + k x = f, with c = t k, from rest."""
    time, load = 0.05, 3.0
    times = np.linspace(0, 2, 9)
    push = tj.Load("block", (0.0, load, 0.0))
    moved = tj.simulate(oscillator(time), times, loads=[push], tolerance=1e-9)
    decay = time * 50 / 4
    omega = np.sqrt(25 - decay**2)
    swing = np.cos(omega * times) + decay / omega * np.sin(omega * times)
    exact = load / 50 * (1 - np.exp(-decay * times) * swing)
    np.testing.assert_allclose(moved.displacement("block")[:, 1], exact, atol=1e-8)


def test_a_driven_block_asks_for_the_force_of_its_motion():
    """Spring, damper and inertia: k x + c x' + m x''."""

    def shake(time):
        return [tj.Drive("block", x=0.01 * jnp.sin(3 * time), angle=0.0, y=0.0)]

    times = np.linspace(0, 1, 5)
    moved = tj.simulate(oscillator(0.05), times, drives=shake)
    swing = 0.01 * np.array([np.sin(3 * times), 3 * np.cos(3 * times)])
    force = 50 * swing[0] + 0.05 * 50 * swing[1] - 2 * 9 * swing[0]
    assert_close(moved.reaction("block")[:, 1], force, digits=10)
    assert_close(moved.reaction("wall")[:, 1], -50 * swing[0] - 2.5 * swing[1], digits=10)


def test_a_load_may_depend_on_time():
    """Resonance grows as t sin(w t) / (2 w)."""

    def push(time):
        return [tj.Load("block", jnp.stack([0 * time, 2 * jnp.cos(5 * time), 0 * time]))]

    moved = tj.simulate(oscillator(), [0.0, 1.0, 2.0], loads=push, tolerance=1e-9)
    times = np.array([0.0, 1.0, 2.0])
    exact = times * np.sin(5 * times) / 10
    np.testing.assert_allclose(moved.displacement("block")[:, 1], exact, atol=1e-7)


@pytest.mark.parametrize("energies", [True, False])
def test_energy_is_accounted_for(energies):
    def pull(time):
        return [tj.Load("3", (0.0, 0.0, -1.0)), tj.Load("4", (1e-3, 0.0, 0.0))]

    moved = tj.simulate(
        four_bar.four_bar(), np.linspace(0, 0.2, 9), drives=four_bar.crank_rotation,
        loads=pull,
        tolerance=1e-9, energies=energies,
    )  # fmt: skip
    told = moved.energies
    if not energies:
        assert not jnp.any(told.dissipated) and not jnp.any(told.by_drives)
        return
    largest = jnp.max(told.elastic)
    assert jnp.max(jnp.abs(told.imbalance)) < 1e-5 * largest
    assert jnp.all(jnp.diff(told.dissipated) > 0)
    # dead loads do force times way
    way = moved.displacement("3")[:, 2], moved.displacement("4")[:, 0]
    assert_close(told.by_loads, -way[0] + 1e-3 * way[1], digits=9)


def test_drives_and_constraints_do_the_same(validated):
    times = np.linspace(0, 0.1, 4)
    linkage = four_bar.four_bar()
    crank = tj.Constraint(
        "crank",
        ["2"],
        lambda pose, time: pose[0] - four_bar.crank_rotation(time)[0].angle,
    )
    driven = four_bar.driven_motion(linkage, times, tolerance=1e-10)
    bound = tj.simulate(linkage, times, constraints=[crank], tolerance=1e-10)
    assert_close(bound.displacements, driven.displacements, digits=8)
    assert_close(
        bound.constraint_force("crank")[:, 0], driven.reaction("2")[:, 0], digits=6
    )
    assert_close(bound.energies.by_drives, driven.energies.by_drives, digits=8)
    both = bound.displacements, driven.displacements
    validated("Motion", "a crank as a constraint", *both, "the same as a drive")


def pendulum(**settings):
    """A bar on a pin, with next to no spring, let go aside."""
    loose = tj.Quadratic(jnp.zeros((3, 3)))
    bar = tj.Body("bar", pose=(0.0, 0.0, -0.5), mass=2.0, inertia=0.3)
    mechanism = tj.Mechanism(
        [tj.Body("wall"), bar], [tj.Hinge("h", "wall", "bar", loose, (0, 0, 0))], ["wall"]
    )
    angle = 1.0
    aside = jnp.array([[0.0, 0, 0], [angle, 0.5 * np.sin(angle), -0.5 * np.cos(angle)]])
    return tj.simulate(
        mechanism,
        loads=[tj.Load("bar", (0, 0, -2 * 9.81))],
        constraints=[tj.Pin("pin", "wall", "bar", at=(0, 0))],
        start=aside,
        **settings,
    )


def test_a_pendulum_swings_about_its_pin():
    """Energy gives the speed at each angle; the pin bears weight and what turns it."""
    moved = pendulum(times=np.linspace(0, 2, 11), tolerance=1e-9)
    angle, x, y = moved.displacement("bar").T
    omega = moved.velocity("bar")[:, 0]
    about_pin = 0.3 + 2 * 0.25
    fallen = 2 * 9.81 * 0.5 * (np.cos(angle) - np.cos(1.0))
    assert_close(about_pin * omega**2 / 2, fallen, digits=6)
    assert_close(x, 0.5 * np.sin(angle), digits=10)
    assert_close(y - 0.5, -0.5 * np.cos(angle), digits=10)
    along = 2 * (9.81 * np.cos(angle) + 0.5 * omega**2)
    turning = -2 * 9.81 * 0.5 * np.sin(angle) / about_pin
    across = 2 * (0.5 * turning + 9.81 * np.sin(angle))
    push = -along * np.sin(angle) + across * np.cos(angle)
    lift = along * np.cos(angle) + across * np.sin(angle)
    assert_close(moved.constraint_force("pin"), np.stack([push, lift], axis=1), digits=5)


def test_constraints_do_not_drift():
    moved = pendulum(
        times=[0.0, 20.0], step=2e-3, solver=tj.solve.Radau(), energies=False
    )
    assert int(moved.steps) == 10_000
    angle, x, y = moved.displacement("bar")[-1]
    assert np.hypot(x - 0.5 * np.sin(angle), y - 0.5 + 0.5 * np.cos(angle)) < 1e-10


def test_a_slider_leaves_one_way():
    loose = tj.Quadratic(jnp.diag(jnp.array([0.0, 30.0, 0.0])))
    block = tj.Body("block", mass=2.0, inertia=0.1)
    mechanism = tj.Mechanism(
        [tj.Body("wall"), block], [tj.Hinge("h", "wall", "block", loose, (0, 0, 0))],
        ["wall"],
    )  # fmt: skip
    rail = tj.Slider("rail", "wall", "block", at=(np.pi / 6, 0, 0))
    moved = tj.simulate(
        mechanism, [0.0, 0.3, 0.7], constraints=[rail], tolerance=1e-9,
        loads=[tj.Load("block", (0.2, 0.0, -4.0))],
    )  # fmt: skip
    angle, x, y = moved.displacement("block").T
    assert_close(angle, np.zeros(3), digits=12)
    assert_close(y, np.tan(np.pi / 6) * x, digits=10)
    # along the rail: m s'' = -4 sin(30 deg) - 30 cos^2(30 deg) s
    omega = np.sqrt(30 * 0.75 / 2)
    way = -2 / 22.5 * (1 - np.cos(omega * np.array([0.0, 0.3, 0.7])))
    np.testing.assert_allclose(x / np.cos(np.pi / 6), way, atol=1e-8)
    spring = jax.vmap(mechanism.wrenches)(moved.poses)[:, 1, 0]
    assert_close(moved.constraint_force("rail")[:, 0], -0.2 - spring, digits=10)


def test_a_pseudo_rigid_body_model_stands_beside_ours():
    """Section 5.4: pins with torsion springs where the leaves are; stiff ones agree."""
    linkage = four_bar.four_bar(damping=None)
    torsion = tj.Quadratic(jnp.diag(jnp.array([0.14375, 0.0, 0.0])))
    bodies = [
        tj.Body(name, linkage.reference[k], linkage.masses[k], linkage.inertias[k])
        for k, name in enumerate("1234")
    ]
    ends = {"A": "12", "B": "23", "C": "34", "D": "41"}
    hinges = [
        tj.Hinge(name, *pair, torsion, linkage.at[k])
        for k, (name, pair) in enumerate(ends.items())
    ]
    pins = [
        tj.Pin(name, *pair, linkage.at[k, 1:])
        for k, (name, pair) in enumerate(ends.items())
    ]
    model = tj.Mechanism(bodies, hinges, fixed=["1"])
    times = np.linspace(0, 0.02, 3)
    spin = {"2": (-20.0, 0.5, 0.0), "3": (0.0, 1.0, 0.0), "4": (-20.0, 0.5, 0.0)}
    pinned = tj.simulate(model, times, constraints=pins, velocities=spin)
    elastic = tj.simulate(linkage, times, velocities=spin)
    swing = float(pinned.displacement("2")[-1, 0])
    assert abs(swing) > 0.05
    assert abs(swing - float(elastic.displacement("2")[-1, 0])) < 0.05 * abs(swing)


def test_undamped_motion_keeps_its_energy(validated):
    """By Gauss's points, over a hundred thousand steps: no growth, no drift."""
    linkage = four_bar.four_bar(damping=None)
    times = np.linspace(0, 1.0, 101)
    moved = four_bar.released_motion(
        linkage, times, 1.0, solver=tj.solve.Gauss(), step=1e-5, max_steps=200_000,
        energies=False,
    )  # fmt: skip
    assert int(moved.steps) >= 99_999
    total = moved.energies.elastic + moved.energies.kinetic
    drift = np.asarray(total / total[0] - 1)
    assert np.max(np.abs(drift)) < 1e-6
    assert abs(np.mean(drift[51:]) - np.mean(drift[1:51])) < 1e-8
    what = "energy after 1e5 undamped steps (`Gauss`)"
    validated("Motion", what, total, total[0] * np.ones(101), "its start")


def test_derivatives_through_a_stiff_run_are_exact():
    """Hinges of 10 kHz, links of 36 Hz; reverse, forward and by differences."""
    times = np.array([0.0, 0.01])

    def angle(damping, speed, tolerance=1e-9, adjoint=None):
        moved = four_bar.released_motion(
            four_bar.four_bar(damping=damping), times, speed, tolerance=tolerance,
            energies=False, adjoint=adjoint,
        )  # fmt: skip
        return moved.displacement("2")[-1, 0]

    at = (1e-4, 5.0)
    reverse = jax.jit(jax.grad(angle, argnums=(0, 1)))(*at)
    for k, step in enumerate((1e-6, 1e-3)):
        tangent = tuple(float(k == j) for j in range(2))
        _, forward = jax.jit(
            lambda *at, tangent=tangent: jax.jvp(
                lambda *at: angle(*at, adjoint=dfx.ForwardMode()), at, tangent
            )
        )(*at)
        assert_close(forward, reverse[k], digits=8)
        ends = [
            angle(*(a + sign * step * t for a, t in zip(at, tangent, strict=True)), 1e-11)
            for sign in (1, -1)
        ]
        differences = (ends[0] - ends[1]) / (2 * step)
        assert_close(forward / differences, jnp.ones(()), digits=5)


def test_a_bad_lane_harms_no_other():
    def moved(mass):
        return tj.simulate(
            oscillator(mass=mass), [0.0, 0.5], velocities={"block": (0, 1.0, 0)},
            throw=False,
        )  # fmt: skip

    batch = jax.vmap(moved)(jnp.array([2.0, -1.0, 3.0]))
    assert tj.result_names(batch.result).tolist() == [
        "successful",
        "not_finite",
        "successful",
    ]
    alone = moved(3.0).displacement("block")
    assert_close(batch.displacement("block")[2], alone, digits=9)
    assert np.all(np.isnan(batch.displacement("block")[1]))


def test_what_diffrax_offers_stays_usable():
    mechanism = oscillator(0.02)
    start = {"block": (0.0, 1.0, 0.0)}
    exact = tj.simulate(mechanism, [0.0, 1.0], velocities=start, tolerance=1e-10)
    other = tj.simulate(
        mechanism, [0.0, 1.0], velocities=start, solver=dfx.Tsit5(), tolerance=1e-8
    )
    assert_close(other.displacements, exact.displacements, digits=6)
    every = tj.simulate(
        mechanism, [0.0, 1.0], velocities=start, max_steps=300, tolerance=1e-9,
        saveat=dfx.SaveAt(steps=True, dense=True),
    )  # fmt: skip
    kept = np.isfinite(every.times)
    assert kept.sum() == int(every.steps) - int(every.rejected)
    assert np.max(np.abs(every.energies.imbalance[kept])) < 1e-7
    assert_close(every.at(1.0)[1], exact.pose("block")[-1], digits=8)
    turned = tj.simulate(
        mechanism, [0.0, 1.0], velocities=start, tolerance=1e-9,
        saveat=dfx.SaveAt(t1=True),
        event=dfx.Event(
            lambda t, now, args, **_: now.velocities[1, 1],
            optx.Newton(1e-9, 1e-9),
        ),
    )  # fmt: skip
    assert str(tj.result_names(turned.result)) == "event_occurred"
    assert turned.succeeded
    # where it turns: the first zero of the velocity of a damped swing
    decay = 0.02 * 50 / 4
    omega = np.sqrt(25 - decay**2)
    assert_close(float(turned.times[0]), np.arctan(omega / decay) / omega, digits=6)


def test_a_motion_prints_and_becomes_a_table():
    moved = four_bar.driven_motion(four_bar.four_bar(), [0.0, 0.09])
    assert repr(moved).startswith("successful: 0 to 0.09 s in ")
    table = moved.to_xarray()
    assert table.x.attrs["units"] == "m" and table.moment.attrs["units"] == "N m"
    assert float(table.angle.sel(body="2", time=0.09)) == float(moved.pose("2")[1, 0])
    assert int(table.steps) == int(moved.steps)


def test_a_motion_may_begin_at_an_equilibrium():
    """At its loads it stays; without them it leaves."""
    mechanism, push = oscillator(), tj.Load("block", (0.0, 1.0, 0.0))
    solution = tj.equilibrium(mechanism, loads=[push])
    kept = tj.simulate(mechanism, [0.0, 1.0], loads=[push], start=solution)
    assert_close(kept.displacements[-1], solution.displacements, digits=12)
    freed = tj.simulate(mechanism, [0.0, np.pi / 5], start=solution, tolerance=1e-9)
    assert_close(freed.displacement("block")[-1, 1], -0.02, digits=7)


PULL = tj.Drive("block", x=0.1)
MISTAKES = {
    "increase": dict(times=[0.0, 1.0, 1.0]),
    "comes after `times[1]` = 2": dict(times=[0.0, 2.0, 1.0]),
    "a row of at least two times": dict(times=[0.0]),
    "`times` must be finite": dict(times=[0.0, np.nan]),
    "The x of 'block' starts at 0, but 0.1 is prescribed.": dict(drives=[PULL]),
    "names the body 'blok'": dict(velocities={"blok": (0, 0, 0)}),
    "but must be a mapping": dict(velocities=[0, 0, 0]),
    "moves the x of 'wall', but that is fixed": dict(velocities={"wall": (0, 1, 0)}),
    "must be finite": dict(velocities={"block": (0, np.nan, 0)}),
    "`tolerance` is 0": dict(tolerance=0),
    "'q' is redundant: 2 of its 2 entries": dict(
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


@pytest.mark.parametrize("message", MISTAKES)
@pytest.mark.untyped
def test_a_mistake_is_told(message):
    settings = {"times": [0.0, 0.1], **MISTAKES[message]}
    with pytest.raises(ValueError) as told:
        tj.simulate(oscillator(0.1), settings.pop("times"), **settings)
    assert message in str(told.value)


def test_a_run_that_stops_says_when_and_where():
    with pytest.raises(RuntimeError, match=r"It reached t = .* in 10 steps.*'spring'"):
        tj.simulate(
            oscillator(), np.linspace(0, 9, 99), velocities={"block": (0, 1.0, 0)},
            max_steps=10,
        )  # fmt: skip


def test_a_value_that_is_not_finite_is_named():
    broken = eqx.tree_at(lambda m: m.masses[1], oscillator(), jnp.array(jnp.nan))
    with pytest.raises(RuntimeError, match="body 'block'"):
        tj.simulate(broken, [0.0, 1.0])


def test_damping_that_gives_energy_is_refused():
    hinge = tj.energies.ViscousDamping(jnp.eye(3))
    with pytest.raises(ValueError, match="negative eigenvalue"):
        tj.energies.ViscousDamping(-jnp.eye(3))
    wrong = eqx.tree_at(lambda v: v.damping, hinge, -jnp.eye(3))
    with pytest.raises(ValueError, match="supply energy"):
        tj.simulate(oscillator(wrong), [0.0, 1.0])


def test_a_pin_may_hold_what_no_hinge_does():
    """A rod that hangs from a held wall by a pin swings as a physical pendulum."""
    spring = tj.Quadratic(jnp.eye(3))
    inertia, mass, reach = 0.02, 2.0, 0.3
    rod = tj.Body("rod", (0.0, 0.0, -reach), mass=mass, inertia=inertia)
    block = tj.Body("block", mass=1.0, inertia=1.0)
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
    mechanism = tj.Mechanism([tj.Body("wall"), block, rod], [hinge], fixed=["wall"])
    with pytest.raises(ValueError, match="Nothing holds 'rod'"):
        tj.equilibrium(mechanism)
    weight = [tj.Load("rod", (0.0, 0.0, -9.81 * mass))]
    period = 2 * np.pi * np.sqrt((inertia + mass * reach**2) / (mass * 9.81 * reach))
    small = 1e-3
    start = mechanism.reference.at[2].set(
        jnp.array([small, reach * np.sin(small), -reach * np.cos(small)])
    )
    moved = tj.simulate(
        *(mechanism, [0.0, period / 2, period]),
        loads=weight,
        constraints=[tj.Pin("pin", "wall", "rod", at=(0.0, 0.0))],
        start=start,
        tolerance=1e-10,
    )
    angle = moved.displacement("rod")[:, 0]
    np.testing.assert_allclose(angle, small * np.array([1, -1, 1]), atol=1e-8)


@pytest.mark.parametrize(
    "drive",
    [
        lambda time: [tj.Drive("2", angle=0.1 if time > 1 else 0.0)],
        lambda time: [tj.Drive("2", angle=np.sin(time))],
    ],
)
def test_a_drive_that_cannot_be_compiled_is_told(drive):
    with pytest.raises(ValueError, match="`drives` is a function that JAX cannot comp"):
        tj.simulate(four_bar.four_bar(), [0.0, 0.1], drives=drive)
