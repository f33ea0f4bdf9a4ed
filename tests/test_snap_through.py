"""Equilibria of arches and frames that buckle or snap, against paths in small steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import twistorjax as tj
from twistorjax.geometry import se2


def shallow_arch():
    """Return two stiff bars on soft hinges, with a rise of a tenth of their length."""
    soft = tj.Quadratic(np.diag([0.05, 8e3, 8e3]), "twist")
    bodies = [
        tj.Body("wall"),
        tj.Body("left", (0, -0.5, 0.05)),
        tj.Body("right", (0, 0.5, 0.05)),
    ]
    hinges = [
        tj.Hinge("1", "wall", "left", soft, (0, -1, 0)),
        tj.Hinge("2", "left", "right", soft, (0, 0, 0.1)),
        tj.Hinge("3", "right", "wall", soft, (0, 1, 0)),
    ]
    return tj.Mechanism(bodies, hinges, fixed=["wall"])


def test_loads_above_the_limit_load_of_an_arch_have_no_equilibrium():
    """The limit load is the largest reaction to a prescribed downward displacement."""
    arch = shallow_arch()

    def reaction(apex):
        # The middle of a bar moves by half the displacement of the apex.
        drive = tj.Drive("right", y=-apex / 2)
        found = tj.equilibrium(arch, drives=[drive], throw=False)
        return -found.reaction("right")[2]

    reactions = np.asarray(jax.jit(jax.vmap(reaction))(np.linspace(0.001, 0.1, 100)))
    largest = reactions[: np.argmax(np.diff(reactions) < 0) + 1].max()
    limit = largest / 2  # of a load at the apex

    def solve(force):
        load = tj.Load("right", force=(0, -force), at=(-0.5, 0.05))
        return tj.equilibrium(arch, loads=[load], throw=False)

    forces = np.array([0.5 * limit, 0.99 * limit, 1.01 * limit, 3.0, 20.0, 40.0, 100.0])
    solutions = jax.jit(jax.vmap(solve))(forces)
    assert solutions.succeeded.tolist() == [True, True, *5 * [False]]
    names = tj.result_names(solutions.result)
    assert names is not None and set(names[2:]) == {"no_equilibrium"}
    reached = np.asarray(solutions.fraction) * forces
    np.testing.assert_allclose(reached[2:], limit, rtol=2e-3)


@pytest.mark.release
def test_no_load_lets_a_truss_jump_to_its_other_side():
    """This includes loads whose first Newton step happens to lead to the other side."""
    soft = tj.Quadratic(jnp.diag(jnp.array([1e-3, 1e5, 1e5])))
    foot, top = (0.2, 0.0), (0.0, 0.02)
    hinges = [
        tj.Hinge("1", "wall", "left", soft, (0, -foot[0], 0)),
        tj.Hinge("2", "left", "apex", soft, (0, *top)),
        tj.Hinge("3", "right", "apex", soft, (0, *top)),
        tj.Hinge("4", "wall", "right", soft, (0, *foot)),
    ]
    bodies = [
        tj.Body("wall"),
        tj.Body("left", (0, -0.2, 0)),
        tj.Body("right", (0, 0.2, 0)),
        tj.Body("apex", (0, 0, 0.02)),
    ]
    fixed = {"wall": ("angle", "x", "y"), "apex": ("angle",)}
    truss = tj.Mechanism(bodies, hinges, fixed)

    def solve(force):
        load = tj.Load("apex", force=(0.0, -force))
        return tj.equilibrium(truss, loads=[load], throw=False)

    limit = 3.8307
    solutions = jax.vmap(solve)(limit * jnp.geomspace(0.5, 1e3, 2000))
    found = np.asarray(solutions.succeeded)
    apex = np.asarray(solutions.displacement("apex"))[:, 2]
    assert np.all(apex[found] > -0.02)
    assert 150 < found.sum() < 200  # those below the limit load


def row_of_bars(count, coordinates, frame):
    """Return a function that builds bars in a row between two supports from a design.

    Args:
        count: Number of bars.
        coordinates: Coordinates of the hinge energies.
        frame: Whether the last support has a different spring; otherwise it is like the
            other hinges.
    """
    names = [f"bar {k}" for k in range(count)]

    def build(design):
        points, angles = design["points"], design["angles"]
        spring = tj.Quadratic(jnp.diag(design["stiffness"]), coordinates)
        support_stiffness = design["stiffness"] * design["support"]
        support = tj.Quadratic(jnp.diag(support_stiffness), coordinates)
        middles = (points[:-1] + points[1:]) / 2
        bodies = [tj.Body("wall")] + [
            tj.Body(name, (0.0, x, y))
            for name, (x, y) in zip(names, middles, strict=True)
        ]
        energies = [spring] * count + [support if frame else spring]
        ends = list(zip(["wall", *names], [*names, "wall"], strict=True))
        hinges = [
            tj.Hinge(str(k), *ends[k], energies[k], (angles[k], *points[k]))
            for k in range(count + 1)
        ]
        load = tj.Load(names[count // 2], design["wrench"], at=(design["at"], 0.0))
        return tj.Mechanism(bodies, hinges, fixed=["wall"]), load

    return build


def random_design(rng, count, frame):
    """Draw an arch, or a frame, whose bars are steeper."""
    rise = rng.uniform(0.05, 0.8) if frame else rng.uniform(0.01, 0.25)
    x = np.linspace(-1, 1, count + 1)
    y = rise * (1 - x**2) + rng.normal(0, 0.1 * rise, count + 1)
    y[[0, -1]] = 0, rng.uniform(-0.3, 0.3) if frame else 0
    stiffness = 10 ** np.array(
        [rng.uniform(-3, 0), rng.uniform(2.5, 5), rng.uniform(2.5, 5)]
    )
    direction = [0.1 * rng.normal(), 0.3 * rng.normal(), -1.0]
    size = 20 * stiffness[0] * 10 ** rng.uniform(-2, 2.5)
    return {
        "points": np.stack([x, y], 1),
        "stiffness": stiffness,
        "angles": rng.uniform(-0.3, 0.3, count + 1),
        "support": np.array([rng.uniform(0, 1), *10 ** rng.uniform(-3, 0, 2)]),
        "wrench": size * np.array(direction),
        "at": rng.uniform(-0.2, 0.2),
    }


def path_in_small_steps(mechanism, load, rise):
    """Follow the equilibrium in load increments that move no body by 3 % of the rise.

    Forces and stiffnesses are derivatives of the energy of the mechanism.

    Returns:
        The displacements at the end of the stable path, and the fraction of the load
        there.
    """
    free = np.arange(3, mechanism.reference.size)
    body = mechanism.index(load.body)

    def potential(unknowns, fraction):
        displacements = jnp.zeros(mechanism.reference.size).at[free].set(unknowns)
        displacements = displacements.reshape(-1, 3)
        rotation, translation = displacements[body, 0], displacements[body, 1:]
        angle = mechanism.reference[body, 0] + rotation
        arm = se2.rotate(angle, load.at)
        work = load.wrench[0] * rotation + load.wrench[1:] @ (translation + arm)
        return mechanism.energy(mechanism.reference + displacements) - fraction * work

    gradient, hessian = jax.grad(potential), jax.hessian(potential)

    def advance(state):
        start, fraction, increment, count = state
        goal = jnp.minimum(fraction + increment, 1.0)

        def newton_step(_, unknowns):
            matrix = hessian(unknowns, goal)
            return unknowns - jnp.linalg.solve(matrix, gradient(unknowns, goal))

        end = jax.lax.fori_loop(0, 5, newton_step, start)
        matrix = hessian(end, goal)
        size = jnp.sqrt(jnp.abs(jnp.diagonal(matrix)))
        triangle = jnp.linalg.cholesky(matrix / (size[:, None] * size[None]))
        error = jnp.max(jnp.abs(jnp.linalg.solve(matrix, gradient(end, goal))))
        distance = jnp.max(jnp.abs(end - start)) / (0.03 * rise)
        stable = jnp.all(jnp.isfinite(triangle))
        accepted = stable & (error < 1e-8) & (distance < 1)
        factor = jnp.where(accepted, jnp.where(distance < 0.7, 1.5, 1.0), 0.5)
        return (
            jnp.where(accepted, end, start),
            jnp.where(accepted, goal, fraction),
            factor * increment,
            count + 1,
        )

    def unfinished(state):
        _, fraction, increment, count = state
        smallest = 1e-9 * jnp.maximum(fraction, 1e-4)
        return (fraction < 1) & (increment > smallest) & (count < 20_000)

    zero = jnp.zeros(())
    state = jnp.zeros(free.size), zero, zero + 1e-6, jnp.zeros((), int)
    unknowns, fraction, _, _ = jax.lax.while_loop(unfinished, advance, state)
    return unknowns.reshape(-1, 3), fraction


def count_errors(seed, count, coordinates, frame, designs):
    """Compare equilibria of random designs with paths in small steps.

    Returns:
        The number of equilibria to which the path does not lead, the number of equilibria
        that were not found, and the number that were found.
    """
    build = row_of_bars(count, coordinates, frame)
    rng = np.random.default_rng(seed)
    drawn = [random_design(rng, count, frame) for _ in range(designs)]
    design = jax.tree.map(lambda *rows: jnp.array(np.stack(rows), float), *drawn)

    def solve(design):
        mechanism, load = build(design)
        solution = tj.equilibrium(mechanism, loads=[load], throw=False)
        rise = jnp.max(jnp.abs(design["points"][:, 1]))
        expected, fraction = path_in_small_steps(mechanism, load, rise)
        difference = jnp.max(jnp.abs(solution.displacements[1:] - expected))
        return solution.succeeded, fraction, difference

    found, fraction, difference = map(np.asarray, jax.jit(jax.vmap(solve))(design))
    # Near the limit load, within one part in a thousand, both results are accepted.
    other_branch = (fraction < 0.999) | ((fraction >= 1) & (difference > 1e-6))
    wrong, missed = found & other_branch, ~found & (fraction >= 1)
    return int(np.sum(wrong)), int(np.sum(missed)), int(np.sum(found))


@pytest.mark.release
def test_equilibria_of_random_arches_are_connected_to_the_reference():
    wrong, missed, found = count_errors(1, 2, "twistor", False, 40)
    assert (wrong, missed) == (0, 0)
    assert 20 < found < 35  # some designs have an equilibrium, and some have none


@pytest.mark.release
@pytest.mark.parametrize("frame", [False, True], ids=["arch", "frame"])
@pytest.mark.parametrize("coordinates", ["twist", "twistor"])
@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_equilibria_of_a_thousand_designs_are_connected_to_the_reference(
    count, coordinates, frame
):
    wrong, missed, _ = count_errors(count, count, coordinates, frame, 63)
    assert wrong == 0
    assert missed <= 1


class TestStiffBarOnSoftSprings:
    """A stiff, flat bar between two soft springs, moved through a third one; N, m."""

    STIFFNESS, SPAN, RISE, SIDE, BACK, PULL = 2e4, 3000.0, 28.0, 1.4, 0.27, 1.05

    def mechanism(self):
        length = float(np.hypot(self.SPAN, self.RISE))
        bodies = [
            tj.Body("ground"),
            tj.Body("node"),
            tj.Body("apex", (0.0, self.SPAN, self.RISE)),
            tj.Body("load", (0.0, -100.0, 0.0)),
        ]

        def spring(x, y):
            return tj.Quadratic(np.diag([0.0, x, y]))

        bar = tj.energies.AxialSpring(self.STIFFNESS, length=length)
        slope, apex = np.arctan2(self.RISE, self.SPAN), (self.SPAN, self.RISE)
        hinges = [
            tj.Hinge("bar", "node", "apex", bar, (slope, self.SPAN / 2, self.RISE / 2)),
            tj.Hinge("side", "ground", "apex", spring(0.0, self.SIDE), (0.0, *apex)),
            tj.Hinge("back", "ground", "node", spring(self.BACK, 0.0), (0.0, 0.0, 0.0)),
            tj.Hinge("pull", "load", "node", spring(self.PULL, 0.0), (0.0, 0.0, 0.0)),
        ]
        fixed = {
            "ground": ["angle", "x", "y"],
            "node": ["angle", "y"],
            "apex": ["angle", "x"],
            "load": ["angle", "y"],
        }
        return tj.Mechanism(bodies, hinges, fixed=fixed)

    def node_and_load(self, up):
        """Displacements of the node and the load if the apex moves up."""
        height, length = self.RISE + up, np.hypot(self.SPAN, self.RISE)
        stretched = scipy.optimize.brentq(
            lambda size: (
                self.STIFFNESS * (length / size - 1) * height - self.SIDE * up
            ),
            0.5 * length, length, xtol=1e-12,
        )  # fmt: skip
        along = np.sqrt(stretched**2 - height**2)
        force = self.STIFFNESS * (length - stretched) * along / stretched
        node = self.SPAN - along
        return node, node + (force + self.BACK * node) / self.PULL

    @pytest.mark.slow
    @pytest.mark.filterwarnings("ignore:`x` of the drive")  # without units
    def test_an_equilibrium_just_before_the_fold_and_none_behind_it(self):
        fold = scipy.optimize.minimize_scalar(
            lambda up: -self.node_and_load(up)[1], bounds=(100.0, 2500.0),
            method="bounded", options={"xatol": 1e-9},
        )  # fmt: skip
        largest = -fold.fun
        target = 0.995 * largest
        up = scipy.optimize.brentq(
            lambda up: self.node_and_load(up)[1] - target, 100.0, fold.x, xtol=1e-12
        )
        stiff = self.mechanism()
        found = tj.equilibrium(stiff, drives=[tj.Drive("load", x=target)])
        np.testing.assert_allclose(found.displacement("apex")[2], up, rtol=1e-7)
        assert int(found.steps) < 100
        message = r"limit point at the fraction 0\.95238"  # 1 / 1.05
        for steps in (60, 400):  # too few steps, and enough
            with pytest.raises(RuntimeError, match=message) as error:
                drive = tj.Drive("load", x=1.05 * largest)
                tj.equilibrium(stiff, drives=[drive], max_steps=steps)
            assert str(error.value).startswith("No equilibrium at the full loads")


def test_a_truss_moves_in_proportion_to_a_tiny_load():
    """The stiffness is that of a truss of two bars, without prestress."""
    length, rise, stiffness = np.hypot(1.0, 0.3), 0.3, 1000.0
    bar = tj.energies.AxialSpring(stiffness, length=length)
    feet, angle = (-0.5, 0.5), np.arctan2(rise, 1.0)
    hinges = [
        tj.Hinge(name, *bodies, bar, at=(turn, x, rise / 2))
        for name, bodies, turn, x in (
            ("left", ("wall", "apex"), angle, feet[0]),
            ("right", ("apex", "wall"), -angle, feet[1]),
        )
    ]
    bodies = [tj.Body("wall"), tj.Body("apex", pose=(0.0, 0.0, rise))]
    fixed = {"wall": ["angle", "x", "y"], "apex": ["angle"]}
    truss = tj.Mechanism(bodies, hinges, fixed=fixed)
    for force in (1e-8, 1e-20):
        loads = [tj.Load("apex", force=(0.0, -force))]
        sinking = -tj.equilibrium(truss, loads=loads).displacement("apex")[2]
        linear = force / (2 * stiffness * (rise / length) ** 2)
        assert float(sinking) == pytest.approx(linear, rel=1e-9)
