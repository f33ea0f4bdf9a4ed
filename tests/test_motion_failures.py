"""Motions that cannot begin or cannot continue, and constraints that must not drift."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistorjax as tj


pytestmark = pytest.mark.slow

GRAVITY = 9.81


def pendulum(length=0.5, spring=1e-3, inertia=0.01, mass=1.0):
    """A bob that a weak spring holds at its pivot, where a pin may hold it as well."""
    hinge = tj.Hinge(
        "spring", "wall", "bob", tj.Quadratic(spring * jnp.eye(3)), at=(0.0, 0.0, 0.0)
    )
    bob = tj.Body("bob", (0.0, length, 0.0), mass=mass, inertia=inertia)
    return tj.Mechanism([tj.Body("wall"), bob], [hinge], fixed=["wall"])


def test_a_motion_that_cannot_begin_takes_no_step():
    """One program for a batch of eight motions, seven of which have a bad value."""

    def swing(values):
        mechanism = pendulum(spring=values["spring"])
        start = mechanism.reference.at[1, 0].add(values["turn"])
        return tj.simulate(
            mechanism, [0.0, 1.0],
            start=start,
            velocities={"bob": (values["rate"], 0.0, 0.5 * values["rate"])},
            loads=[tj.Load("bob", (0.0, 0.0, -GRAVITY))],
            constraints=[tj.Pin("pin", "wall", "bob", at=(values["pin"], 0.0))],
            tolerance=values["tolerance"],
            throw=False,
        )  # fmt: skip

    usual = {"spring": 1e-3, "turn": 0.0, "rate": 1.0, "pin": 0.0, "tolerance": 1e-4}
    bad = [
        ({}, "successful"),
        ({"turn": np.nan}, "not_finite"),
        ({"rate": np.inf}, "not_finite"),
        ({"pin": np.nan}, "not_finite"),
        ({"tolerance": np.nan}, "not_finite"),
        ({"tolerance": np.inf}, "not_finite"),
        ({"tolerance": -1e-4}, "not_finite"),
        ({"turn": 0.1}, "inconsistent_constraints"),
        ({"spring": np.nan}, "not_finite"),
    ]
    rows = [usual | change for change, _ in bad]
    values = {name: jnp.array([row[name] for row in rows]) for name in usual}
    moved = jax.jit(jax.vmap(swing))(values)
    assert tj.result_names(moved.result).tolist() == [item for _, item in bad]
    # A mechanism that is not finite is seen in the first step, all else before it.
    assert moved.steps[0] > 3
    np.testing.assert_array_equal(moved.steps[1:-1], 0)
    assert moved.steps[-1] <= 1
    assert np.all(np.isfinite(moved.displacements[0]))
    assert np.all(np.isnan(moved.displacements[1:-1]))
    assert np.all(np.isnan(moved.solution.ys[1].position[1:-1]))


def test_a_drive_that_jumps_or_ends_in_nothing_delays_no_other_motion():
    spring = tj.Quadratic(jnp.diag(jnp.array([1.0, 100.0, 100.0])))
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
    block = tj.Body("block", mass=1.0, inertia=0.1)
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])

    def follow(values):
        jump, end = values

        def drive(time):
            late = jnp.where(time > 0.05, end, 0.0)
            return [tj.Drive("block", x=jump + 1e-3 * time**2 + late)]

        return tj.simulate(mechanism, [0.0, 0.1], drives=drive, throw=False)

    moved = jax.vmap(follow)(jnp.array([[0.0, 0.0], [1e-3, 0.0], [0.0, np.nan]]))
    names = tj.result_names(moved.result).tolist()
    assert names == ["successful", "drive_jumps", "not_finite"]
    assert moved.steps[1] == 0
    assert moved.steps[2] < 100


@pytest.mark.parametrize(
    "solver", [dfx.Tsit5(), tj.solve.Radau()], ids=["tsit5", "radau"]
)
def test_every_solver_stops_where_a_load_is_not_finite(solver):
    mechanism = pendulum()

    def gust(time):
        return [tj.Load("bob", (0.0, 0.0, jnp.where(time > 0.1, jnp.nan, 1.0)))]

    moved = tj.simulate(
        mechanism, [0.0, 0.2], loads=gust, solver=solver, tolerance=1e-4, throw=False
    )
    assert not moved.succeeded
    assert 0.05 < moved.reached < 0.1 + 1e-6
    assert moved.steps < 100


@pytest.mark.parametrize(
    "solver",
    [dfx.Tsit5(), pytest.param(dfx.Kvaerno5(), marks=pytest.mark.long)],
    ids=["tsit5", "kvaerno5"],
)
def test_a_pin_stays_where_it_is_with_solvers_of_diffrax(solver):
    """Twenty swings to and fro: the bob stays on its circle, and keeps its energy."""
    mechanism, length = pendulum(spring=1e-9), 0.5
    moved = tj.simulate(
        mechanism, np.linspace(0, 30.0, 31),
        loads=[tj.Load("bob", (0.0, 0.0, -GRAVITY))],
        constraints=[tj.Pin("pin", "wall", "bob", at=(0.0, 0.0))],
        solver=solver,
        tolerance=1e-4,
    )  # fmt: skip
    # as it was integrated, before a report projects it
    angle, x, y = moved.solution.ys[0].position.T
    away = np.hypot(length + x - length * np.cos(angle), y - length * np.sin(angle))
    assert np.max(away) < 1e-5
    fallen = GRAVITY * length * np.sin(angle)
    rate = moved.velocity("bob")[:, 0]
    energy = (0.01 + length**2) * rate**2 / 2 + fallen
    assert np.max(np.abs(energy)) < 1e-3 * GRAVITY * length


def test_what_a_constraint_allows_does_not_depend_on_the_size():
    for size in (1e-7, 1.0, 1e3):
        start_on_a_rail(size)


def start_on_a_rail(size):
    """A block on a rail, with times and masses that scale with its size."""
    spring = tj.Quadratic(jnp.diag(jnp.array([size**2, 1.0, 1.0])))
    block = tj.Body("block", (0.0, size, 0.0), mass=1.0, inertia=size**2)
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0.0, size / 2, 0.0))
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
    rail = tj.Slider("rail", "wall", "block", at=(0.0, size, 0.0))

    def move(off=0.0, across=0.0, along=0.0):
        return tj.simulate(
            mechanism, [0.0, 1.0],
            start=mechanism.reference.at[1, 2].add(off),
            velocities={"block": (0.0, along, across)},
            constraints=[rail],
        )  # fmt: skip

    assert move(off=1e-11 * size, along=0.1 * size).succeeded
    with pytest.raises(ValueError, match="'rail' is violated by"):
        move(off=1e-5 * size)
    for share in (1.0, 5e-6):
        with pytest.raises(ValueError, match="velocities at the start violate"):
            move(across=share * size)
    with pytest.raises(ValueError, match="velocities at the start violate"):
        move(across=1e-5 * size, along=size)


def test_errors_are_measured_by_bodies_that_move():
    """The origin of a held body may be anywhere, and rounding errors are no lever."""
    size = 1e-6
    spring = tj.Quadratic(jnp.diag(jnp.array([size**2, 1.0, 1.0])))

    def shifted(wall, arm):
        hinge = tj.Hinge("spring", "wall", "block", spring, at=(0.0, size, 0.0))
        block = tj.Body("block", (0.0, size + arm, 0.0), mass=1.0, inertia=size**2)
        bodies = [tj.Body("wall", (0.0, wall, 0.0)), block]
        mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        start = mechanism.reference.at[1, 1].add(0.1 * size)
        swing = tj.simulate(mechanism, [0.0, np.pi], start=start)  # half a period
        return swing.displacement("block")[1, 1] / size, swing.steps

    for wall, arm in ((0.0, 0.5 * size), (10.0, 0.5 * size), (0.0, 1e-22)):
        end, steps = shifted(wall, arm)
        assert abs(end + 0.1) < 1e-4
        assert steps < 200
