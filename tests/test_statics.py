"""Equilibria against closed forms, the elastica, and an independent minimisation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import assert_close, some_stiffness

import twistorjax as tj


pytestmark = pytest.mark.slow


WALL, BLOCK = tj.Body("wall"), tj.Body("block")


def block_on_spring(stiffness, coordinates="twistor"):
    spring = tj.Quadratic(stiffness, coordinates)
    hinge = tj.Hinge("spring", "wall", "block", spring, (0.0, 0.0, 0.0))
    return tj.Mechanism([WALL, BLOCK], [hinge], fixed=["wall"])


def cantilever(elements, axial=1e6, coordinates="twist"):
    """A slender beam of unit length and bending stiffness, clamped at its left end."""
    size = 1 / elements
    stiffness = np.diag([1 / size, axial / size, 12 / size**3])
    leaf = tj.Quadratic(stiffness, coordinates)
    bodies = [tj.Body(str(k), (0.0, k * size, 0.0)) for k in range(elements + 1)]
    hinges = [
        tj.Hinge(f"{k}", str(k), str(k + 1), leaf, (0.0, (k + 0.5) * size, 0.0))
        for k in range(elements)
    ]
    return tj.Mechanism(bodies, hinges, fixed=["0"])


def stage():
    return tj.examples.stage.microstage()


# Mattiasson, Int. J. Num. Meth. Eng. 17 (1981): PL^2/EI, w/L, u/L, tip angle
MATTIASSON = [
    (1.0, 0.3017207738, 0.0564332363, 0.4613519497),
    (5.0, 0.7137915236, 0.3876283607, 1.2153681176),
    (10.0, 0.8106090249, 0.5549955978, 1.4302855388),
]


def test_a_twist_beyond_a_full_turn_is_refused():
    """The twist is not defined there; the twistor is."""
    turned = [tj.Drive("block", angle=6.5)]
    spring = np.diag([1.0, 100.0, 10.0])
    with pytest.raises(RuntimeError, match=r"'spring': it is turned by 6\.5 rad"):
        tj.equilibrium(block_on_spring(spring, "twist"), drives=turned)
    assert tj.equilibrium(block_on_spring(spring, "twistor"), drives=turned).succeeded
    below = [tj.Drive("block", angle=6.2)]
    assert tj.equilibrium(block_on_spring(spring, "twist"), drives=below).succeeded


def test_a_push_moves_a_block_by_its_compliance():
    mechanism = block_on_spring(np.diag([2.0, 8.0, 5.0]))
    solution = tj.equilibrium(mechanism, loads=[tj.Load("block", (0.0, 2.0, 0.0))])
    assert_close(solution.displacement("block"), [0.0, 0.25, 0.0])
    assert_close(solution.energy, 0.25)
    assert_close(solution.reaction("wall"), [0.0, -2.0, 0.0])
    assert_close(solution.reaction("block"), [0.0, 0.0, 0.0])


@pytest.mark.parametrize("coordinates", ["twist", "twistor"])
def test_a_moment_winds_a_block_up(coordinates):
    mechanism = block_on_spring(np.diag([2.0, 8.0, 5.0]), coordinates)
    solution = tj.equilibrium(mechanism, loads=[tj.Load("block", (1.9, 0.0, 0.0))])
    # k angle, or k sin(angle): the closed forms of 3.4 and 4.7
    expected = 0.95 if coordinates == "twist" else np.arcsin(0.95)
    assert_close(solution.displacement("block")[0], expected, digits=10)


@pytest.mark.parametrize(("load", "down", "back", "turn"), MATTIASSON)
def test_a_cantilever_bends_as_the_elastica(load, down, back, turn, validated):
    """Converges at second order: 20 and 40 leaves tell what infinitely many do."""
    tips = []
    for elements in (20, 40):
        end = str(elements)
        solution = tj.equilibrium(
            cantilever(elements), loads=[tj.Load(end, (0.0, 0.0, load))]
        )
        angle, x, y = np.asarray(solution.displacement(end))
        tips.append(np.array([y, -x, angle]))
    limit = tips[1] + (tips[1] - tips[0]) / 3
    np.testing.assert_allclose(limit, [down, back, turn], rtol=3e-5)
    what = f"40 leaves in a row under P L²/E I = {load:g}, extrapolated"
    validated("Statics", what, limit, [down, back, turn], "Mattiasson, 1981")


def test_a_cantilever_driven_through_a_full_turn_is_a_circle(validated):
    mechanism = cantilever(12, axial=1e8)  # stiffness costs no steps
    solution = tj.equilibrium(mechanism, drives=[tj.Drive("12", angle=2 * np.pi)])
    assert_close(solution.pose("12"), [2 * np.pi, 0.0, 0.0], digits=10)
    assert_close(solution.reaction("12")[0], 2 * np.pi, digits=9)
    found = solution.reaction("12")[0], 2 * np.pi
    validated("Statics", "moment that winds a leaf into a circle", *found, "2 π E I/L")
    assert solution.steps < 60


def test_a_column_stands_up_to_the_load_of_euler_and_no_more(validated):
    """Pushed along its axis it is straight in theory; the straight one is unstable."""
    answer = tj.equilibrium(
        cantilever(20), loads=[tj.Load("20", (0.0, -4.0, 0.0))], throw=False
    )
    assert tj.solve.results.result_names(answer.result) == "no_equilibrium"
    assert_close(4.0 * answer.fraction, np.pi**2 / 4, digits=3)
    found = 4.0 * answer.fraction, np.pi**2 / 4
    validated("Statics", "load at which 20 leaves buckle", *found, "Euler's, π²/4")
    assert_close(answer.reached[20, 2], 0.0)
    assert not answer.succeeded


def test_a_follower_keeps_its_angle_to_the_body():
    """It leaves the tip's moment balance to the tip's own frame."""
    mechanism = cantilever(10)
    load = tj.Load("10", (0.0, 0.0, 2.0), follower=True)
    solution = tj.equilibrium(mechanism, loads=[load])
    angle = solution.pose("10")[0]
    reaction = solution.reaction("0")
    expected = -2.0 * np.array([-np.sin(angle), np.cos(angle)])
    assert_close(reaction[1:], expected, digits=9)
    # and the moment about the clamp is that of the turned force at the tip
    tip = np.asarray(solution.pose("10"))[1:]
    assert_close(reaction[0], tip[0] * expected[1] - tip[1] * expected[0], digits=9)


def test_a_weight_hangs_from_a_hinge_that_turns_freely():
    """The load alone picks out where it rests."""
    free = tj.Quadratic(np.diag([0.0, 1e4, 1e4]))
    hinge = tj.Hinge("pin", "wall", "block", free, (0.0, 0.0, 0.0))
    mechanism = tj.Mechanism([WALL, BLOCK], [hinge], fixed=["wall"])
    weight = tj.Load("block", (0.0, 0.0, -5.0), at=(0.1, -1.0))
    solution = tj.equilibrium(mechanism, loads=[weight])
    assert_close(solution.displacement("block")[0], -np.arctan(0.1), digits=8)


@pytest.mark.parametrize("push", [3.0, 5.0])
def test_a_follower_of_no_size_does_not_hold_a_column_up(push):
    loads = [
        tj.Load("6", (0.0, -push, 0.0)),
        tj.Load("3", (0.0, 0.0, 0.0), follower=True),
    ]
    answer = tj.equilibrium(cantilever(6), loads=loads, throw=False)
    assert outcome(answer) == "no_equilibrium"
    assert_close(push * answer.fraction, np.pi**2 / 4, digits=1)


@pytest.mark.parametrize("size", [1e-20, 1e-9, 1e9])
def test_the_answer_does_not_depend_on_the_unit_of_force(size):
    """Also after a step that was cut: nothing in the solver is measured in joules."""

    def tip(size):
        mechanism = cantilever(6)
        (stack,) = mechanism.hinge_assembly.groups
        leaf = tj.Quadratic(size * stack.energy.stiffness, "twist")
        bodies = [tj.Body(str(k), (0.0, k / 6, 0.0)) for k in range(7)]
        hinges = [
            tj.Hinge(str(k), str(k), str(k + 1), leaf, (0.0, (k + 0.5) / 6, 0.0))
            for k in range(6)
        ]
        load = tj.Load("6", (0.0, -4.0 * size, 0.01 * size))
        return tj.equilibrium(
            tj.Mechanism(bodies, hinges, fixed=["0"]), loads=[load]
        ).displacement("6")

    assert_close(tip(size), tip(1.0), digits=8)


@pytest.mark.parametrize("follower", [False, True])
def test_a_load_off_centre_brings_its_moment(follower):
    mechanism = block_on_spring(np.diag([2.0, 8.0, 5.0]), "twist")
    load = tj.Load("block", (0.0, 0.0, -1.0), at=(0.4, 0.1), follower=follower)
    solution = tj.equilibrium(mechanism, loads=[load])
    angle = np.asarray(solution.displacement("block"))[0]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    arm, force = turn @ [0.4, 0.1], np.array([0.0, -1.0])
    if follower:
        force = turn @ force
    unbalanced = mechanism.wrenches(solution.poses)[1] + np.array(
        [arm[0] * force[1] - arm[1] * force[0], *force]
    )
    assert_close(unbalanced, np.zeros(3), digits=9)


def test_mixed_loads_on_the_stage_agree_with_a_minimisation():
    """SciPy minimises energy less work, over the same free coordinates."""
    mechanism = stage()
    moment, force, along = 2e-4, np.array([0.3, -0.2]), 1.0e-6
    solution = tj.equilibrium(
        mechanism,
        loads=[
            tj.Load("4", (0.0, *force), at=(0.002, -0.003)),
            tj.Load("3", (moment, 0.0, 0.0)),
        ],
        drives=[tj.Drive("6", x=along)],
    )
    free = [k for k in range(18) if k not in (*mechanism.fixed, 16)]
    # in units in which the stage is well conditioned
    unit = np.tile([1e-4, 1e-6, 1e-6], 6)[free]

    def place(values):
        moved = jnp.zeros(18).at[16].set(along)
        return moved.at[np.array(free)].set(values * unit).reshape(6, 3)

    def potential(values):
        moved = place(values)
        angle, x, y = moved[3]
        arm_x = jnp.cos(angle) * 0.002 + jnp.sin(angle) * 0.003
        arm_y = jnp.sin(angle) * 0.002 - jnp.cos(angle) * 0.003
        work = force[0] * (x + arm_x) + force[1] * (y + arm_y) + moment * moved[2, 0]
        return 1e6 * (mechanism.hinge_assembly.energy(moved) - work)

    slope = jax.jit(jax.grad(potential))
    curvature = jax.jit(jax.hessian(potential))
    found = scipy.optimize.minimize(
        jax.jit(potential), np.zeros(len(free)), jac=slope, hess=curvature,
        method="trust-exact", options={"gtol": 1e-9},
    )  # fmt: skip
    np.testing.assert_allclose(
        solution.displacements, place(found.x), atol=1e-14, rtol=1e-7
    )


def test_drives_and_loads_are_two_sides_of_one_equilibrium():
    """Driven by what the load achieved, a coordinate reacts with the load."""
    mechanism = stage()
    loaded = tj.equilibrium(mechanism, loads=[tj.Load("6", (0.0, 20.0, 0.0))])
    travel = loaded.displacement("6")[1]
    driven = tj.equilibrium(mechanism, drives=[tj.Drive("6", x=travel)])
    assert_close(driven.reaction("6")[1], 20.0, digits=8)
    np.testing.assert_allclose(
        driven.displacements, loaded.displacements, rtol=1e-8, atol=1e-17
    )


def test_reactions_balance_the_loads():
    mechanism = stage()
    solution = tj.equilibrium(
        mechanism,
        loads=[tj.Load("4", (0.01, 3.0, -2.0))],
        drives=[tj.Drive("6", x=1e-6)],
    )
    about_origin = [
        tj.geometry.se2.transform_wrench(pose.at[0].set(0.0), wrench)
        for pose, wrench in zip(solution.poses, solution.reactions, strict=True)
    ]
    load = tj.geometry.se2.transform_wrench(
        solution.pose("4").at[0].set(0.0), jnp.array([0.01, 3.0, -2.0])
    )
    assert_close(sum(about_origin) + load, np.zeros(3), digits=8)


def test_starts_from_where_it_is_told():
    mechanism = cantilever(10)
    loads = [tj.Load("10", (0.0, 0.0, 5.0))]
    far = tj.equilibrium(mechanism, loads=loads)
    again = tj.equilibrium(mechanism, loads=loads, start=far.poses)
    assert_close(again.poses, far.poses, digits=9)
    assert int(again.steps) < int(far.steps) / 2


# Derivatives


def test_the_derivative_of_an_equilibrium_is_that_of_its_closed_form():
    def travel(k):
        stiffness = jnp.diag(jnp.stack([jnp.ones(()), k, jnp.ones(())]))
        load = tj.Load("block", (0.0, 2.0, 0.0))
        return tj.equilibrium(block_on_spring(stiffness), loads=[load]).displacement(
            "block"
        )[1]

    k = jnp.array(8.0)
    for derivative in (jax.grad, jax.jacfwd, lambda f: jax.grad(jax.jit(f))):
        assert_close(derivative(travel)(k), -2.0 / k**2)
    assert_close(jax.jit(jax.grad(jax.grad(travel)))(k), 4.0 / k**3)


def everything(parameters):
    """A bent chain whose every ingredient depends on the parameters."""
    stiffness, force, turn, place = parameters
    spring = tj.Quadratic(some_stiffness(3) * stiffness)
    ends = [(0.0, 0.0, 0.0), (0.3, 1.0, place), (0.6, 1.8, 0.5)]
    bodies = [tj.Body(str(k), solution) for k, solution in enumerate(ends)]
    hinges = [
        tj.Hinge("h", "0", "1", spring, jnp.stack([jnp.array(0.1), place, place])),
        tj.Hinge("i", "1", "2", spring, (0.2, 1.5, 0.2)),
    ]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["0"])
    solution = tj.equilibrium(
        mechanism,
        loads=[
            tj.Load("1", (0.1, force, 0.5), at=(0.2, 0.1)),
            tj.Load("1", (0.0, 0.0, force), at=(0.1, 0.2), follower=True),
        ],
        drives=[tj.Drive("2", angle=turn)],
    )
    weights = jax.random.normal(jax.random.key(1), (3, 3))
    return (
        jnp.vdot(weights, solution.poses)
        + jnp.vdot(weights, solution.reactions)
        + solution.energy
    )


def test_derivatives_by_all_that_makes_a_mechanism_agree_with_differences():
    parameters = jnp.array([2.0, 0.4, 0.7, 0.3])
    step = 1e-5
    differences = [
        (everything(parameters + step * e) - everything(parameters - step * e))
        / (2 * step)
        for e in jnp.eye(4)
    ]
    assert_close(jax.grad(everything)(parameters), jnp.stack(differences), digits=6)
    assert_close(
        jax.jacfwd(everything)(parameters), jax.grad(everything)(parameters), digits=9
    )


def test_second_derivatives_agree_with_differences_of_first():
    parameters = jnp.array([2.0, 0.4, 0.7, 0.3])
    gradient = jax.jit(jax.grad(everything))
    step = 1e-5
    differences = [
        (gradient(parameters + step * e) - gradient(parameters - step * e)) / (2 * step)
        for e in jnp.eye(4)
    ]
    hessian = jax.jit(jax.hessian(everything))(parameters)
    assert_close(hessian, jnp.stack(differences), digits=5)


def test_derivatives_by_where_it_starts_are_those_of_what_is_held_there():
    """A held body is held where `start` has it."""
    mechanism = cantilever(2)
    loads = [tj.Load("2", (0.0, 0.0, 0.5))]

    def tip(shift):
        start = mechanism.reference.at[0, 2].add(shift)
        solution = tj.equilibrium(mechanism, loads=loads, start=start)
        return jnp.concatenate([solution.displacement("2"), solution.reaction("0")])

    slope = jax.jacfwd(tip)(jnp.array(0.0))
    step = 1e-5
    assert_close(slope, (tip(step) - tip(-step)) / (2 * step), digits=6)
    assert_close(slope[2], 1.0, digits=8)  # the whole beam moves along


# Batches and failures


def outcome(answer):
    return tj.solve.results.result_names(answer.result)


def test_a_batch_answers_each_lane_as_if_alone():
    mechanism = cantilever(6)

    def tip(force):
        solution = tj.equilibrium(
            mechanism, loads=[tj.Load("6", jnp.stack([0 * force, 0 * force, force]))]
        )
        return solution.displacement("6")

    forces = jnp.array([1e-3, 1.0, 20.0])  # with few and with many load steps
    alone = jnp.stack([tip(force) for force in forces])
    assert_close(jax.vmap(tip)(forces), alone, digits=10)


def test_a_bad_lane_is_marked_and_harms_no_other():
    def solve(k, force):
        stiffness = jnp.diag(jnp.stack([jnp.ones(()), k, jnp.ones(())]))
        load = tj.Load("block", jnp.stack([jnp.zeros(()), force, jnp.zeros(())]))
        return tj.equilibrium(block_on_spring(stiffness), loads=[load], throw=False)

    lanes = jax.vmap(solve)(
        jnp.array([4.0, 0.0, jnp.nan, 4.0]), jnp.array([2.0, 2.0, 2.0, jnp.nan])
    )
    assert list(outcome(lanes)) == ["successful", "unstable", "not_finite", "not_finite"]
    assert_close(lanes.displacements[0, 1], [0.0, 0.5, 0.0])


def test_the_gradient_of_a_batch_is_finite_in_good_lanes():
    def travel(k):
        stiffness = jnp.diag(jnp.stack([jnp.ones(()), k, jnp.ones(())]))
        load = tj.Load("block", (0.0, 2.0, 0.0))
        answer = tj.equilibrium(block_on_spring(stiffness), loads=[load], throw=False)
        return answer.displacement("block")[1]

    slopes = jax.vmap(jax.grad(travel))(jnp.array([4.0, 0.0]))
    assert_close(slopes, jnp.array([-2 / 16, 0.0]))


def test_a_failed_answer_is_nan_and_can_be_masked():
    """Its derivative is zero, which a mask keeps out of a sum; NaN it could not."""
    load = tj.Load("block", (0.0, 2.0, 0.0))

    def total(stiffness):
        def solve(factor):
            diagonal = jnp.stack([jnp.ones(()), factor * stiffness, jnp.ones(())])
            return tj.equilibrium(
                block_on_spring(jnp.diag(diagonal)), loads=[load], throw=False
            )

        lanes = jax.vmap(solve)(jnp.array([1.0, 0.0, 2.0]))
        assert_nan = jnp.isnan(lanes.displacements[1]).all() & jnp.isnan(lanes.energy[1])
        kept = jnp.where(lanes.succeeded, lanes.displacement("block")[:, 1], 0.0)
        return jnp.sum(kept), assert_nan

    (value, nan), slope = jax.value_and_grad(total, has_aux=True)(jnp.array(4.0))
    assert nan
    assert_close(value, 2 / 4 + 2 / 8)
    assert_close(slope, -2 / 16 - 2 / 32)


def test_a_failed_batch_says_which_lane():
    def solve(k):
        stiffness = jnp.diag(jnp.stack([jnp.ones(()), k, jnp.ones(())]))
        return tj.equilibrium(block_on_spring(stiffness), throw=False)

    lanes = jax.vmap(solve)(jnp.array([4.0, 0.0]))
    with pytest.raises(RuntimeError, match="index 1 of the batch"):
        tj.solve.statics.raise_error(lanes)


@pytest.mark.parametrize("traced", [False, True])
def test_a_block_that_nothing_keeps_has_no_equilibrium(traced):
    def solve():
        return tj.equilibrium(block_on_spring(np.diag([1.0, 0.0, 1.0]))).poses

    with pytest.raises(Exception, match="can move without storing energy"):
        (jax.jit(solve) if traced else solve)()


def test_a_moment_beyond_what_a_twistor_spring_bears_has_no_equilibrium():
    """It bears k sin(angle): at most k, at a quarter turn."""
    mechanism = block_on_spring(np.eye(3))
    with pytest.raises(RuntimeError, match="No equilibrium was found that is connected"):
        tj.equilibrium(mechanism, loads=[tj.Load("block", (1.25, 0.0, 0.0))])
    answer = tj.equilibrium(
        mechanism, loads=[tj.Load("block", (1.25, 0.0, 0.0))], throw=False
    )
    assert_close(answer.fraction, 0.8, digits=3)
    assert_close(answer.reached[1, 0], np.pi / 2, digits=1)


def test_too_few_steps_are_told():
    with pytest.raises(RuntimeError, match="number of Newton steps was reached"):
        tj.equilibrium(
            cantilever(10), loads=[tj.Load("10", (0.0, 0.0, 5.0))], max_steps=5
        )


def test_needs_double_precision():
    with jax.enable_x64(False):
        with pytest.raises(ValueError, match='update\\("jax_enable_x64", True\\)'):
            tj.equilibrium(block_on_spring(np.eye(3)))
        with pytest.raises(ValueError, match='update\\("jax_enable_x64", True\\)'):
            tj.linearize(block_on_spring(np.eye(3)))


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"loads": [tj.Load("anvil", (0.0, 1.0, 0.0))]},
            r"`loads\[0\]` names the body 'anvil', but the bodies are 'wall', 'block'",
        ),
        (
            {"drives": [tj.Drive("anvil", x=1.0)]},
            r"`drives\[0\]` names the body 'anvil'",
        ),
        ({"tolerance": 0.0}, "`tolerance` is 0.0 and `max_steps` is 400, but they"),
        ({"max_steps": 0}, "`max_steps` is 0, but they"),
        ({"start": jnp.zeros((3, 3))}, r"`start` has shape \(3, 3\), but a mechanism"),
        ({"loads": tj.Load("block", (0, 1, 0))}, "`loads` is one Load: put it in a list"),
        (
            {"loads": [tj.Drive("block", x=1.0)]},
            r"`loads\[0\]` is a Drive, but must be a Load",
        ),
        (
            {"drives": [tj.Drive("wall", x=1.0)]},
            r"`drives\[0\]` prescribes the x of 'wall', which is fixed already",
        ),
        (
            {"drives": [tj.Drive("block", x=1.0), tj.Drive("block", x=1.0)]},
            r"`drives\[1\]` prescribes the x of 'block', which is prescribed already",
        ),
    ],
)
def test_refuses_what_the_mechanism_does_not_have(arguments, message):
    with pytest.raises(ValueError, match=message):
        tj.equilibrium(block_on_spring(np.eye(3)), **arguments)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tj.Drive("b"), "The drive of 'b' prescribes nothing"),
        (
            lambda: tj.Drive("b", x=np.nan),
            "`x` of the drive of 'b' is nan, but must be",
        ),
        (
            lambda: tj.Load("b", (1.0, 2.0)),
            r"`wrench` of the load on 'b' has shape \(2,\)",
        ),
        (
            lambda: tj.Load("b", (1.0, 2.0, np.inf)),
            "`wrench` of the load on 'b' is .*inf.*, but must be finite",
        ),
        (
            lambda: tj.Load("b", (1.0, 2.0, 3.0), at=(0.0,)),
            r"`at` of the load on 'b' has shape \(1,\), but must be \(x, y\)",
        ),
    ],
)
def test_refuses_what_is_no_load_or_drive(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_answers_know_their_bodies():
    solution = tj.equilibrium(block_on_spring(np.eye(3)))
    with pytest.raises(ValueError, match="`body` is 'anvil', but the bodies are 'wall'"):
        solution.displacement("anvil")


def test_answers_print_in_a_few_lines():
    mechanism = block_on_spring(np.diag([2.0, 8.0, 5.0]))
    printed = repr(tj.equilibrium(mechanism, loads=[tj.Load("block", (0, 2.0, 0))]))
    first, head, wall, block = printed.splitlines()
    assert first.startswith("successful: 100 % of loads and drives, ")
    assert head.split() == ["body", "angle", "(rad)", "x", "(m)", "y", "(m)"]
    assert (wall.split()[0], block.split()) == ("wall", ["block", "0", "0.25", "0"])
    assert len(repr(tj.equilibrium(cantilever(100))).splitlines()) < 25
    lanes = jax.vmap(
        lambda k: tj.equilibrium(block_on_spring(k * jnp.eye(3)), throw=False)
    )
    told = repr(lanes(jnp.array([1.0, -2.0, 3.0])))
    assert told == "3 equilibria, of shape (3,): 2 successful, 1 unstable"


# Small displacements


def test_the_linear_map_is_the_limit_of_equilibria():
    mechanism = stage()
    small = tj.linearize(mechanism, {"6": ["x"]})
    loads, drives = [tj.Load("4", (1e-7, 1e-4, 2e-4))], [tj.Drive("6", x=1e-11)]
    linear = small(loads=loads, drives=drives)
    exact = tj.equilibrium(mechanism, loads=loads, drives=drives)
    for quantity in ("displacements", "reactions"):
        expected = np.asarray(getattr(exact, quantity))
        actual = np.asarray(getattr(linear, quantity))
        scale = np.abs(expected).max(axis=0)
        assert_close(actual / scale, expected / scale, digits=5)
    assert_close(linear.energy / exact.energy, 1.0, digits=5)


def test_the_linear_map_about_a_loaded_state_is_its_derivative():
    """With the load's own stiffness, and reactions too."""
    mechanism = cantilever(5)
    loads = [tj.Load("5", (0.0, -1.0, 1.5), at=(0.05, 0.1))]
    state = tj.equilibrium(mechanism, loads=loads)
    small = tj.linearize(mechanism, about=state.poses, loads=loads)
    change = small(loads=[tj.Load("5", (0.0, 0.0, 1.0))])

    def answer(extra):
        push = tj.Load("5", jnp.stack([jnp.zeros(()), jnp.zeros(()), extra]))
        moved = tj.equilibrium(mechanism, loads=[*loads, push])
        return moved.displacements, moved.reactions

    slope, reactions = jax.jacfwd(answer)(jnp.array(0.0))
    assert_close(change.displacements, slope, digits=8)
    assert_close(change.reactions, reactions, digits=7)


