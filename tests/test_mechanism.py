"""Mechanisms, bodies, and plates: assembly, invariance, and invalid arguments."""

import pathlib
import warnings
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, some_stiffness

import twistorjax as tj
from twistorjax._utils.validation import require_choice
from twistorjax.geometry import se2


SPRING = tj.Quadratic(some_stiffness(1))
STEEL = tj.Material(modulus=210e9, poisson=0.3, density=7800.0)
BASE = tj.Body("base")


SQUARE = [(0.0, 0.0), (0.3, 0.0), (0.3, 0.3), (0.0, 0.3)]
HOLE = [(0.1, 0.1), (0.1, 0.2), (0.2, 0.2), (0.2, 0.1)]  # clockwise
WITH_HOLE = [*SQUARE, SQUARE[0], *HOLE, HOLE[0]]  # a cut joins the two boundaries


class Axial(tj.AbstractEnergy):
    """Another class of energy, with a parameter."""

    factor: jax.Array

    def stored_energy(self, displacement):
        return self.factor * displacement.x1**2


def hinge(name, first, second, energy: tj.AbstractEnergy = SPRING, at=(0.0, 0.0, 0.0)):
    return tj.Hinge(name, first, second, energy, at)


def bodies(*names):
    return [tj.Body(name) for name in names]


def mechanism_of(names=("a", "b"), hinges=None, fixed=("a",)):
    hinges = [hinge("h", "a", "b")] if hinges is None else hinges
    return tj.Mechanism(bodies(*names), hinges, fixed)


def block_on_spring(at, pose=(0.0, 0.0, 0.0), **inertia):
    energy = tj.Quadratic(np.diag([1.0, 300.0, 200.0]))
    block = tj.Body("block", pose, **inertia)
    return tj.Mechanism(
        [BASE, block], [hinge("h", "base", "block", energy, at)], ["base"]
    )


def test_energy_forces_and_stiffness_are_sums_over_hinges():
    """There are three classes of energy, one of them twice, in mixed order."""
    energies = [Axial(jnp.array(2.0)), SPRING, Axial(jnp.array(3.0)), SPRING + SPRING]
    frames = [(0.1, 0.2, 0.3), (0.4, -0.2, 0.1), (-0.6, 0.0, 0.5), (0.0, 0.3, 0.0)]
    pairs = [("a", "b"), ("b", "c"), ("c", "a"), ("b", "a")]
    hinges = [
        hinge(str(k), *pairs[k], energies[k], frames[k]) for k in range(len(energies))
    ]
    names = "a", "b", "c"
    single = [mechanism_of(names, [one], fixed=names) for one in hinges]
    mechanism = mechanism_of(names, hinges)
    poses = np.random.default_rng(0).normal(size=(3, 3))

    @jax.jit
    def quantities(poses):
        return [
            [each.energy(poses), each.wrenches(poses), each.stiffness(poses)]
            for each in (mechanism, *single)
        ]

    for total, *parts in zip(*quantities(poses), strict=True):
        assert_close(total, sum(map(np.asarray, parts)))


def test_ports_and_pose_of_a_hinge_are_equivalent():
    reference = jnp.array([[0.4, 0.1, -0.2], [-0.7, 0.5, 0.3]])
    at = jnp.array([0.9, 0.3, 0.2])
    ports = [se2.between(pose, at) for pose in reference]
    both = [tj.Body("a", reference[0]), tj.Body("b", reference[1])]
    by_at = tj.Mechanism(both, [tj.Hinge("h", "a", "b", SPRING, at)], ["a"])
    by_ports = tj.Mechanism(both, [tj.Hinge("h", "a", "b", SPRING, ports=ports)], ["a"])
    poses = jnp.asarray(np.random.default_rng(0).normal(size=(2, 3)))
    assert_close(by_ports.energy(poses), by_at.energy(poses))


def test_energy_that_hinges_share_is_stored_once():
    shared = mechanism_of(hinges=[hinge(k, "a", "b") for k in "123"])
    energy = shared.hinge_assembly.groups[0].energy
    assert isinstance(energy, tj.Quadratic) and energy.stiffness.shape == (3, 3)
    equal = [hinge(k, "a", "b", tj.Quadratic(SPRING.stiffness)) for k in "12"]
    assert len(mechanism_of(hinges=equal).hinge_assembly.groups) == 1


