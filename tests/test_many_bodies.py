"""Mechanisms of many bodies, whose matrices are eliminated in blocks."""

from dataclasses import replace
from functools import partial
from operator import attrgetter

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from helpers import assert_close, mostly_slow, some_stiffness

import twistorjax as tj
from twistorjax.linalg.block_factors import block_layout
from twistorjax.solve.equations.dofs import DofPartition
from twistorjax.solve.equations.problem import Problem
from twistorjax.solve.integration import system
from twistorjax.solve.integration.choice import chosen_solver, largest_rate


COUNT = 60
SLENDER = np.diag([COUNT, 1e6 * COUNT, 12 * COUNT**3])


def chain(stiffness, fixed=("0",)):
    """Return a row of equal links, by default with the first one fixed."""
    return tj.Mechanism(*links(stiffness), fixed=fixed)


def links(stiffness):
    size = 1 / COUNT
    energy = tj.Quadratic(stiffness, "twist")
    bodies = [tj.Body(str(k), (0.0, k * size, 0.0)) for k in range(COUNT + 1)]
    hinges = [
        tj.Hinge(str(k), str(k), str(k + 1), energy, (0.0, (k + 0.5) * size, 0.0))
        for k in range(COUNT)
    ]
    return bodies, hinges


def lattice(columns, rows, fixed, **inertia):
    """Return bodies on a grid, with hinges of full stiffness between neighbors."""
    grid = [(i, j) for i in range(rows) for j in range(columns)]
    energies = [tj.Quadratic(some_stiffness(k)) for k in range(rows + columns)]
    bodies = [tj.Body(f"{i} {j}", (0.0, i, j), **inertia) for i, j in grid]
    hinges = []
    for i, j in grid:
        energy = energies[i + j]
        if i + 1 < rows:
            ends, at = (f"{i} {j}", f"{i + 1} {j}"), (0, i + 0.5, j)
            hinges.append(tj.Hinge(f"{ends}", *ends, energy, at))
        if j + 1 < columns:
            ends, at = (f"{i} {j}", f"{i} {j + 1}"), (0, i, j + 0.5)
            hinges.append(tj.Hinge(f"{ends}", *ends, energy, at))
    return tj.Mechanism(bodies, hinges, fixed=fixed)


def test_moment_bends_a_chain_to_a_polygon():
    """A pure moment rotates all hinges by the same angle."""
    load = tj.Load(str(COUNT), moment=3.0)
    solution = tj.equilibrium(chain(SLENDER), loads=[load])
    angles = 3.0 / COUNT * np.arange(COUNT + 1)
    links = np.stack([np.cos(angles), np.sin(angles)]) / COUNT
    ends = np.cumsum(links, axis=1)[:, :-1] - links[:, :1] / 2
    positions = np.concatenate([np.zeros((2, 1)), ends + links[:, 1:] / 2], axis=1)
    np.testing.assert_allclose(solution.poses[:, 0], angles, atol=1e-9)
    np.testing.assert_allclose(solution.poses[:, 1:], positions.T, atol=1e-9)


def test_blocks_are_used_for_long_mechanisms_only():
    def layout(mechanism):
        free = tuple(set(range(mechanism.reference.size)) - set(mechanism.fixed))
        return block_layout(mechanism.hinge_assembly.ends, tuple(sorted(free)))

    fixed = ["0 0"]
    assert layout(chain(SLENDER)) is not None
    assert layout(lattice(3, 40, fixed)) is not None
    assert layout(lattice(3, 4, fixed)) is None  # few degrees of freedom
    assert layout(lattice(7, 7, fixed)) is None  # few blocks
    assert layout(lattice(30, 2, fixed)) is not None  # the order of bodies is arbitrary
    blocks = layout(lattice(14, 14, fixed))
    assert blocks is not None and blocks.size < 60