def test_the_linear_map_refuses_other_drives():
    small = tj.linearize(stage(), {"6": ["x"]})
    with pytest.raises(
        ValueError, match=r"prescribes nothing, but this map .* for x of '6'"
    ):
        small(loads=[tj.Load("4", (0.0, 1.0, 0.0))])


@pytest.mark.parametrize(
    ("driven", "message"),
    [
        ({"anvil": ["x"]}, "`prescribed` names the body 'anvil', but the bodies are"),
        ({"block": ["X"]}, "`prescribed` of the body 'block' names the coordinate 'X'"),
        (["wall"], "`prescribed` has the angle of 'wall' and x of 'wall'.*fixed already"),
    ],
)
def test_the_linear_map_refuses_what_cannot_be_driven(driven, message):
    with pytest.raises(ValueError, match=message):
        tj.linearize(block_on_spring(np.eye(3)), driven)


def test_the_linear_map_tells_a_loose_mechanism():
    small = tj.linearize(block_on_spring(np.diag([1.0, 0.0, 1.0])))
    with pytest.raises(RuntimeError, match="can move without storing energy"):
        small()


def test_a_soft_part_is_solved_beside_one_that_holds_much_more_energy():
    leaf = tj.Quadratic(jnp.diag(jnp.array([1.0, 1e4, 12.0])), "twist")
    block = tj.Quadratic(1e12 * jnp.eye(3))
    mechanism = tj.Mechanism(
        [tj.Body("wall"), tj.Body("tip", (0, 1, 0)), tj.Body("block", (0, 0, 5))],
        [
            tj.Hinge("leaf", "wall", "tip", leaf, at=(0, 0.5, 0)),
            tj.Hinge("spring", "wall", "block", block, at=(0, 0, 5)),
        ],
        fixed=["wall"],
    )
    loads = [tj.Load("tip", (0, 0, 0.7)), tj.Load("block", (0, 1e12, 0))]
    solution = tj.equilibrium(mechanism, loads=loads)
    resisting = mechanism.wrenches(solution.poses)[1]
    np.testing.assert_allclose(resisting, [0.0, 0.0, -0.7], atol=1e-3)