def test_displacement_of_a_hinge_is_in_its_own_axes():
    """Axis 1 of the hinge points along y."""
    both = [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))]
    mechanism = tj.Mechanism(
        both, [hinge("h", "a", "b", at=(np.pi / 2, 0.5, 0.0))], ["a"]
    )
    poses = jnp.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.2]])
    assert_close(mechanism.displacement_of("h", poses), [0.0, 0.2, 0.0])


def test_only_bodies_that_move_need_inertia():
    moving = tj.Body("b", mass=2.0, inertia=3.0)
    mechanism = tj.Mechanism([tj.Body("a"), moving], [hinge("h", "a", "b")], ["a"])
    assert_close(mechanism.inertia(), [[np.inf] * 3, [3.0, 2.0, 2.0]])
    with pytest.raises(ValueError, match="The body 'b' can move, but has no `mass`"):
        mechanism_of().inertia()


def test_inertia_of_a_rectangular_plate_is_the_closed_form():
    """It is rotated and lies away from the origin."""
    length, height, width = 0.04, 0.005, 0.004
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [length / 2, height / 2]
    rotation = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    for order in (corners, corners[::-1]):
        outline = order @ rotation.T + [0.3, 0.7]
        bar = tj.plate("bar", outline, width=width, material=STEEL)
        mass = 7800 * length * height * width
        assert_close(bar.mass, mass)
        assert bar.inertia is not None
        assert_close(bar.inertia / (mass * (length**2 + height**2) / 12), 1.0)
        assert_close(bar.pose, [0.0, 0.3, 0.7])
        assert_close(np.asarray(bar.outline).mean(axis=0), [0.0, 0.0])


def test_inertia_of_a_triangular_plate_is_the_closed_form():
    """An additional corner on an edge does not matter."""
    base, height, width = 0.03, 0.02, 0.004
    corners = np.array([[0, 0], [0.001, 0], [base, 0], [0, height]])
    wedge = tj.plate("wedge", corners, width=width, material=STEEL)
    mass = 7800 * width * base * height / 2
    assert_close(wedge.pose, [0.0, base / 3, height / 3])
    assert wedge.inertia is not None
    assert_close(wedge.inertia / mass, (base**2 + height**2) / 18)


@pytest.mark.parametrize("size", [1e-15, 1e-12])
def test_wrenches_of_tiny_displacements_are_accurate(size):
    """The block moves by less than the rounding error of its position, which is 40 mm."""
    mechanism = block_on_spring((0.3, 40e-3, 30e-3), pose=(0.0, 40e-3, 30e-3))
    force = size * np.array([250.0, -170.0])
    solution = tj.equilibrium(mechanism, loads=[tj.Load("block", force=force)])
    wrench = np.asarray(mechanism.wrench_of("h", solution))
    into_hinge = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    assert_close(wrench / size, [0.0, *(into_hinge @ force / size)], digits=11)
    translation = np.asarray(solution.displacement("block"))[1:]
    of_hinge = np.asarray(mechanism.displacement_of("h", solution))[1:]
    assert_close(of_hinge / size, into_hinge @ translation / size, digits=11)


def test_wrench_of_a_hinge_has_a_row_for_each_time_of_a_motion():
    mechanism = block_on_spring((0.0, 0.0, 0.0))
    displacements = np.zeros((3, 2, 3))
    displacements[:, 1, 1:] = [[0.0, 1e-3], [2e-3, 0.0], [-1e-3, 0.0]]
    motion: Any = SimpleNamespace(
        displacements=jnp.asarray(displacements), reference=mechanism.reference
    )
    wrenches = mechanism.wrench_of("h", motion)
    assert_close(wrenches, displacements[:, 1] * [1.0, 300.0, 200.0])