@pytest.mark.parametrize("follower", [False, True])
def test_block_factorization_agrees_with_a_dense_one(follower):
    """One body can only rotate; one is partly prescribed; loads act off the origins."""
    fixed = {"0 0": ("angle", "x", "y"), "7 1": ("x", "y")}
    mechanism = lattice(3, 24, fixed)
    prescribed = mechanism.dofs_of("prescribed", {"23 2": ["angle", "y"]})
    loads = [
        tj.Load(body, (0.3, 0.5, -0.2), at=(0.4, 0.1), follower=follower)
        for body in ("23 2", "11 1")
    ]
    problem = Problem.of(mechanism, loads, held=prescribed)
    system, dofs = problem.system, problem.dofs
    shape = mechanism.reference.shape
    rng = np.random.default_rng(0)
    displacements, right = 0.01 * rng.normal(size=shape), rng.normal(size=len(dofs.free))
    move = np.array([0.7, -0.4])

    @jax.jit
    def in_blocks_and_whole(displacements, right, move):
        _, tangent, _ = system.tangent(displacements)
        factors = tangent.factors(system.loads.conservative)
        in_blocks = *factors.solve_and_check(right), tangent.prescribed_forces(move)
        return in_blocks, system.whole_stiffness(displacements)[0]

    in_blocks, matrix = in_blocks_and_whole(displacements, right, move)
    solution, stable, forces = in_blocks
    matrix = np.asarray(matrix)[list(dofs.free)]
    by_free, by_prescribed = matrix[:, list(dofs.free)], matrix[:, list(prescribed)]
    expected = np.linalg.solve(by_free, right)
    np.testing.assert_allclose(solution, expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(forces, by_prescribed @ move, rtol=1e-12, atol=1e-12)
    assert bool(stable) == bool(np.linalg.slogdet(by_free)[0] > 0)


def masses_on_springs(stiffness=100.0):
    """Return a row of equal masses on springs, the first of which is fixed."""
    spring = tj.Quadratic(jnp.diag(jnp.stack([1.0, stiffness, 1.0])), "twist")
    bodies = [
        tj.Body(str(k), (0.0, float(k), 0.0), mass=2.0, inertia=1.0)
        for k in range(COUNT + 1)
    ]
    hinges = [
        tj.Hinge(str(k), str(k), str(k + 1), spring, (0.0, k + 0.5, 0.0), damping=0.05)
        for k in range(COUNT)
    ]
    return tj.Mechanism(bodies, hinges, fixed=["0"])


def wave(stiffness=100.0, **settings):
    """Return the motion of the row for 1 s after a push on its end."""
    settings = {"tolerance": 1e-9, "energies": False} | settings
    velocities = {str(COUNT): (0.0, 1.0, 0.0)}
    return tj.simulate(
        masses_on_springs(stiffness), [0.0, 1.0], velocities=velocities, **settings
    )


def exact_wave(stiffness=100.0):
    springs = np.diff(np.eye(COUNT + 1), axis=0)[:, 1:]  # Their elongations
    rate = -stiffness / 2.0 * springs.T @ springs
    zero, one = np.zeros_like(rate), np.eye(COUNT)
    solution = scipy.linalg.expm(np.block([[zero, one], [rate, 0.05 * rate]]))
    return solution[:COUNT, -1]


@pytest.mark.parametrize("solver", mostly_slow([tj.solve.Radau(), None]))
def test_a_wave_along_masses_on_springs_is_the_exponential_of_a_matrix(solver):
    motion = wave(solver=solver)
    assert motion.method == ("Radau" if solver else "Tsit5")
    assert_close(motion.displacements[-1, 1:, 1], exact_wave(), digits=8)


def test_a_motion_is_explicit_if_a_thousand_steps_are_stable():
    mechanism = masses_on_springs()
    rest = jnp.zeros_like(mechanism.reference)
    at_start = mechanism.inertia(), DofPartition.of(mechanism), rest
    rate = largest_rate(mechanism.hinge_assembly, at_start[0], rest)
    springs = np.diff(np.eye(COUNT + 1), axis=0)[:, 1:]
    largest = np.linalg.eigvalsh(100.0 / 2.0 * springs.T @ springs)[-1]
    assert np.sqrt(largest) <= rate < 2 * np.sqrt(largest)

    def method(mechanism, steps):
        solver = chosen_solver(mechanism, *at_start, steps * 2.5 / rate)
        return type(solver).__name__

    assert method(mechanism, 990.0) == "Tsit5"
    assert method(mechanism, 1010.0) == "Radau"

    def in_batch(steps):
        assert method(mechanism, steps) == "Radau"
        return steps

    jax.vmap(in_batch)(jnp.ones(2))


@pytest.mark.slow
@pytest.mark.parametrize("solver", [tj.solve.Radau(), None])
def test_derivatives_of_a_wave_by_the_stiffness(solver):
    """The explicit motion is differentiated by diffrax, the implicit one step by step."""

    def end(stiffness):
        return wave(stiffness, solver=solver).displacements[-1, -1, 1]

    by_reverse = jax.grad(end)(100.0)
    step = 1e-3
    difference = (exact_wave(100.0 + step) - exact_wave(100.0 - step)) / (2 * step)
    assert_close(1e3 * by_reverse, 1e3 * difference[-1], digits=6)


@pytest.mark.slow
def test_motions_with_blocks_agree_with_those_of_dense_matrices(monkeypatch):
    """One body can only rotate; one is driven; follower loads act off the origins."""

    def motion():
        fixed = {"0 0": ("angle", "x", "y"), "7 1": ("x", "y")}
        mechanism = lattice(3, 24, fixed, mass=1.0, inertia=0.2)
        load = tj.Load("12 2", force=(0.0, 0.5), at=(12.3, 2.1), follower=True)
        return tj.simulate(
            mechanism,
            [0.0, 1.0],
            loads=[load],
            drives=lambda time: [tj.Drive("23 2", angle=0.1 * time**2, y=0.2 * time**3)],
            tolerance=1e-8,
            solver=tj.solve.Radau(),
        )

    assert_blocks_agree_with_dense_matrices(motion, monkeypatch)


@pytest.mark.slow
def test_constrained_motions_with_blocks_agree_with_those_of_dense_matrices(monkeypatch):
    """A pin couples bodies that are far from each other, a slider moves with time."""

    def motion():
        mechanism = lattice(3, 24, ["0 0"], mass=1.0, inertia=0.2)
        distance = tj.Constraint(
            "distance",
            ("2 2", "9 0"),
            lambda first, second, time: (
                jnp.linalg.norm(second[1:] - first[1:])
                - jnp.hypot(7.0, 2.0)
                - 0.01 * time**2
            ),
        )
        return tj.simulate(
            mechanism,
            [0.0, 1.0],
            constraints=[tj.Pin("pin", "12 1", "13 1", at=(12.4, 1.3)), distance],
            loads=[tj.Load("23 2", moment=0.1, force=(0.1, 0.5))],
            tolerance=1e-8,
        )

    assert_blocks_agree_with_dense_matrices(motion, monkeypatch)


def assert_blocks_agree_with_dense_matrices(motion, monkeypatch):
    in_blocks = motion()
    monkeypatch.setattr(system, "block_layout", lambda *_: None)
    jax.clear_caches()
    dense = motion()
    assert dense.steps == in_blocks.steps
    assert_close(in_blocks.displacements, dense.displacements, digits=10)
    assert_close(in_blocks.velocities, dense.velocities, digits=9)


def test_chain_above_the_load_of_euler_is_unstable():
    euler = np.pi**2 / 4

    def is_stable(force):
        load = tj.Load(str(COUNT), force=(-force, 0.0))
        return tj.equilibrium(chain(SLENDER), loads=[load], throw=False).succeeded

    assert is_stable(0.95 * euler) and not is_stable(1.05 * euler)


def test_a_slider_raises_the_load_at_which_a_chain_buckles():
    """Both ends are then clamped. Otherwise, it would buckle at a sixteenth."""
    end, euler = str(COUNT), 4 * np.pi**2
    rail = tj.Slider("rail", "0", end, at=(0.0, 1.0, 0.0))

    def is_stable(force):
        load = tj.Load(end, force=(-force, 0.0))
        return tj.equilibrium(
            chain(SLENDER), loads=[load], constraints=[rail], throw=False
        ).succeeded

    assert is_stable(0.97 * euler) and not is_stable(1.03 * euler)


@pytest.mark.parametrize("height", [1.9995, 2.0])
def test_a_load_that_takes_the_stiffness_of_a_held_rotation(height):
    """The first of two bars on springs cannot turn, so that its weight does nothing."""
    spring = tj.Quadratic(np.diag([1.0, 1e3, 1e3]))
    bodies, hinges = links(np.diag([1.0, 1e3, 1e3]))
    bodies += [tj.Body("first"), tj.Body("second")]
    hinges += [
        tj.Hinge("lower", "0", "first", spring, at=(0.0, 0.0, 0.0)),
        tj.Hinge("upper", "first", "second", spring, at=(0.0, 0.0, 0.0)),
    ]
    bars = tj.Mechanism(bodies, hinges, fixed=["0"])
    held = [tj.Constraint("held", ["first"], lambda poses, time: poses[0])]
    # The stiffness of the first bar against rotation is 2 N m/rad without the weight.
    weight = tj.Load("first", force=(0.0, -1.0), at=(0.0, height))
    loads = [weight, tj.Load("second", moment=1e-3)]
    found = tj.equilibrium(bars, loads=loads, constraints=held)
    np.testing.assert_allclose(found.displacement("second")[0], 1e-3, rtol=1e-5)


@pytest.mark.parametrize("solve", [tj.equilibrium, tj.linearize])
def test_a_pin_of_a_chain_is_a_fixed_point(solve):
    end = str(COUNT)
    pin = tj.Pin("pin", "0", end, at=(1.0, 0.0))
    start = {"0": ["angle", "x", "y"]}
    loads = [tj.Load(str(COUNT // 2), force=(1.0, 40.0)), tj.Load(end, moment=2.0)]

    def response(fixed, constraints, factor):
        held = chain(factor * SLENDER, fixed)
        if solve is tj.linearize:
            found = solve(held, constraints=constraints)(loads=loads)
        else:
            found = solve(held, loads=loads, constraints=constraints)
        return found.displacements, found

    pinned, fixed = (
        jax.jvp(partial(response, held, constraints), (1.0,), (1.0,), has_aux=True)
        for held, constraints in ((start, [pin]), ({**start, end: ["x", "y"]}, []))
    )
    for first, second in zip(pinned[:2], fixed[:2], strict=True):
        assert_close(first, second, digits=9)
    assert_close(pinned[2].constraint_forces, fixed[2].reactions[-1, 1:], digits=9)


@pytest.mark.release
def test_derivatives_of_a_long_chain_agree_with_differences():
    def tip(factor):
        factors = jnp.array([factor, 1.0, 1.0])
        mechanism = chain(jnp.diag(jnp.diagonal(SLENDER) * factors))
        load = tj.Load(str(COUNT), force=(0.0, 1.0))
        return tj.equilibrium(mechanism, loads=[load]).displacement(str(COUNT))[2]

    @jax.jit
    def with_derivatives(factor):
        first, second = jax.jvp(jax.grad(tip), (factor,), (1.0,))
        return tip(factor), first, second

    factor, step = 1.3, 1e-3
    before, (value, first, second), after = (
        with_derivatives(factor + k * step) for k in (-1, 0, 1)
    )
    first_difference = (after[0] - before[0]) / (2 * step)
    second_difference = (after[0] - 2 * value + before[0]) / step**2
    assert abs(first / first_difference - 1) < 1e-5
    assert abs(second / second_difference - 1) < 1e-4


def vibrating_lattice(stiffness=1.0):
    """Return a lattice of bodies, of which the first two can only rotate."""
    fixed = {"0 0": ("angle", "x", "y"), "7 1": ("x", "y")}
    mechanism = lattice(3, 24, fixed, mass=1.5, inertia=0.2)
    factors = jnp.where(np.arange(len(mechanism.hinge_names)) % 5 == 0, stiffness, 1.0)
    (group,) = mechanism.hinge_assembly.groups
    assert isinstance(group.energy, tj.Quadratic)
    matrices = factors[np.array(group.members), None, None] * group.energy.stiffness
    where = attrgetter("hinge_assembly.groups")
    energy = eqx.tree_at(attrgetter("stiffness"), group.energy, matrices)
    return eqx.tree_at(where, mechanism, (replace(group, energy=energy),))


def exact_modes(mechanism, count):
    """Frequencies (Hz) and shapes by LAPACK, from the matrix of all bodies."""
    size = mechanism.reference.size
    free = [dof for dof in range(size) if dof not in mechanism.fixed]
    stiffness = np.asarray(mechanism.stiffness(mechanism.reference)).reshape(size, size)
    inertia = np.asarray(mechanism.inertia()).reshape(-1)
    inertia = np.where(np.isinf(inertia), 1.5, inertia)[free]
    stiffness = stiffness[np.ix_(free, free)]
    squares, vectors = scipy.linalg.eigh(stiffness, np.diag(inertia))
    shapes = np.zeros((count, size))
    shapes[:, free] = vectors[:, :count].T
    return np.sqrt(squares[:count]) / (2 * np.pi), shapes.reshape(count, -1, 3)


def test_few_modes_of_many_bodies_are_the_lowest_ones():
    mechanism = vibrating_lattice()
    found = tj.vibrations(mechanism, modes=6)
    frequencies, shapes = exact_modes(mechanism, 6)
    np.testing.assert_allclose(found.frequencies, frequencies, rtol=1e-10)
    signs = np.sign(np.sum(shapes * np.asarray(found.shapes), axis=(1, 2)))
    assert_close(signs[:, None, None] * found.shapes, shapes, digits=8)


@pytest.mark.slow
def test_frequencies_and_shapes_of_few_modes_are_differentiable():
    def modes(stiffness):
        found = tj.vibrations(vibrating_lattice(stiffness), modes=4)
        shape = found.shapes[2, -1, 1]
        return jnp.stack([found.frequencies[2], shape * jnp.sign(shape)])

    def exact(stiffness):
        frequencies, shapes = exact_modes(vibrating_lattice(stiffness), 4)
        return np.array([frequencies[2], abs(shapes[2, -1, 1])])

    step = 1e-4
    before, now, after = (exact(1.3 + k * step) for k in (-1, 0, 1))
    value, first = modes(1.3), jax.jacfwd(modes)(1.3)
    assert_close(value / now, [1, 1], digits=9)
    assert_close(first / ((after - before) / (2 * step)), [1, 1], digits=5)
    assert_close(jax.jacrev(modes)(1.3) / first, [1, 1], digits=7)


@pytest.mark.slow
def test_second_derivatives_of_few_modes_agree_with_differences():
    def modes(stiffness):
        found = tj.vibrations(vibrating_lattice(stiffness), modes=4)
        shape = found.shapes[2, -1, 1]
        return jnp.stack([found.frequencies[2], shape * jnp.sign(shape)])

    step = 1e-3
    slope = jax.jit(jax.jacfwd(modes))
    second = jax.jacfwd(jax.jacfwd(modes))(1.3)
    difference = (slope(1.3 + step) - slope(1.3 - step)) / (2 * step)
    assert_close(second / difference, [1, 1], digits=4)


def test_bodies_without_support_have_three_motions_without_a_frequency():
    mechanism = lattice(3, 24, (), mass=1.5, inertia=0.2)
    frequencies = np.asarray(tj.vibrations(mechanism, modes=5).frequencies)
    assert np.all(frequencies[:3] < 1e-6 * frequencies[3])
    exact = scipy.linalg.eigvalsh(
        np.asarray(mechanism.stiffness(mechanism.reference)).reshape(216, 216),
        np.diag(np.asarray(mechanism.inertia()).reshape(-1)),
    )
    assert_close(frequencies[3:], np.sqrt(exact[3:5]) / (2 * np.pi), digits=9)


def row_of_masses(stiffness=100.0, damping=0.0):
    """Return masses of 2 kg on equal springs along x and y, the first of which is fixed.

    The springs have two directions, so that each frequency occurs twice.
    """
    factors = jnp.array([0.0, 1.0, 1.0])
    spring = tj.Quadratic(jnp.diag(stiffness * factors), "twist")
    damper = tj.energies.ViscousDamping(jnp.diag(damping * factors), "twist")
    bodies = [tj.Body(str(k), (0, 0, 0), mass=2.0, inertia=1.0) for k in range(COUNT + 1)]
    hinges = [
        tj.Hinge(str(k), str(k), str(k + 1), spring, (0, 0, 0), damping=damper)
        for k in range(COUNT)
    ]
    fixed = {str(k): ["angle"] for k in range(1, COUNT + 1)} | {"0": ["angle", "x", "y"]}
    return tj.Mechanism(bodies, hinges, fixed)


def frequency_of_row(number):
    """Return a natural frequency of the row; Hz."""
    sines = np.sin((2 * number - 1) * np.pi / (2 * (2 * COUNT + 1)))
    return 2 * np.sqrt(100.0 / 2.0) * sines / (2 * np.pi)


def amplitude_of_row(stiffness, damping, frequency):
    """Return the amplitudes of the masses for a force of 1 N on the last one; m.

    The amplitudes of the masses are `a sin(k t)`, which satisfies the equations of all
    masses but the last one.
    """
    with jax.numpy_dtype_promotion("standard"):
        omega = 2 * np.pi * frequency
        spring = stiffness + 1j * omega * damping
        # From the cosine, because JAX has no arcsine of complex numbers.
        cosine = 1 - omega**2 * 2.0 / (2 * spring)
        angle = -1j * jnp.log(cosine + 1j * jnp.sqrt(1 - cosine**2))
        shape = jnp.sin(np.arange(1, COUNT + 1) * angle)
        force = spring * (shape[-1] - shape[-2]) - omega**2 * 2.0 * shape[-1]
        return shape / force


PUSH_ALONG_X = tj.Load(str(COUNT), force=(1.0, 0.0))


def test_equal_frequencies_are_all_found():
    found = tj.vibrations(row_of_masses(), modes=6)
    assert_close(
        found.frequencies, frequency_of_row(np.repeat(np.arange(1, 4), 2)), digits=10
    )


def test_harmonic_response_of_a_row_and_its_derivative():
    frequencies = np.array([0.0, 0.02, 0.3, 2.0])

    def response(stiffness):
        row = row_of_masses(stiffness, 0.5)
        found = tj.frequency_response(row, frequencies, loads=[PUSH_ALONG_X])
        free = DofPartition.of(row).free
        assert block_layout(row.hinge_assembly.ends, free) is not None
        return jnp.abs(found.displacement(str(COUNT))[1:, 1])

    def exact(stiffness):
        rows = [amplitude_of_row(stiffness, 0.5, f)[-1] for f in frequencies[1:]]
        return jnp.abs(jnp.stack(rows))

    assert_close(response(100.0), exact(100.0), digits=10)
    assert_close(jax.jacrev(response)(100.0), jax.jacrev(exact)(100.0), digits=9)


@pytest.mark.slow
def test_reverse_derivatives_of_a_response_under_a_follower_load():
    """Its stiffness is not symmetric."""
    mechanism = lattice(3, 24, ["0 0"], mass=1.5, inertia=0.2)

    def response(force):
        load = tj.Load("23 2", force=(force, 0.5), follower=True)
        state = tj.equilibrium(mechanism, loads=[load])
        found = tj.frequency_response(
            mechanism, [0.01], loads=[tj.Load("23 0", force=(0.0, 1.0))], about=state,
            static_loads=[load],
        )  # fmt: skip
        return found.displacement("12 1")[0].real

    forward = jax.jacfwd(response)(0.3)
    assert_close(jax.jacrev(response)(0.3) / forward, np.ones(3), digits=8)


@pytest.mark.parametrize(("mass", "number"), [(COUNT, 3), (11, 6)])
def test_resonance_of_many_bodies_without_damping_is_found(mass, number):
    """Mass 11 is a node of the sixth mode."""
    with pytest.raises(RuntimeError, match="there is a resonance without damping"):
        tj.frequency_response(
            row_of_masses(), [0.1, frequency_of_row(number)],
            loads=[tj.Load(str(mass), force=(1.0, 0.0))],
        )  # fmt: skip


@pytest.mark.parametrize("part", [1, 2, 3, 6, 7, 12])
def test_resonance_of_a_part_of_many_bodies_is_none(part):
    """The first masses of the row, up to a body that does not move, are eliminated."""
    sine = np.sin(np.pi / (2 * (part + 1)))
    frequency = 2 * np.sqrt(100.0 / 2.0) * sine / (2 * np.pi)
    found = tj.frequency_response(row_of_masses(), [frequency], loads=[PUSH_ALONG_X])
    exact = np.asarray(amplitude_of_row(100.0, 0.0, frequency))
    amplitudes = np.asarray(found.displacements)[0, 1:, 1]
    size = np.max(np.abs(exact))
    assert_close(amplitudes / size, exact / size, digits=9)


def test_model_of_few_modes_has_the_static_response_of_all():
    model = tj.state_space(
        row_of_masses(damping=0.5),
        {"force": PUSH_ALONG_X},
        {"x": (str(COUNT), "x"), "y": (str(COUNT), "y")},
        modes=12,
    )
    assert_close(model.static_gain[:, 0], np.array([COUNT / 100.0, 0.0]), digits=9)
    found = model.frequency_response(np.array([0.01]))[0, 0, 0]
    assert_close(found / amplitude_of_row(100.0, 0.5, 0.01)[-1], 1.0 + 0j, digits=5)


def test_unstable_modes_of_many_bodies_are_found():
    """A column of links under 1.5 times the load of Euler has one of them."""
    force = 1.5 * np.pi**2 / 4
    links = chain(SLENDER)
    bodies = [
        tj.Body(name, pose, mass=1.0, inertia=1e-4)
        for name, pose in zip(links.names, np.asarray(links.reference), strict=True)
    ]
    energy = tj.Quadratic(SLENDER, "twist")
    hinges = [
        tj.Hinge(name, *ends, energy, at)
        for name, ends, at in zip(
            links.hinge_names,
            zip(links.names, links.names[1:], strict=False),
            np.asarray(links.at),
            strict=True,
        )
    ]
    column = tj.Mechanism(bodies, hinges, fixed=["0"])
    loads = [tj.Load(str(COUNT), force=(-force, 0.0))]
    poses = np.array(column.reference)
    # The strain of all links is the same.
    poses[:, 1] -= force / 1e6 / COUNT * np.arange(COUNT + 1)
    with pytest.raises(RuntimeError, match="without an increase of the energy"):
        tj.vibrations(column, modes=3, about=poses, loads=loads)
    found = tj.vibrations(column, modes=3, about=poses, loads=loads, throw=False)
    assert list(np.isnan(found.frequencies)) == [True, False, False]


@pytest.mark.parametrize("modes", [0, 301, 2.0])
@pytest.mark.untyped
def test_the_number_of_modes_is_checked(modes):
    mechanism = lattice(4, 25, (), mass=1.5, inertia=0.2)
    with pytest.raises(ValueError, match="but the mechanism has 300 modes"):
        tj.vibrations(mechanism, modes=modes)
