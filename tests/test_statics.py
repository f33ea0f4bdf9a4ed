"""Equilibria against closed forms, the elastica, and an independent minimization."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import assert_close
from statics_helpers import BLOCK, block_on_spring, cantilever, WALL

import twistorjax as tj
from twistorjax.examples import stage


# Mattiasson, Int. J. Num. Meth. Eng. 17 (1981): PL^2/EI, w/L, u/L, tip angle
MATTIASSON = [
    (1.0, 0.3017207738, 0.0564332363, 0.4613519497),
    (5.0, 0.7137915236, 0.3876283607, 1.2153681176),
    (10.0, 0.8106090249, 0.5549955978, 1.4302855388),
]


@pytest.mark.filterwarnings("ignore:.*more than a full turn")
def test_twist_energy_is_undefined_above_a_full_rotation():
    spring = np.diag([1.0, 100.0, 10.0])
    drives = [tj.Drive("block", angle=6.5)]
    above = tj.equilibrium(block_on_spring(spring, "twist"), drives=drives, throw=False)
    assert tj.result_names(above.result) == "out_of_range"
    below = [tj.Drive("block", angle=6.2)]
    assert tj.equilibrium(block_on_spring(spring, "twist"), drives=below).succeeded


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*more than a full turn")
def test_a_rotation_at_which_only_a_twistor_energy_is_defined_is_reported():
    spring, drives = np.diag([1.0, 100.0, 10.0]), [tj.Drive("block", angle=6.5)]
    with pytest.raises(RuntimeError, match=r"'spring': it is rotated by 6\.5 rad"):
        tj.equilibrium(block_on_spring(spring, "twist"), drives=drives)
    assert tj.equilibrium(block_on_spring(spring, "twistor"), drives=drives).succeeded


def test_force_displaces_a_block_by_its_compliance():
    mechanism = block_on_spring(np.diag([2.0, 8.0, 5.0]))
    solution = tj.equilibrium(mechanism, loads=[tj.Load("block", force=(2.0, 0.0))])
    assert_close(solution.displacement("block"), [0.0, 0.25, 0.0])
    assert_close(solution.energy, 0.25)
    assert_close(solution.reaction("wall"), [0.0, -2.0, 0.0])
    assert_close(solution.reaction("block"), [0.0, 0.0, 0.0])


def test_the_loads_of_the_start_stabilize_it_as_they_are_increased():
    """The end of a leaf is pulled by a force that acts beside the origin of its body.

    A constant force and moment at the origin would have another stiffness, against which
    the leaf is not stable.
    """
    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
    hinge = tj.Hinge("leaf", "wall", "block", leaf, at=(0.0, 0.0, 0.0))
    mechanism = tj.Mechanism([WALL, BLOCK], [hinge], fixed=["wall"])

    def pulled(factor, start=None):
        force = 35.0 * factor, 0.4 * factor
        pull = tj.Load("block", force=force, at=(25e-3, 0.0))
        return tj.equilibrium(mechanism, loads=[pull], start=start)

    again, directly = pulled(4.0, start=pulled(3.0)), pulled(4.0)
    assert_close(again.displacements, directly.displacements, digits=8)


def test_strokes_start_from_those_of_the_start():
    """A preloaded spring between walls is compressed further by a stroke."""
    stiffness = np.diag([0.02, 1e5, 1e3])
    hinges = [
        tj.Hinge("left", "wall", "block", tj.Quadratic(stiffness), (0.0, -0.1, 0.0)),
        tj.Hinge("right", "block", "wall", tj.Quadratic(stiffness), (0.0, 0.1, 0.0)),
    ]
    mechanism = tj.Mechanism([WALL, BLOCK], hinges, fixed=["wall"])

    def stretched(stroke, start=None):
        strokes = {"left": (0.0, stroke, 0.0), "right": (0.0, -stroke, 1e-6)}
        return tj.equilibrium(mechanism.with_strokes(strokes), start=start)

    first = stretched(0.01)
    again, directly = stretched(0.05, start=first), stretched(0.05)
    assert_close(again.displacements, directly.displacements, digits=8)


@pytest.mark.parametrize("coordinates", ["twist", "twistor"])
def test_moment_rotates_a_block_by_the_closed_form(coordinates):
    """The moment is k angle (equation 3.4) or k sin(angle) (equation 4.7)."""
    mechanism = block_on_spring(np.diag([2.0, 8.0, 5.0]), coordinates)
    solution = tj.equilibrium(mechanism, loads=[tj.Load("block", moment=1.9)])
    expected = 0.95 if coordinates == "twist" else np.arcsin(0.95)
    angle = np.asarray(solution.displacement("block"))[0]
    assert_close(angle, expected, digits=10)


@pytest.mark.parametrize(("force", "down", "back", "angle"), MATTIASSON)
def test_cantilever_bends_as_the_elastica(force, down, back, angle, validated):
    """The error is of second order, so two numbers of leaves give the limit."""
    tips = []
    for elements in (20, 40):
        end = str(elements)
        load = tj.Load(end, force=(0.0, force))
        solution = tj.equilibrium(cantilever(elements), loads=[load])
        rotation, x, y = np.asarray(solution.displacement(end))
        tips.append(np.array([y, -x, rotation]))
    limit = tips[1] + (tips[1] - tips[0]) / 3
    np.testing.assert_allclose(limit, [down, back, angle], rtol=3e-5)
    what = f"cantilever of 40 leaves under P L²/E I = {force:g}, extrapolated"
    validated("Statics", what, limit, [down, back, angle], "Mattiasson, 1981")


def test_cantilever_with_an_end_rotation_of_two_pi_is_a_circle(validated):
    """The axial stiffness does not increase the number of steps."""
    mechanism = cantilever(12, axial=1e8)
    solution = tj.equilibrium(mechanism, drives=[tj.Drive("12", angle=2 * np.pi)])
    assert_close(solution.pose("12"), [2 * np.pi, 0.0, 0.0], digits=10)
    moment = np.asarray(solution.reaction("12"))[0]
    assert_close(moment, 2 * np.pi, digits=9)
    what = "moment that bends 12 leaves to a circle"
    validated("Statics", what, moment, 2 * np.pi, "2 π E I/L")
    assert solution.steps < 60


def test_straight_column_is_stable_up_to_the_load_of_euler(validated):
    """Above this load the straight column still balances the load, but is unstable."""
    load = tj.Load("20", force=(-4.0, 0.0))
    solution = tj.equilibrium(cantilever(20), loads=[load], throw=False)
    assert tj.result_names(solution.result) == "no_equilibrium"
    critical = 4.0 * np.asarray(solution.fraction)
    assert_close(critical, np.pi**2 / 4, digits=3)
    what = "buckling load of 20 leaves in a row"
    validated("Statics", what, critical, np.pi**2 / 4, "Euler's load, π²/4")
    assert_close(np.asarray(solution.reached)[20, 2], 0.0)
    assert not solution.succeeded


@pytest.mark.parametrize("force", [3.0, 5.0])
def test_follower_load_of_zero_does_not_change_the_buckling_load(force):
    loads = [
        tj.Load("10", force=(-force, 0.0)),
        tj.Load("10", force=(0.0, 0.0), follower=True),
    ]
    solution = tj.equilibrium(cantilever(10), loads=loads, throw=False)
    assert tj.result_names(solution.result) == "no_equilibrium"
    assert_close(force * np.asarray(solution.fraction), np.pi**2 / 4, digits=1)


def test_follower_load_rotates_with_its_body():
    mechanism = cantilever(10)
    loads = [
        tj.Load("10", force=(0.0, 0.0)),
        tj.Load("10", force=(0.0, 2.0), follower=True),
    ]
    solution = tj.equilibrium(mechanism, loads=loads)
    angle, x, y = np.asarray(solution.pose("10"))
    reaction = np.asarray(solution.reaction("0"))
    force = -2.0 * np.array([-np.sin(angle), np.cos(angle)])
    assert_close(reaction[1:], force, digits=9)
    assert_close(reaction[0], x * force[1] - y * force[0], digits=9)


def test_weight_hangs_below_a_hinge_without_torsional_stiffness():
    """Only the load determines the angle."""
    free = tj.Quadratic(np.diag([0.0, 1e4, 1e4]))
    hinge = tj.Hinge("pin", "wall", "block", free, (0.0, 0.0, 0.0))
    mechanism = tj.Mechanism([WALL, BLOCK], [hinge], fixed=["wall"])
    weight = tj.Load("block", force=(0.0, -5.0), at=(0.1, -1.0))
    solution = tj.equilibrium(mechanism, loads=[weight])
    angle = np.asarray(solution.displacement("block"))[0]
    assert_close(angle, -np.arctan(0.1), digits=8)


@pytest.mark.parametrize("unit", [1e-20, 1e-9, 1e9])
def test_equilibrium_does_not_depend_on_the_unit_of_force(unit):
    """It does not even if a load increment is rejected."""

    def tip(unit):
        load = tj.Load("20", force=(-4.0 * unit, 0.01 * unit))
        mechanism = cantilever(20, factor=unit)
        return tj.equilibrium(mechanism, loads=[load]).displacement("20")

    assert_close(tip(unit), tip(1.0), digits=8)


@pytest.mark.parametrize("follower", [False, True])
def test_force_that_acts_at_a_distance_from_the_origin_has_a_moment(follower):
    mechanism = block_on_spring(np.diag([2.0, 8.0, 5.0]), "twist")
    load = tj.Load("block", force=(0.0, -1.0), at=(0.4, 0.1), follower=follower)
    solution = tj.equilibrium(mechanism, loads=[load])
    angle = np.asarray(solution.displacement("block"))[0]
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    arm, force = rotation @ [0.4, 0.1], np.array([0.0, -1.0])
    if follower:
        force = rotation @ force
    applied = np.array([arm[0] * force[1] - arm[1] * force[0], *force])
    wrenches = jax.jit(lambda poses: mechanism.wrenches(poses))(solution.poses)
    residual = np.asarray(wrenches)[1] + applied
    assert_close(residual, np.zeros(3), digits=9)


def moved_stage(travel, *, force=(0.0, 0.0), at=(0.0, 0.0), of_4=0.0, of_3=0.0):
    """Move the stage under a force on body 4, and under moments on bodies 4 and 3."""
    loads = [tj.Load("4", moment=of_4, force=force, at=at), tj.Load("3", moment=of_3)]
    drives = [tj.Drive("6", x=travel)]
    return tj.equilibrium(stage.microstage(), loads=loads, drives=drives)


def test_stage_under_loads_and_a_drive_agrees_with_a_minimization():
    """SciPy minimizes energy minus work over the same free coordinates."""
    mechanism = stage.microstage()
    moment, force, travel = 2e-4, np.array([0.3, -0.2]), 1.0e-6
    solution = moved_stage(travel, force=force, at=(0.002, -0.003), of_3=moment)
    free = [k for k in range(18) if k not in (*mechanism.fixed, 16)]
    # In these units, the stage is well conditioned.
    unit = np.tile([1e-4, 1e-6, 1e-6], 6)[free]

    @jax.jit
    def expand(values):
        displacements = jnp.zeros(18).at[16].set(travel)
        return displacements.at[np.array(free)].set(values * unit).reshape(6, 3)

    def potential(values):
        displacements = expand(values)
        angle, x, y = displacements[3]
        arm_x = jnp.cos(angle) * 0.002 + jnp.sin(angle) * 0.003
        arm_y = jnp.sin(angle) * 0.002 - jnp.cos(angle) * 0.003
        work = force[0] * (x + arm_x) + force[1] * (y + arm_y)
        work += moment * displacements[2, 0]
        return 1e6 * (mechanism.hinge_assembly.energy(displacements) - work)

    minimum = scipy.optimize.minimize(
        jax.jit(jax.value_and_grad(potential)),
        np.zeros(len(free)),
        jac=True,
        hess=jax.jit(jax.hessian(potential)),
        method="trust-exact",
        options={"gtol": 1e-9},
    )
    np.testing.assert_allclose(
        solution.displacements, expand(minimum.x), atol=1e-14, rtol=1e-7
    )


def test_reaction_of_a_drive_is_the_load_that_causes_the_same_displacement():
    pull = tj.Load("6", force=(20.0, 0.0))
    loaded = tj.equilibrium(stage.microstage(), loads=[pull])
    x = np.asarray(loaded.displacement("6"))[1]
    displaced = moved_stage(x)
    assert_close(np.asarray(displaced.reaction("6"))[1], 20.0, digits=8)
    np.testing.assert_allclose(
        displaced.displacements, loaded.displacements, rtol=1e-8, atol=1e-17
    )


def test_reactions_balance_the_loads():
    solution = moved_stage(1e-6, force=(3.0, -2.0), of_4=0.01)
    poses, wrenches = np.asarray(solution.poses), np.array(solution.reactions)
    wrenches[solution.names.index("4")] += [0.01, 3.0, -2.0]
    moments, forces = wrenches[:, 0], wrenches[:, 1:]
    about_origin = moments + poses[:, 1] * forces[:, 1] - poses[:, 2] * forces[:, 0]
    assert_close(np.sum(about_origin), 0.0, digits=8)
    assert_close(np.sum(forces, axis=0), np.zeros(2), digits=8)


def test_start_near_the_solution_saves_steps():
    mechanism = cantilever(20)
    loads = [tj.Load("20", force=(0.0, 5.0))]
    solution = tj.equilibrium(mechanism, loads=loads)
    again = tj.equilibrium(mechanism, loads=loads, start=solution.poses)
    assert_close(again.poses, solution.poses, digits=9)
    assert int(again.steps) < int(solution.steps) / 2


def test_soft_hinge_converges_next_to_one_that_stores_much_more_energy():
    leaf = tj.Quadratic(np.diag([1.0, 1e4, 12.0]), "twist")
    stiff = tj.Quadratic(1e12 * np.eye(3))
    mechanism = tj.Mechanism(
        [tj.Body("wall"), tj.Body("tip", (0, 1, 0)), tj.Body("block", (0, 0, 5))],
        [
            tj.Hinge("leaf", "wall", "tip", leaf, at=(0, 0.5, 0)),
            tj.Hinge("spring", "wall", "block", stiff, at=(0, 0, 5)),
        ],
        fixed=["wall"],
    )
    loads = [tj.Load("tip", force=(0, 0.7)), tj.Load("block", force=(1e12, 0))]
    solution = tj.equilibrium(mechanism, loads=loads)
    wrenches = jax.jit(lambda poses: mechanism.wrenches(poses))(solution.poses)
    np.testing.assert_allclose(np.asarray(wrenches)[1], [0.0, 0.0, -0.7], atol=1e-3)


def test_equilibrium_is_printed_in_a_few_lines():
    mechanism = block_on_spring(np.diag([2.0, 8.0, 5.0]))
    printed = repr(tj.equilibrium(mechanism, loads=[tj.Load("block", force=(2.0, 0))]))
    first, head, wall, block = printed.splitlines()
    assert first.startswith("successful: 100 % of loads and prescribed displacements, ")
    assert head.split() == ["body", "angle", "(rad)", "x", "(m)", "y", "(m)"]
    assert (wall.split()[0], block.split()) == ("wall", ["block", "0", "0.25", "0"])
    load = tj.Load("40", force=(0.0, 1.0))
    long = tj.equilibrium(cantilever(40), loads=[load])
    assert len(repr(long).splitlines()) < 25


@pytest.mark.slow
def test_a_batch_without_free_degrees_of_freedom_has_its_reactions():
    """If each degree of freedom is prescribed, the spring alone gives the reaction."""

    def reaction(x):
        drive = tj.Drive("block", angle=0.0, x=x, y=0.0)
        block = block_on_spring(np.diag([1.0, 100.0, 10.0]))
        found = tj.equilibrium(block, drives=[drive], throw=False)
        return jnp.asarray(found.reaction("block"))

    strokes = np.array([0.0, 0.01, -0.02])
    expected = [np.asarray(reaction(x))[1] for x in strokes]
    assert expected[1] != 0
    reactions = np.asarray(jax.jit(jax.vmap(reaction))(strokes))[:, 1]
    np.testing.assert_allclose(reactions, expected, rtol=1e-12)