@pytest.mark.untyped
def test_equilibrium_is_accepted_instead_of_poses():
    mechanism = block_on_spring((0.0, 0.1, 0.0))
    load = tj.Load("block", (0.1, 1.0, 2.0))
    solution = tj.equilibrium(mechanism, loads=[load])
    again = tj.equilibrium(mechanism, loads=[load], start=solution)
    assert_close(again.displacements, solution.displacements)
    change = tj.Load("block", force=(1.0, 0.0))
    linear, by_poses = (
        tj.linearize(mechanism, about=about, loads=[load])(loads=[change])
        for about in (solution, solution.poses)
    )
    assert_close(linear.displacements, by_poses.displacements)
    # The displacements of a linear solution count from the reference, not from `about`.
    displacements = mechanism.displacements(linear)
    assert_close(displacements, linear.poses - mechanism.reference)
    motion = SimpleNamespace(
        displacements=solution.displacements[None], reference=mechanism.reference
    )
    for wrong, message in (
        ("poses", "`start` is 'poses', but must be an equilibrium or poses"),
        (STEEL, "`start` is a Material, but must be an equilibrium or poses"),
        (motion, r"`start` has shape \(1, 2, 3\), but"),
    ):
        with pytest.raises(ValueError, match=message):
            tj.equilibrium(mechanism, start=wrong)  # pyright: ignore[reportArgumentType]
    spring = hinge("h", "base", "block")
    exchanged = tj.Mechanism([tj.Body("block"), BASE], [spring], ["base"])
    message = "`start` is of a mechanism with the bodies base"
    with pytest.raises(ValueError, match=message):
        tj.equilibrium(exchanged, start=solution)


def test_wrench_of_a_hinge_balances_the_load():
    spring = hinge("h", "a", "b", at=(np.pi / 2, 0.0, 0.0))
    mechanism = mechanism_of(hinges=[spring])
    solution = tj.equilibrium(mechanism, loads=[tj.Load("b", (0.1, 0.2, -0.3))])
    _, frame_b = mechanism.ports("h", solution.poses)
    wrench = mechanism.wrench_of("h", solution.poses)
    # The wrench is transformed from frame b to the origin of the body, in world axes.
    from_origin = frame_b.at[1:].add(-solution.pose("b")[1:])
    on_body = se2.transform_wrench(from_origin, wrench)
    assert_close(on_body, [0.1, 0.2, -0.3], digits=9)


def test_mechanism_is_printed_in_one_line():
    leaf = hinge("leaf", "frame", "stage")
    fixed = {"frame": ("x",), "stage": ("y",)}
    assert repr(mechanism_of(("frame", "stage"), [leaf], fixed)) == (
        "Mechanism of 2 bodies (frame, stage), 1 hinge (leaf); fixed: x of frame, "
        "y of stage"
    )


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("create", "message"),
    [
        (lambda: mechanism_of(("a", "a")), "The body 'a' is given twice"),
        (lambda: mechanism_of(("a", "")), "The name of a body is ''"),
        (
            lambda: mechanism_of(hinges=[hinge("h", "a", "b")] * 2),
            "The hinge 'h' is given twice",
        ),
        (
            lambda: mechanism_of(hinges=[hinge("h", "a", "c")]),
            "`second` of the hinge 'h' names the body 'c', but the bodies are 'a', 'b'",
        ),
        (lambda: hinge("h", tj.Body("a"), "b"), "`first` of the hinge 'h' is a Body"),
        (
            lambda: hinge("h", "a", "b", np.eye(3)),  # pyright: ignore[reportArgumentType]
            "`energy` of the hinge 'h' is a ndarray, but must be an energy",
        ),
        (lambda: tj.Mechanism(["a"], []), r"`bodies\[0\]` is a str, but must be a Body"),  # pyright: ignore[reportArgumentType]
        (lambda: mechanism_of(hinges=[]), "`hinges` is empty, but a mechanism needs"),
        (
            lambda: mechanism_of(fixed=["c"]),
            "`fixed` names the body 'c', but the bodies are",
        ),
        (lambda: mechanism_of(fixed="a"), r"`fixed` is the string 'a'.*\['a'\]"),
        (
            lambda: mechanism_of(fixed={"a": ("z",)}),
            "`fixed` of the body 'a' names the coordinate 'z', but the coordinates are",
        ),
        (
            lambda: tj.equilibrium(mechanism_of(("a", "b", "c", "d"))),
            "The bodies 'c' and 'd' are not connected",
        ),
        (
            lambda: tj.linearize(mechanism_of(fixed=())),
            "The bodies 'a' and 'b' are not connected",
        ),
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
            "`pose` of the body 'stage' has .*nan.* at index ., but must be finite",
        ),
        (
            lambda: tj.Body("stage", (0.0, 0.0)),
            r"`pose` of the body 'stage' has shape \(2,\), but must be \(angle, x, y\)",
        ),
        (
            lambda: mechanism_of(
                hinges=[hinge("h", "a", "b", Axial(jnp.array(jnp.nan)))]
            ),
            "The energy of the hinge 'h' has a value that is not finite",
        ),
        (
            lambda: mechanism_of(hinges=[hinge("h", "a", "b", (-1.0) * SPRING)]),
            "The energy of the hinge 'h' cannot be used: its factor",
        ),
        (
            lambda: tj.plate("p", np.eye(3)[:, :2], width=1.0, material="steel"),  # pyright: ignore[reportArgumentType]
            "`material` of the plate 'p' is a str, but must be a Material",
        ),
    ],
)
def test_invalid_arguments_are_reported_by_name(create, message):
    with pytest.raises(ValueError, match=message):
        create()


