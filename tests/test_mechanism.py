"""What a mechanism is made of, and what it refuses."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, some_stiffness

import twistorjax as tj


SPRING = tj.Quadratic(some_stiffness(1))


class Even(tj.AbstractEnergy):
    """Another kind of energy, with a parameter."""

    factor: jax.Array

    def stored_energy(self, displacement):
        return self.factor * displacement.x1**2


def hinge(name, first, second, energy=SPRING, at=(0.0, 0.0, 0.0)):
    return tj.Hinge(name, first, second, energy, at)


def bodies(*names):
    return [tj.Body(name) for name in names]


def test_hinges_of_every_kind_add_up():
    """Three kinds of energy, one of them twice, in an order that stacking must mend."""
    kinds = [Even(jnp.array(2.0)), SPRING, Even(jnp.array(3.0)), SPRING + SPRING]
    places = [(0.1, 0.2, 0.3), (0.4, -0.2, 0.1), (-0.6, 0.0, 0.5), (0.0, 0.3, 0.0)]
    pairs = [("a", "b"), ("b", "c"), ("c", "a"), ("b", "a")]
    names = bodies("a", "b", "c")
    single = [
        tj.Mechanism(names, [hinge("h", *pair, kind, at)], fixed=["a", "b", "c"])
        for pair, kind, at in zip(pairs, kinds, places, strict=True)
    ]
    together = tj.Mechanism(
        names,
        [
            hinge(str(k), *pair, kind, at)
            for k, (pair, kind, at) in enumerate(zip(pairs, kinds, places, strict=True))
        ],
        fixed=["a"],
    )
    poses = jax.random.normal(jax.random.key(0), (3, 3))
    for quantity in ("energy", "wrenches", "stiffness"):
        parts = [getattr(mechanism, quantity)(poses) for mechanism in single]
        assert_close(getattr(together, quantity)(poses), sum(parts))


def test_ports_and_place_say_the_same():
    solution = jnp.array([[0.4, 0.1, -0.2], [-0.7, 0.5, 0.3]])
    at = jnp.array([0.9, 0.3, 0.2])
    ports = [tj.geometry.se2.between(pose, at) for pose in solution]
    names = [tj.Body("a", solution[0]), tj.Body("b", solution[1])]
    by_place = tj.Mechanism(names, [tj.Hinge("h", "a", "b", SPRING, at)], fixed=["a"])
    by_ports = tj.Mechanism(
        names, [tj.Hinge("h", "a", "b", SPRING, ports=ports)], fixed=["a"]
    )
    poses = jax.random.normal(jax.random.key(0), (2, 3))
    assert_close(by_ports.energy(poses), by_place.energy(poses))


def test_shared_energies_are_kept_once():
    shared = tj.Mechanism(bodies("a", "b"), [hinge(k, "a", "b") for k in "123"], ["a"])
    assert shared.hinge_assembly.groups[0].energy.stiffness.shape == (3, 3)
    apart = [hinge(k, "a", "b", tj.Quadratic(SPRING.stiffness)) for k in "12"]
    stacked = tj.Mechanism(bodies("a", "b"), apart, ["a"]).hinge_assembly.groups
    assert len(stacked) == 1


def test_tells_how_far_a_hinge_is_displaced():
    names = [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))]
    mechanism = tj.Mechanism(names, [hinge("h", "a", "b", at=(np.pi / 2, 0.5, 0.0))],
                             fixed=["a"])  # fmt: skip
    poses = jnp.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.2]])
    # the hinge's axis 1 points along y
    assert_close(mechanism.displacement_of("h", poses), [0.0, 0.2, 0.0])


def test_inertia_is_asked_of_moving_bodies_only():
    moving = tj.Body("b", mass=2.0, inertia=3.0)
    mechanism = tj.Mechanism([tj.Body("a"), moving], [hinge("h", "a", "b")], fixed=["a"])
    assert_close(mechanism.inertia(), [[np.inf] * 3, [3.0, 2.0, 2.0]])
    weightless = tj.Mechanism(bodies("a", "b"), [hinge("h", "a", "b")], fixed=["a"])
    with pytest.raises(ValueError, match="The body 'b' moves, but has no `mass`"):
        weightless.inertia()


def test_a_plate_has_the_inertia_of_its_shape():
    """A rectangle of 40 by 5 mm, away from the origin and turned: closed form."""
    corners = np.array([[-20, -2.5], [20, -2.5], [20, 2.5], [-20, 2.5]]) * 1e-3
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    steel = tj.Material(modulus=210e9, poisson=0.3, density=7800.0)
    for order in (corners, corners[::-1]):
        bar = tj.plate("bar", order @ turn.T + [0.3, 0.7], width=0.004, material=steel)
        mass = 7800 * 0.04 * 0.005 * 0.004
        assert_close(bar.mass, mass)
        assert_close(bar.inertia / (mass * (0.04**2 + 0.005**2) / 12), 1.0)
        assert_close(bar.pose, [0.0, 0.3, 0.7])
        assert_close(np.asarray(bar.outline).mean(axis=0), [0.0, 0.0])


def test_a_plate_does_not_feel_how_its_outline_is_told():
    """A right triangle with a needless corner: inertia b h (b^2 + h^2) / 36 an area."""
    base, height = 0.03, 0.02
    corners = np.array([[0, 0], [0.001, 0], [base, 0], [0, height]])
    steel = tj.Material(modulus=210e9, poisson=0.3, density=7800.0)
    plate = tj.plate("wedge", corners, width=0.004, material=steel)
    mass = 7800 * 0.004 * base * height / 2
    assert_close(plate.pose, [0.0, base / 3, height / 3])
    assert_close(plate.inertia / mass, (base**2 + height**2) / 18)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-15, 1e-12])
def test_wrenches_keep_the_digits_of_small_displacements(size):
    """A block 40 mm away that moves by less than its position has digits for."""
    energy = tj.Quadratic(jnp.diag(jnp.array([1.0, 300.0, 200.0])))
    hinge = tj.Hinge("h", "wall", "block", energy, at=(0.3, 40e-3, 30e-3))
    bodies = [tj.Body("wall"), tj.Body("block", (0.0, 40e-3, 30e-3))]
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    force = size * jnp.array([0.0, 250.0, -170.0])
    pushed = tj.equilibrium(mechanism, loads=[tj.Load("block", force)])
    wrench = mechanism.wrench_of("h", pushed)
    assert_close(
        wrench / size, [0.0, *(tj.geometry.se2.rotate(-0.3, force[1:]) / size)], digits=11
    )
    moved = pushed.displacement("block")
    across = mechanism.displacement_of("h", pushed)
    assert_close(
        across[1:] / size, tj.geometry.se2.rotate(-0.3, moved[1:]) / size, digits=11
    )


@pytest.mark.slow
def test_a_motion_has_a_wrench_at_each_time():
    energy = tj.Quadratic(jnp.diag(jnp.array([1.0, 300.0, 200.0])))
    hinge = tj.Hinge("h", "wall", "block", energy, at=(0.0, 0.0, 0.0))
    bodies = [tj.Body("wall"), tj.Body("block", mass=1.0, inertia=1.0)]
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    swing = tj.simulate(mechanism, [0.0, 0.1, 0.2], velocities={"block": (0, 1.0, 0)})
    wrenches = mechanism.wrench_of("h", swing)
    assert_close(wrenches[:, 1], 300.0 * swing.displacement("block")[:, 1])


@pytest.mark.slow
@pytest.mark.untyped
def test_an_equilibrium_is_a_state_wherever_poses_are():
    energy = tj.Quadratic(jnp.diag(jnp.array([1.0, 300.0, 200.0])))
    hinge = tj.Hinge("h", "wall", "block", energy, at=(0.0, 0.1, 0.0))
    mechanism = tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])
    load = tj.Load("block", (0.1, 1.0, 2.0))
    pushed = tj.equilibrium(mechanism, loads=[load])
    again = tj.equilibrium(mechanism, loads=[load], start=pushed)
    assert_close(again.displacements, pushed.displacements)
    more = tj.Load("block", (0.0, 1.0, 0.0))
    small = [
        tj.linearize(mechanism, about=about, loads=[load])(loads=[more])
        for about in (pushed, pushed.poses)
    ]
    assert_close(small[0].displacements, small[1].displacements)
    motion = {
        "displacements": pushed.displacements[None],
        "reference": mechanism.reference,
    }
    for wrong, words in (
        ("poses", "`start` is 'poses', but must be an equilibrium, or poses"),
        (SimpleNamespace(**motion), r"`start` has shape \(1, 2, 3\), but"),
    ):
        with pytest.raises(ValueError, match=words):
            tj.equilibrium(mechanism, start=wrong)
    other = tj.Mechanism([tj.Body("block"), tj.Body("wall")], [hinge], fixed=["wall"])
    with pytest.raises(
        ValueError, match="`start` is of a mechanism with the bodies wall"
    ):
        tj.equilibrium(other, start=pushed)
    # changes from a loaded state are displacements from rest as well
    assert_close(mechanism.displacements(small[0]), small[0].poses - mechanism.reference)


def test_the_wrench_of_a_hinge_is_what_balances_a_load():
    mechanism = tj.Mechanism(
        bodies("a", "b"), [hinge("h", "a", "b", at=(np.pi / 2, 0.0, 0.0))], fixed=["a"]
    )
    solution = tj.equilibrium(mechanism, loads=[tj.Load("b", (0.1, 0.2, -0.3))])
    _, port = mechanism.ports("h", solution.poses)
    wrench = mechanism.wrench_of("h", solution.poses)
    at_body = tj.geometry.se2.transform_wrench(
        port.at[1:].add(-solution.pose("b")[1:]), wrench
    )  # from frame b to the body's origin, in world axes
    assert_close(at_body, [0.1, 0.2, -0.3], digits=9)


def test_prints_what_it_is():
    names = bodies("frame", "stage")
    mechanism = tj.Mechanism(
        names, [hinge("leaf", "frame", "stage")], {"frame": ("x",), "stage": ("y",)}
    )
    assert repr(mechanism) == (
        "Mechanism of 2 bodies (frame, stage), 1 hinge (leaf); fixed: x of frame, "
        "y of stage"
    )


def built(names=("a", "b"), hinges=None, fixed=("a",)):
    hinges = [hinge("h", "a", "b")] if hinges is None else hinges
    return tj.Mechanism(bodies(*names), hinges, fixed)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: built(("a", "a")), "The body 'a' is given twice"),
        (lambda: built(("a", "")), "The name of a body is ''"),
        (
            lambda: built(hinges=[hinge("h", "a", "b")] * 2),
            "The hinge 'h' is given twice",
        ),
        (
            lambda: built(hinges=[hinge("h", "a", "c")]),
            "`second` of the hinge 'h' names the body 'c', but the bodies are 'a', 'b'",
        ),
        (lambda: hinge("h", tj.Body("a"), "b"), "`first` of the hinge 'h' is Body"),
        (
            lambda: hinge("h", "a", "b", np.eye(3)),
            "`energy` of the hinge 'h' is a ndarray, but must be an energy",
        ),
        (lambda: tj.Mechanism(["a"], []), r"`bodies\[0\]` is a str, but must be a Body"),
        (lambda: built(hinges=[]), "`hinges` is empty, but a mechanism needs"),
        (lambda: built(fixed=["c"]), "`fixed` names the body 'c', but the bodies are"),
        (lambda: built(fixed="a"), r"`fixed` is the string 'a'.*\['a'\]"),
        (
            lambda: built(fixed={"a": ("z",)}),
            "`fixed` of the body 'a' names the coordinate 'z', but the coordinates are",
        ),
        (
            lambda: tj.equilibrium(built(("a", "b", "c", "d"))),
            "Nothing holds 'c' and 'd': no chain of hinges",
        ),
        (lambda: tj.linearize(built(fixed=())), "Nothing holds 'a' and 'b'"),
        (
            lambda: tj.Body("stage", mass=0.0),
            "`mass` of the body 'stage' is 0, but must be positive",
        ),
        (
            lambda: tj.Body("stage", inertia=-1.0),
            "`inertia` of the body 'stage' is -1, but must be positive",
        ),
        (
            lambda: tj.Body("stage", (0.0, np.nan, 0.0)),
            "`pose` of the body 'stage' is .*nan.*, but must be finite",
        ),
        (
            lambda: tj.Body("stage", (0.0, 0.0)),
            r"`pose` of the body 'stage' has shape \(2,\), but must be \(angle, x, y\)",
        ),
        (
            lambda: built(hinges=[hinge("h", "a", "b", Even(jnp.array(jnp.nan)))]),
            "The energy of the hinge 'h' has a value that is not finite",
        ),
        (
            lambda: built(hinges=[hinge("h", "a", "b", (-1.0) * SPRING)]),
            "The energy of the hinge 'h' cannot be used: its factor",
        ),
    ],
)
def test_refuses_by_name(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_refuses_a_stiffness_gone_wrong_by_the_name_of_its_hinge():
    import equinox as eqx

    broken = eqx.tree_at(lambda e: e.stiffness, SPRING, jnp.diag(jnp.array([1.0, -1, 1])))
    with pytest.raises(
        ValueError, match="hinge 'h' cannot be used: `stiffness` has a neg"
    ):
        built(hinges=[hinge("h", "a", "b", broken)])


@pytest.mark.parametrize("gap", [(1e-6, 0, 0), (0, 1e-6, 0)])
def test_refuses_ports_that_do_not_coincide_at_rest(gap):
    ports = (0.0, 1.0, 0.0), np.array([0.0, 0.0, 0.0]) + gap
    names = [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))]
    with pytest.raises(
        ValueError, match="ports of the hinge 'h' do not coincide at rest"
    ):
        tj.Mechanism(names, [tj.Hinge("h", "a", "b", SPRING, ports=ports)], fixed=["a"])


def test_accepts_ports_that_coincide_to_rounding():
    ports = (0.0, 1.0, 0.0), (1e-12, 1e-12, 0.0)
    names = [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))]
    tj.Mechanism(names, [tj.Hinge("h", "a", "b", SPRING, ports=ports)], fixed=["a"])


@pytest.mark.untyped
def test_refuses_poses_of_another_mechanism():
    with pytest.raises(ValueError, match=r"has shape \(3, 3\), but a mechanism with the "
                       r"bodies a, b has poses of shape \(2, 3\)"):  # fmt: skip
        built().energy(jnp.zeros((3, 3)))


def test_refuses_unknown_names():
    with pytest.raises(ValueError, match="names the hinge 'k', but the hinges are 'h'"):
        built().displacement_of("k", jnp.zeros((2, 3)))
    with pytest.raises(ValueError, match="names the body 'k', but the bodies are 'a'"):
        built().index("k")


@pytest.mark.parametrize(
    ("corners", "density", "message"),
    [
        (np.zeros((4, 2)), 1.0, "`corners` of the plate 'p' enclose no area"),
        (np.zeros((2, 2)), 1.0, r"has shape \(2, 2\), but must have a row"),
        (np.eye(3)[:, :2], None, "needs the `density` of its material"),
    ],
)
def test_refuses_what_is_no_plate(corners, density, message):
    material = tj.Material(modulus=1.0, poisson=0.3, density=density)
    with pytest.raises(ValueError, match=message):
        tj.plate("p", corners, width=1.0, material=material)
