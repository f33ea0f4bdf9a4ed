"""Hinges that are not loaded at a displacement other than zero: preload and assembly."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import assert_close, mostly_slow, some_poses, some_stiffness

import twistorjax as tj
from twistorjax.geometry import se2


REFERENCE = np.array([[0.4, 0.1, -0.2], [-0.7, 0.5, 0.3]])
AT = jnp.array([0.9, 0.3, 0.2])
MISFIT = jnp.array([0.3, 0.2, -0.1])
SPRING = tj.Quadratic(some_stiffness(3))
STEEL = tj.Material(210e9, poisson=0.3)


def pair(
    misfit: Any = MISFIT, energy: tj.AbstractEnergy = SPRING, first="a", damping=None
):
    """Return two bodies that one hinge with a misfit connects."""
    bodies = [tj.Body("a", REFERENCE[0]), tj.Body("b", REFERENCE[1])]
    second = "b" if first == "a" else "a"
    hinge = tj.Hinge("h", first, second, energy, AT, misfit=misfit, damping=damping)
    return tj.Mechanism(bodies, [hinge], fixed=["a"])


def random_poses(seed, count=8):
    return np.stack([some_poses(seed, count), some_poses(seed + 1, count) / 2], axis=1)


def at_each(poses, compute):
    """Compute arrays at each of several poses, in one program."""
    return map(np.asarray, jax.jit(jax.vmap(compute))(poses))


def test_energy_is_that_between_frames_displaced_by_half_the_misfit():
    """The displaced frames are composed by exponential maps."""
    half = jax.jit(lambda misfit: se2.exp(se2.twist(misfit) / 2))(MISFIT)
    without, mechanism = pair(None), pair()

    def energies(poses):
        a, b = without.ports("h", poses)
        a, b = se2.compose(a, half), se2.compose(b, se2.inverse(half))
        return mechanism.energy(poses), SPRING(se2.between(a, b))

    assert_close(*at_each(random_poses(0), energies), digits=12)


def test_exchange_of_the_bodies_changes_nothing():
    """With frames that are exchanged, the energy is that of the inverse displacement."""

    class Even(tj.AbstractEnergy):
        def stored_energy(self, displacement):
            angle, along, across = displacement.twist()
            return angle**2 + 3 * along**2 + 2 * across**2 + angle * across**3

    inverse = jax.jit(se2.inverse)(MISFIT)
    forward, backward = pair(energy=Even()), pair(inverse, Even(), first="b")

    def both(poses):
        energies = forward.energy(poses), backward.energy(poses)
        return *energies, forward.wrenches(poses), backward.wrenches(poses)

    before, after, *wrenches = at_each(random_poses(2), both)
    assert_close(before, after, digits=12)
    assert_close(*wrenches, digits=12)


def test_forces_and_stiffness_are_derivatives_of_the_energy():
    mechanism = pair()

    def both(poses):
        gradient = jax.grad(mechanism.energy)
        derivatives = -gradient(poses), jax.jacfwd(gradient)(poses)
        return mechanism.wrenches(poses), mechanism.stiffness(poses), *derivatives

    forces, stiffness, gradient, hessian = at_each(random_poses(4), both)
    assert_close(forces, gradient, digits=11)
    assert_close(stiffness, hessian, digits=11)


@pytest.mark.parametrize("coordinates", mostly_slow(["twistor", "twist"]))
def test_tangent_in_motion_is_the_derivative_of_the_forces(coordinates):
    damping = tj.energies.ViscousDamping(some_stiffness(5), coordinates)
    assembly = pair(damping=damping).hinge_assembly
    dofs = tuple(range(6))

    def forces(displacements, rates):
        return assembly.forces_in_motion(displacements, rates)[0]

    @jax.jit
    @jax.vmap
    def both(displacements, rates):
        tangent = assembly.tangent_in_motion(displacements, rates, dofs)
        derivatives = jax.jacfwd(forces, argnums=(0, 1))(displacements, rates)
        return (tangent.stiffness, tangent.damping), derivatives

    computed = both(0.4 * (random_poses(0) - REFERENCE), random_poses(5))
    tangents, derivatives = jax.tree.map(np.asarray, computed)
    for matrices, expected in zip(tangents, derivatives, strict=True):
        for matrix, derivative in zip(matrices, expected.reshape(-1, 6, 6), strict=True):
            scale = np.max(np.abs(derivative))
            assert_close(matrix / scale, derivative / scale, digits=11)


def test_viscous_forces_are_those_of_the_rate_of_the_strain():
    """The dissipated power of a pure rate equals damping times its square."""
    mechanism = pair(
        damping=tj.energies.ViscousDamping(np.diag([2.0, 0.0, 0.0]), "twistor")
    )
    rates = np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.0]])
    forces_in_motion = mechanism.hinge_assembly.forces_in_motion
    _, _, (power, _) = jax.jit(lambda *state: forces_in_motion(*state))(0 * rates, rates)
    cos = np.cos(0.3 / 2)  # rate of 2 sin((angle - misfit) / 2)
    assert_close(power, 2.0 * (0.7 * cos) ** 2)


@jax.jit
def displacement_and_wrench(mechanism, found):
    return mechanism.displacement_of("h", found), mechanism.wrench_of("h", found)


def test_a_free_body_moves_until_its_hinge_is_not_loaded():
    mechanism = pair()
    found = tj.equilibrium(mechanism)
    displacement, wrench = displacement_and_wrench(mechanism, found)
    assert_close(displacement, MISFIT, digits=10)
    assert_close(mechanism.misfit_of("h"), MISFIT, digits=14)
    np.testing.assert_allclose(wrench, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.reactions, 0.0, atol=1e-12)


def test_wrench_is_about_frame_b():
    """It balances the wrench of the hinge on body B."""
    mechanism = pair()

    def both(poses):
        _, frame = mechanism.ports("h", poses)
        on_body = -se2.transform_wrench(frame, mechanism.wrench_of("h", poses))
        moment, x, y = mechanism.wrenches(poses)[1]
        moment = moment + poses[1, 1] * y - poses[1, 2] * x
        return on_body, jnp.stack([moment, x, y])

    assert_close(*at_each(random_poses(6), both), digits=11)


def preloaded_column(gap):
    """Return a block between two springs along x, one of which is too long."""
    first, second = (
        tj.Quadratic(np.diag([1.0, 300.0, 50.0])),
        tj.Quadratic(np.diag([1.0, 100.0, 50.0])),
    )
    bodies = [
        tj.Body("left"),
        tj.Body("block", (0, 1.0, 0)),
        tj.Body("right", (0, 2.0, 0)),
    ]
    hinges = [
        tj.Hinge("one", "left", "block", first, (0.0, 0.5, 0.0), misfit=(0.0, gap, 0.0)),
        tj.Hinge("two", "block", "right", second, (0.0, 1.5, 0.0)),
    ]
    return tj.Mechanism(bodies, hinges, fixed=["left", "right"])


def test_preload_of_two_springs():
    """Two springs in series share the misfit in proportion to their compliances."""

    def solve(gap):
        mechanism = preloaded_column(gap)
        found = tj.equilibrium(mechanism, throw=False)
        wrenches = [mechanism.wrench_of(name, found)[1] for name in ("one", "two")]
        return found.displacement("block")[1], jnp.stack(wrenches)

    gap = 1e-3
    differentiate = jax.jit(jax.value_and_grad(solve, has_aux=True))
    (displacement, forces), slope = differentiate(gap)
    force = gap / (1 / 300.0 + 1 / 100.0)
    assert_close(displacement, force / 100.0, digits=12)
    assert_close(forces, np.full(2, -force), digits=12)
    assert_close(slope, 1 / 100.0 / (1 / 300.0 + 1 / 100.0), digits=12)


def test_ports_that_do_not_coincide_are_bent_together():
    """The hinge of a free body is not loaded where its ports coincide."""
    bodies = [tj.Body("a", REFERENCE[0]), tj.Body("b", REFERENCE[1])]
    ports = (0.2, 0.5, 0.1), (-0.4, 0.1, -0.3)
    with pytest.raises(ValueError, match=r'do not coincide.*`misfit="ports"`'):
        tj.Mechanism(bodies, [tj.Hinge("h", "a", "b", SPRING, ports=ports)], fixed=["a"])
    hinge = tj.Hinge("h", "a", "b", SPRING, ports=ports, misfit="ports")
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["a"])
    poses = tj.equilibrium(mechanism).poses

    @jax.jit
    def both(poses):
        a, b = jax.vmap(se2.compose)(poses, np.array(ports))
        return a, b, mechanism.energy(poses), SPRING(se2.between(a, b))

    a, b, *_ = both(poses)
    assert_close(a, b, digits=10)
    _, _, *energies = both(random_poses(8)[0])
    assert_close(*energies, digits=12)


TOPOLOGIES = {
    "chain": [(0, 1), (1, 2), (2, 3)],
    "ring": [(0, 1), (1, 2), (2, 3), (3, 0)],
    "parallel": [(0, 1), (0, 1), (1, 2), (1, 2)],
    "grid": [(0, 1), (1, 3), (0, 2), (2, 3), (1, 2)],
}


def random_mechanism(topology, seed):
    """Return the pieces of a random mechanism: bodies, connections, and numbers."""
    random = np.random.default_rng(seed)
    pairs = TOPOLOGIES[topology]
    poses = random.normal(size=(4, 3)) * [1.0, 0.5, 0.5]
    at = random.normal(size=(len(pairs), 3)) * [1.0, 0.5, 0.5]
    matrices = random.normal(size=(len(pairs), 3, 3))
    matrices = matrices @ np.swapaxes(matrices, 1, 2) + 2 * np.eye(3)
    misfits = random.uniform(-0.3, 0.3, size=(len(pairs), 3))
    return pairs, poses, at, matrices, misfits


def assemble(pairs, poses, at, matrices, misfits):
    """Return the mechanism of these pieces, the first body of which is fixed."""
    hinges = []
    for k, (first, second) in enumerate(pairs):
        energy = tj.Quadratic(matrices[k], "twist")
        hinge = tj.Hinge(
            str(k), str(first), str(second), energy, at[k], misfit=misfits[k]
        )
        hinges.append(hinge)
    used = sorted({body for ends in pairs for body in ends})
    bodies = [tj.Body(str(body), poses[body]) for body in used]
    return tj.Mechanism(bodies, hinges, fixed=["0"])


def residuals_by_matrices(displacements, pairs, poses, at, matrices, misfits):
    """Return numbers the sum of whose squares is twice the energy.

    The frames are composed as homogeneous matrices.
    """

    def matrix(pose):
        c, s = np.cos(pose[0]), np.sin(pose[0])
        return np.array([[c, -s, pose[1]], [s, c, pose[2]], [0.0, 0.0, 1.0]])

    def logarithm(transform):
        angle = np.arctan2(transform[1, 0], transform[0, 0])
        half = angle / 2
        ratio = half / np.tan(half) if half else 1.0
        x, y = transform[:2, 2]
        return np.array([angle, ratio * x + half * y, ratio * y - half * x])

    def exponential(twist):
        angle, x, y = twist
        a, b = np.sin(angle) / angle, (1 - np.cos(angle)) / angle
        return matrix([angle, a * x - b * y, b * x + a * y])

    moved = poses + displacements
    residuals = []
    for k, ends in enumerate(pairs):
        half = exponential(logarithm(matrix(misfits[k])) / 2)
        a, b = (
            matrix(moved[body]) @ np.linalg.solve(matrix(poses[body]), matrix(at[k]))
            for body in ends
        )
        relative = np.linalg.solve(a @ half, b @ np.linalg.inv(half))
        residuals.append(np.linalg.cholesky(matrices[k]).T @ logarithm(relative))
    return np.concatenate(residuals)


@pytest.mark.parametrize("topology", mostly_slow(TOPOLOGIES))
def test_assembled_mechanisms_have_the_smallest_energy(topology):
    """SciPy minimizes the energy of frames that are composed as matrices."""
    solve = jax.jit(
        lambda pieces: tj.equilibrium(
            assemble(TOPOLOGIES[topology], *pieces), throw=False
        )
    )
    for seed in range(25):
        pairs, *pieces = random_mechanism(topology, seed)
        found = solve(pieces)
        assert bool(found.succeeded)
        bodies = len(found.names)

        def residuals(free, bodies=bodies, pieces=pieces, pairs=pairs):
            displacements = np.zeros((4, 3))
            displacements[1:bodies] = free.reshape(-1, 3)
            return residuals_by_matrices(displacements, pairs, *pieces)

        start = np.asarray(found.displacements)[1:].reshape(-1)
        best = scipy.optimize.least_squares(
            residuals, start + 1e-3, jac="3-point", ftol=1e-15, xtol=1e-15, gtol=1e-15
        )
        assert_close(found.energy, best.cost, digits=10)
        np.testing.assert_allclose(start, best.x, atol=1e-7)


@pytest.mark.parametrize(
    "topology",
    [
        pytest.param(
            name, marks=pytest.mark.slow if name == "chain" else pytest.mark.release
        )
        for name in TOPOLOGIES
    ],
)
def test_derivatives_by_the_misfits_agree_with_differences(topology):
    pairs, poses, at, matrices, misfits = random_mechanism(topology, 7)

    def displacements(misfits):
        mechanism = assemble(pairs, poses, at, matrices, misfits)
        return tj.equilibrium(mechanism, throw=False).displacements

    direction, step = np.random.default_rng(1).normal(size=misfits.shape), 1e-5

    @jax.jit
    def with_rate(misfits):
        return jax.jvp(displacements, (misfits,), (direction,))

    rate = np.asarray(with_rate(misfits)[1])
    after, before = (
        np.asarray(with_rate(misfits + side * step * direction)[0]) for side in (1, -1)
    )
    difference = (after - before) / (2 * step)
    scale = np.max(np.abs(rate))
    assert_close(rate / scale, difference / scale, digits=7)


def test_vibrations_of_a_preloaded_mechanism_need_its_equilibrium():
    bodies = [tj.Body("wall"), tj.Body("mass", mass=2.0, inertia=0.5)]
    hinge = tj.Hinge(
        "h", "wall", "mass", tj.Quadratic(np.diag([2.0, 50.0, 8.0])), (0, 0, 0),
        misfit=(0.0, 0.1, 0.0),
    )  # fmt: skip
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    with pytest.raises(ValueError, match=r"has misfits.*`about=equilibrium"):
        tj.vibrations(mechanism)
    with pytest.raises(ValueError, match=r"has misfits.*`about=equilibrium"):
        tj.linearize(mechanism)
    found = tj.vibrations(mechanism, about=tj.equilibrium(mechanism))
    # The spring acts halfway between the two frames, 0.05 m from the center of mass.
    arm = -0.05
    stiffness = np.diag([2.0 + 8.0 * arm**2, 50.0, 8.0])
    stiffness[0, 2] = stiffness[2, 0] = 8.0 * arm
    squares = np.linalg.eigvals(stiffness / np.array([[0.5], [2.0], [2.0]]))
    assert_close(found.frequencies, np.sqrt(np.sort(squares)) / (2 * np.pi))


@pytest.mark.slow
def test_a_motion_that_starts_in_the_reference_configuration_oscillates():
    """The block swings about the position in which its spring is not loaded."""
    bodies = [tj.Body("wall"), tj.Body("mass", mass=2.0, inertia=0.5)]
    spring = tj.Quadratic(np.diag([2.0, 50.0, 8.0]))
    hinge = tj.Hinge("h", "wall", "mass", spring, (0, 0, 0), misfit=(0.0, 0.1, 0.0))
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    period = 2 * np.pi / np.sqrt(50.0 / 2.0)
    motion = tj.simulate(mechanism, [0.0, period / 2, period], tolerance=1e-9)
    np.testing.assert_allclose(
        motion.displacement("mass")[:, 1], [0.0, 0.2, 0.0], atol=1e-7
    )
    still = tj.simulate(mechanism, [0.0, 1.0], start=tj.equilibrium(mechanism))
    np.testing.assert_allclose(still.displacement("mass")[-1], [0, 0.1, 0], atol=1e-12)


def test_misfits_are_saved_and_files_without_them_are_read(tmp_path):
    file = tmp_path / "pair.json"
    mechanism = pair()
    tj.io.save_mechanism(mechanism, file)
    loaded = tj.io.load_mechanism(file)
    assert_close(loaded.misfit_of("h"), MISFIT, digits=15)
    poses = random_poses(9)[0]
    energy = jax.jit(lambda mechanism: mechanism.energy(jnp.asarray(poses)))
    assert_close(energy(loaded), energy(mechanism), digits=14)
    tj.io.save_mechanism(pair(None), file)
    text = file.read_text()
    older = text.replace('"twistorjax": 6', '"twistorjax": 2')
    assert older != text
    for line in ('"misfit": null', '"misfit":null'):
        older = older.replace(f",{line}", "").replace(f", {line}", "")
    file.write_text(older)
    assert tj.io.load_mechanism(file).misfit_of("h") is None


def loaded_beyond_its_range():
    """A surrogate between two walls, with a misfit."""
    energy = tj.energies.WithValidityRange(
        SPRING, rotation=0.1, force=1e6, error=[0.0, 0.0, 0.0]
    )
    bodies = [tj.Body("a"), tj.Body("b")]
    hinge = tj.Hinge("h", "a", "b", energy, (0, 0, 0), misfit=(0.3, 0.0, 0.0))
    return tj.Mechanism(bodies, [hinge], fixed=["a", "b"])


def test_a_misfit_beyond_the_range_of_a_surrogate_has_a_result():
    solution = tj.equilibrium(loaded_beyond_its_range(), throw=False)
    assert str(tj.result_names(solution.result)) == "out_of_range"


@pytest.mark.slow
def test_a_misfit_beyond_the_range_of_a_surrogate_is_reported():
    with pytest.raises(RuntimeError, match=r"'h': its rotation is -0\.3 rad"):
        tj.equilibrium(loaded_beyond_its_range())


@pytest.mark.parametrize(
    ("misfit", "message"),
    [
        ((0.1, 0.2), r"`misfit` of the hinge 'h' has shape \(2,\)"),
        ((0.0, np.nan, 0.0), "`misfit` of the hinge 'h' .* must be finite"),
        ("ports", r"`misfit` of the hinge 'h' is 'ports', but .* if `ports` are given"),
    ],
)
def test_invalid_misfits_are_reported(misfit, message):
    with pytest.raises(ValueError, match=message):
        tj.Hinge("h", "a", "b", SPRING, AT, misfit=misfit)


def test_a_hinge_without_misfit_has_no_arrays_of_misfits():
    """Programs of mechanisms without misfits do not compute them."""
    fields = {field.name for field in dataclasses.fields(pair().hinge_assembly)}
    assert "misfits" in fields
    assert pair(None).hinge_assembly.misfits is None


def guide(misfit, make=tj.flexures.leaf):
    """A table on two leaves along y, of which the left one has a misfit."""
    leaf = make(STEEL, length=0.05, thickness=0.5e-3, width=10e-3)
    hinges = [
        tj.Hinge(name, "base", "table", leaf, (np.pi / 2, x, 0.025), misfit=given)
        for name, x, given in (("left", -0.02, misfit), ("right", 0.02, np.zeros(3)))
    ]
    bodies = [tj.Body("base"), tj.Body("table", (0.0, 0.0, 0.05))]
    return tj.Mechanism(bodies, hinges, fixed=["base"])


LEAVES = [tj.flexures.leaf, tj.flexures.linear_leaf]


@pytest.mark.parametrize("make", mostly_slow(LEAVES))
@pytest.mark.parametrize("misfit", [1e-4, 2e-3])
def test_a_leaf_that_is_too_long_needs_few_steps(make, misfit):
    """It tilts the table of a guide; the force of a stiff leaf is large at first."""
    found = tj.equilibrium(guide((0.0, misfit, 0.0), make))
    assert int(found.steps) <= 5
    # The axial strain is negligible, so the table rises and tilts without strain.
    angle = np.asarray(found.displacement("table"))[0]
    np.testing.assert_allclose(angle, -misfit / 0.04, rtol=2e-3)


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_leaves_of_different_shapes_share_their_misfit(share):
    """Both bend by half of a transverse misfit, and are shortened alike."""
    length = 0.05
    misfit = share * length
    found = tj.equilibrium(guide((0.0, 0.0, misfit)))
    shortening = 0.6 * (misfit / 2) ** 2 / length
    expected = [0.0, -misfit / 2, -shortening]
    np.testing.assert_allclose(
        found.displacement("table"), expected, rtol=1e-3, atol=1e-12
    )
    assert int(found.steps) <= 5


@pytest.mark.slow
@pytest.mark.parametrize("misfit", [(0.1, 0.0, 0.0), (0.7, 0.0, 0.0), (0.3, 1e-3, 5e-3)])
def test_a_leaf_that_nothing_loads_is_displaced_by_its_misfit(misfit):
    leaf = tj.flexures.leaf(STEEL, length=0.05, thickness=0.5e-3, width=10e-3)
    hinge = tj.Hinge("h", "a", "b", leaf, (0.0, 0.03, 0.0), misfit=misfit)
    bodies = [tj.Body("a"), tj.Body("b", (0.0, 0.06, 0.0))]
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["a"])
    found = tj.equilibrium(mechanism)
    assert int(found.steps) <= 15
    displacement, _ = displacement_and_wrench(mechanism, found)
    np.testing.assert_allclose(displacement, misfit, atol=1e-9)


@pytest.mark.parametrize("direction", [0.1, 0.5, 1.2])
@pytest.mark.parametrize("short", [1e-6, 1e-4])
def test_a_stage_on_four_short_leaves_does_not_move(direction, short):
    """Their tensions balance, so all displacements are rounding errors."""
    length, thickness, width = 0.05, 0.5e-3, 10e-3
    leaf = tj.flexures.leaf(STEEL, length=length, thickness=thickness, width=width)
    angles = direction + np.pi / 2 * np.arange(-2, 2)
    hinges = [
        tj.Hinge(
            "hijk"[k],
            "base",
            "stage",
            leaf,
            (angle, 0.04 * np.cos(angle), 0.04 * np.sin(angle)),
            misfit=(0.0, -short, 0.0),
        )
        for k, angle in enumerate(angles)
    ]
    mechanism = tj.Mechanism([tj.Body("base"), tj.Body("stage")], hinges, fixed=["base"])
    found = tj.equilibrium(mechanism)
    assert_close(found.displacements, np.zeros((2, 3)))
    tension = 210e9 * thickness * width * short / length
    _, wrench = displacement_and_wrench(mechanism, found)
    np.testing.assert_allclose(np.asarray(wrench)[1], tension, rtol=1e-9)