def test_invalid_stiffness_is_reported_with_the_name_of_its_hinge():
    indefinite = jnp.asarray(np.diag([1.0, -1, 1]))
    broken = eqx.tree_at(lambda energy: energy.stiffness, SPRING, indefinite)
    message = "hinge 'h' cannot be used: `stiffness` has a neg"
    with pytest.raises(ValueError, match=message):
        mechanism_of(hinges=[hinge("h", "a", "b", broken)])


def mechanism_with_ports(on_a, on_b):
    both = [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))]
    by_ports = tj.Hinge("h", "a", "b", SPRING, ports=(on_a, on_b))
    return tj.Mechanism(both, [by_ports], ["a"])


@pytest.mark.parametrize("gap", [(1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0)])
def test_ports_must_coincide_in_the_reference_configuration(gap):
    message = "ports of the hinge 'h' do not coincide in the reference configuration"
    with pytest.raises(ValueError, match=message):
        mechanism_with_ports((0.0, 1.0, 0.0), gap)


def test_ports_may_differ_by_rounding_errors():
    mechanism_with_ports((0.0, 1.0, 0.0), (1e-12, 1e-12, 0.0))


@pytest.mark.untyped
def test_poses_of_another_mechanism_are_reported():
    message = (
        r"has shape \(3, 3\), but a mechanism with the bodies a, b has poses of shape "
        r"\(2, 3\)"
    )
    with pytest.raises(ValueError, match=message):
        mechanism_of().energy(jnp.zeros((3, 3)))


LONG = "x" * 10_000


@pytest.mark.parametrize(
    "build",
    [
        lambda: tj.Body(LONG),
        lambda: tj.plate(LONG, SQUARE, width=1.0, material=tj.Material(1.0, 0.3)),
        lambda: hinge(LONG, "a", "b"),
        lambda: hinge("h", LONG, "b"),
        lambda: tj.Load(LONG),
        lambda: tj.Drive(LONG),
        lambda: tj.Drive(LONG, angle=jnp.nan),
        lambda: tj.Pin(LONG, "a", "b", at=(0.0, 0.0)),
        lambda: mechanism_of().index(LONG),
        lambda: mechanism_of().wrench_of(LONG, jnp.zeros((2, 3))),
        lambda: tj.equilibrium(mechanism_of(), loads=[tj.Load(LONG, moment=1.0)]),
        lambda: require_choice("`formula`", LONG, ["fitted"]),
        lambda: tj.sweeps.Grid({LONG: [1.0]}),
        lambda: tj.sweep(lambda design: design[LONG], {LONG: np.array([1.0])}),
        lambda: tj.optimize(lambda design: design, {"x": 1.0}, minimize=LONG),
        lambda: tj.optimize(
            lambda design: design,
            {"x": 1.0},
            minimize="x",
            standard_deviations={LONG: 1.0},
        ),
        lambda: tj.Mechanism([tj.Body(f"{k}") for k in range(500)], [], fixed=["none"]),
        lambda: tj.Mechanism(
            [tj.Body(f"{k:050}") for k in range(50)], [hinge("h", "a", "b")]
        ),
    ],
)
@pytest.mark.untyped
def test_long_names_are_not_repeated_in_messages(build):
    with pytest.raises(ValueError) as error:
        build()
    assert len(str(error.value)) < 1000
    tj.Body("x" * 200)


def test_a_start_must_not_displace_a_fixed_body():
    mechanism = mechanism_of()
    start = np.asarray(mechanism.reference) + np.array(
        [[0.0, 1e-3, 0.0], [0.0, 0.0, 0.0]]
    )
    message = "`start` displaces the x of the body 'a' by 0.001, but it is fixed"
    for solve in (
        lambda: tj.equilibrium(mechanism, start=start),
        lambda: tj.path(mechanism, loads=[tj.Load("b", moment=0.1)], start=start),
    ):
        with pytest.raises(ValueError, match=message):
            solve()


def test_unknown_names_are_reported():
    with pytest.raises(ValueError, match="names the hinge 'k', but the hinges are 'h'"):
        mechanism_of().displacement_of("k", jnp.zeros((2, 3)))
    with pytest.raises(ValueError, match="names the body 'k', but the bodies are 'a'"):
        mechanism_of().index("k")


@pytest.mark.parametrize(
    ("corners", "density", "message"),
    [
        (np.zeros((4, 2)), 1.0, "`corners` of the plate 'p' enclose no area"),
        (np.zeros((2, 2)), 1.0, r"has shape \(2, 2\), but must have a row"),
        (np.eye(3)[:, :2], None, "needs the `density` of its material"),
    ],
)
def test_invalid_plates_are_reported(corners, density, message):
    material = tj.Material(modulus=1.0, poisson=0.3, density=density)
    with pytest.raises(ValueError, match=message):
        tj.plate("p", corners, width=1.0, material=material)


@pytest.mark.parametrize("scale", [4e307, 1.0, 1e-300])
@pytest.mark.parametrize(
    ("corners", "first", "second"),
    [
        ([(0, 0), (0.1, 0.1), (0.1, 0), (0, 0.1)], 0, 2),
        ([(0, 0), (4, 0), (4, 4), (2, -1), (0, 4)], 0, 2),
        # The crossing point is a corner of one edge, or of both
        ([(0, 0), (1, 1), (1, 0), (0.5, 0.5), (0, 1)], 0, 2),
        ([(0, 0), (0.5, 0.5), (1, 1), (1, 0), (0.5, 0.5), (0, 1)], 0, 3),
        # The boundary is passed twice
        ([(0, 0), (2, 0), (0, 2), (0, 0), (2, 0), (0, 2)], 0, 2),
        # A hole is passed in the direction of the outer boundary
        ([*WITH_HOLE[:5], *WITH_HOLE[5:][::-1]], 5, 8),
    ],
)
def test_an_outline_that_crosses_itself_names_the_two_edges(
    corners, first, second, scale
):
    crossed = scale * np.array(corners, float)
    message = rf"edge {first} from \(.*\) to \(.*\) crosses edge {second} from \("
    with pytest.raises(ValueError, match=f"`outline` of the body 'b' .* {message}"):
        tj.Body("b", outline=crossed)


@pytest.mark.untyped
def test_plates_and_hinges_refuse_an_outline_that_crosses_itself():
    bow = [(0, 0), (0.1, 0.1), (0.1, 0), (0, 0.1)]
    with pytest.raises(ValueError, match="`corners` of the plate 'p' crosses itself"):
        tj.plate("p", bow, width=1.0, material=STEEL)
    with pytest.raises(ValueError, match="`outline` of the hinge 'h' crosses itself"):
        tj.Hinge("h", "a", "b", SPRING, (0.0, 0.0, 0.0), outline=bow)


@pytest.mark.parametrize(
    ("corners", "area"),
    [
        (WITH_HOLE, 0.08),
        (WITH_HOLE[::-1], 0.08),
        ([corner for corner in SQUARE for _ in range(2)] + SQUARE[:1], 0.09),
        # Two squares that touch at a corner, and a corner that touches an edge
        ([(0, 0), (1, 0), (1, 1), (2, 1), (2, 2), (1, 2), (1, 1), (0, 1)], 2.0),
        ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], 8.0),
    ],
)
@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_edges_that_only_touch_are_accepted(corners, area, angle):
    """In every direction, although rounding errors move the corners."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    outline = np.array(corners, float) @ turn.T
    bar = tj.plate("p", outline, width=1.0, material=STEEL)
    assert_close(bar.mass, area * 7800.0)


@pytest.mark.parametrize(
    ("build", "name"),
    [
        (lambda: tj.Body("a", (90.0, 0.0, 0.0)), "The angle of `pose` of the body 'a'"),
        (
            lambda: tj.Hinge("h", "a", "b", tj.Quadratic(jnp.eye(3)), (90.0, 0.0, 0.0)),
            "The angle of `at` of the hinge 'h'",
        ),
        (lambda: tj.Drive("a", angle=90.0), "`angle` of the drive of 'a'"),
    ],
)
def test_angles_in_degrees_are_noticed(build, name):
    with pytest.warns(
        UserWarning, match=rf"{name} is 90 rad.*90 degrees are 1\.5708 rad"
    ):
        build()


@pytest.mark.parametrize(
    "values",
    [
        {"modulus": 210.0},
        {"modulus": 210e3},
        {"modulus": 210e18},
        {"density": 7.8},
        {"expansion": 12.0},
        {"strength": 500.0},
        {"ultimate_strength": 700.0},
    ],
)
def test_properties_of_no_solid_are_noticed(values):
    with pytest.warns(UserWarning, match="but that of solids is between"):
        tj.Material(**{"modulus": 210e9, "poisson": 0.3, **values})


CENTERED = 1e-2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"inertia": 66.7}, r"between 2e-08 and 0.0002 kg m\^2. 1 kg mm\^2 is 1e-6"),
        ({"inertia": 66.7e-12}, r"1 kg mm\^2 is 1e-6"),
        ({"outline": CENTERED + np.array([0.0, 0.02])}, "0.02 m away from the centroid"),
        ({"outline": 1e3 * CENTERED}, "The size of the outline of the body 'a' is 20 m"),
    ],
)
def test_a_mass_that_contradicts_the_outline_is_noticed(settings, text):
    usual: dict[str, Any] = {"mass": 1.0, "inertia": 66.7e-6, "outline": CENTERED}
    tj.Body("a", **usual)  # a warning is an error
    # In statics, the frame may be anywhere.
    tj.Body("a", outline=CENTERED + np.array([0.0, 0.02]))
    if "outline" in settings:
        usual.pop("inertia")
    with pytest.warns(UserWarning, match=text):
        tj.Body("a", **{**usual, **settings})


def test_a_plate_in_millimeters_is_noticed():
    steel = tj.Material(210e9, 0.3, density=7800.0)
    tj.plate("a", CENTERED, width=0.01, material=steel)
    with pytest.warns(UserWarning, match="`width` of the plate 'a' is 10 m"):
        tj.plate("a", CENTERED, width=10.0, material=steel)
    with pytest.warns(UserWarning, match="The size of the outline of the body 'a'"):
        tj.plate("a", 2e3 * CENTERED, width=0.01, material=steel)


@pytest.mark.parametrize(
    "build",
    [
        lambda: tj.Drive("a", x=2.0),
        lambda: tj.energies.Stop("-x", gap=2.0, stiffness=1e6, smoothing=1e-5),
        lambda: tj.flexures.piezo_stack(
            free_stroke=30.0, blocking_force=800.0, length=18e-3, width=5e-3
        ),
    ],
)
def test_displacements_in_other_units_are_noticed(build):
    with pytest.warns(UserWarning, match="Lengths are in meters"):
        build()


def flexures_of(scale, material=STEEL):
    """Create flexures of some micrometers times a factor."""
    length, width, thickness = 100e-6 * scale, 20e-6 * scale, 2e-6 * scale
    flexures = tj.flexures
    flexures.Beam(material, length=length, thickness=thickness, width=width)
    flexures.notch(material, hole=length, web=0.1 * length, width=width)
    flexures.notch_profile(hole=length, web=thickness)
    flexures.filleted_leaf_profile(length=length, thickness=thickness, fillet=width)
    flexures.elliptical_notch_profile(length=length, web=thickness, depth=width)
    flexures.power_law_notch_profile(length=length, web=thickness, depth=width)
    flexures.v_notch_profile(length=length, web=thickness, radius=width, angle=1.0)
    flexures.elliptical_notch(
        material, length=length, web=thickness, depth=width, width=width
    )


def test_dimensions_in_millimeters_are_noticed():
    """A leaf of 50 m is no flexure. Those of micromechanics and of large machines are."""
    for scale in (1.0, 1e4):  # 100 um and 1 m
        flexures_of(scale)  # a warning is an error
    message = "`length` is 50 m, .*50 mm is 50e-3"
    with pytest.warns(UserWarning, match=message) as found:
        tj.flexures.Beam(STEEL, length=50.0, thickness=0.5, width=1.0)
    assert found[0].filename == __file__
    with pytest.warns(UserWarning) as found:
        flexures_of(1e6)
    names = [str(warning.message).split("`")[1] for warning in found]
    with pytest.warns(UserWarning, match="`hole` is 3 m"):
        tj.flexures.notch(STEEL, hole=3.0, web=0.4, width=1.0)
    assert len(names) > 15 and set(names) >= {"length", "hole", "width", "depth"}
    without_units = tj.Material(1.0, poisson=0.3)
    tj.flexures.Beam(without_units, length=10.0, thickness=1.0, width=1.0)


def outlined(x, y, angle=np.pi / 2, energy=None, length=10e-3):
    """Return a leaf between two plates whose outlines are 10 mm apart."""
    square = np.array([[-5e-3, -2e-3], [5e-3, -2e-3], [5e-3, 2e-3], [-5e-3, 2e-3]])
    bodies = [
        tj.Body("base", (0.0, 0.3, -7e-3), outline=square),
        tj.Body("table", (np.pi, 0.3, 7e-3), outline=square),
    ]
    steel = tj.Material(210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=length, thickness=0.5e-3, width=5e-3)
    hinge = tj.Hinge("leaf", "base", "table", energy or leaf, at=(angle, x, y))
    return tj.Mechanism(bodies, [hinge], fixed=["base"])


def test_flexures_far_from_their_bodies_are_reported():
    outlined(0.3, 0.0)  # a warning is an error
    outlined(0.3 + 7e-3, 0.0)  # 2 mm beside both outlines, less than a quarter
    with pytest.warns(UserWarning, match="0.003 m away from the outline of its first"):
        outlined(0.3 + 8e-3, 0.0)
    with pytest.warns(UserWarning, match="'leaf', of length 0.01 m"):
        outlined(0.0, 0.3)  # x and y exchanged
    outlined(0.3, 0.0, length=9.5e-3)
    with pytest.warns(UserWarning, match="0.001 m shorter than the distance of"):
        outlined(0.3, 0.0, length=9e-3)
    for pose in ((0.3, 0.0, 0.0), (0.3, 5e-3)):  # along x; at the end of the leaf
        with pytest.warns(UserWarning, match="0.005 m away from"):
            outlined(*pose)


def test_positions_in_millimeters_are_reported_without_outlines():
    leaf = tj.flexures.leaf(STEEL, length=50e-3, thickness=0.5e-3, width=5e-3)

    def build(x, y, scale=1.0, outline=None):
        at = (np.pi / 2, x, y)
        hinge = tj.Hinge("leaf", "base", "table", leaf, at, outline=outline)
        bodies = [tj.Body("base"), tj.Body("table", (0.0, 0.0, 0.06 * scale))]
        tj.Mechanism(bodies, [hinge], fixed=["base"])

    build(-14.0, 0.03)
    build(-0.04, 0.03, outline=[(0.0, 0.0), (0.0, 0.01), (0.0, 0.02)])  # no length
    for wrong in ((-40.0, 30.0), (-40.0, 0.03), (-0.04, 0.03, 1e3)):
        with pytest.warns(UserWarning, match="'leaf', of length 0.05 m, is .* m away"):
            build(*wrong)


def test_a_leaf_from_its_second_body_to_its_first_is_reported():
    """Its tension is compression then, which makes no difference in a quadratic form."""
    with pytest.warns(UserWarning, match="Exchange `first` and `second`, or turn"):
        outlined(0.3, 0.0, -np.pi / 2)
    steel = tj.Material(210e9, poisson=0.3)
    linear = tj.flexures.linear_leaf(steel, length=10e-3, thickness=0.5e-3, width=5e-3)
    outlined(0.3, 0.0, -np.pi / 2, 2.0 * linear)


def warnings_of_a_user(build):
    """Return the files and the lines to which the warnings of a call refer."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        build()
    return [(warning.filename, warning.lineno) for warning in found]


@pytest.mark.parametrize(
    "build",
    [
        lambda: tj.Material(210.0, 0.3),
        lambda: tj.Body("a", (90.0, 0.0, 0.0)),
        lambda: tj.Drive("a", angle=90.0),
        lambda: outlined(0.0, 0.3),
        lambda: jax.tree.map(lambda x: tj.Body("a", (90.0, x, 0.0)), [1.0]),
    ],
)
def test_warnings_refer_to_the_line_of_the_user(build):
    """Not to this library, nor to equinox, which calls its constructors."""
    (place,) = set(warnings_of_a_user(build))
    lines = pathlib.Path(__file__).read_text().splitlines()
    assert place[0] == __file__
    assert "tj." in lines[place[1] - 1]
