"""Lattices of repeated cells, and waves in infinite ones, against closed forms."""

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest


mpl.use("agg")

import matplotlib.pyplot as plt
from helpers import assert_close
from matplotlib.patches import Rectangle

import twistorjax as tj


PITCH, MASS, INERTIA = 0.1, 2.0, 3e-3
JOINT = tj.Quadratic(np.diag([1.5e-3, 1.2e5, 1.2e3]))


def row_of_masses(stiffness=100.0, **masses):
    """Return a cell of one mass, which is joined to the next one by a spring."""
    rest = np.diag([10.0, 0.0, 1e4])
    energy = tj.Quadratic(jnp.asarray(rest).at[1, 1].set(stiffness))
    hinge = tj.Hinge("spring", "mass", "mass[1]", energy, at=(0, PITCH / 2, 0))
    return tj.lattices.UnitCell([tj.Body("mass", **masses)], [hinge], [(PITCH, 0)])


def test_copies_are_named_by_the_index_of_their_cell():
    cell = tj.lattices.rotating_squares(JOINT, pitch=PITCH, angle=0.3)
    lattice = tj.lattices.repeat(cell, (3, 2))
    mechanism = tj.Mechanism(lattice.bodies, lattice.hinges)
    assert mechanism.reference.shape == (4 * 3 * 2, 3)
    assert len(mechanism.hinge_names) == 5 * 4 + 6 * 3
    assert_close(mechanism.reference[mechanism.index("d[2, 1]")], [0, 0.5, 0.3])
    first, second = mechanism.hinge_assembly.ends[
        mechanism.hinge_names.index("bax[1, 0]")
    ]
    assert mechanism.names[first] == "b[1, 0]" and mechanism.names[second] == "a[2, 0]"
    assert lattice.border("left") == ("a[0, 0]", "c[0, 0]", "a[0, 1]", "c[0, 1]")
    assert lattice.border("top") == ("c[0, 1]", "d[0, 1]", "c[1, 1]", "d[1, 1]",
                                     "c[2, 1]", "d[2, 1]")  # fmt: skip
    # Squares at the left and the right border have joints at the same height.
    left, right = (lattice.ports[side][0] for side in ("left", "right"))
    assert (left.body, right.body, right.hinge) == ("a[0, 0]", "b[2, 0]", "bax")
    offset = PITCH / 2 * np.tan(0.3)
    assert_close(left.at, [0, -PITCH / 2, -offset])
    assert_close(right.at, [0, 5.5 * PITCH, -offset])


def test_a_lattice_counts_its_parts_and_may_lack_some_of_them():
    def cell(stiffness):
        weak, strong = (row_of_masses(k * stiffness).hinges[0] for k in (1.0, 2.0))
        strong = tj.Hinge("strong", weak.first, weak.second, strong.energy, weak.at)
        return tj.lattices.UnitCell([tj.Body("mass")], [weak, strong], [(PITCH, 0)])

    stiffness = np.array([100.0, 300.0, 50.0, 80.0])
    row = tj.lattices.repeat(cell, 4, stiffness)
    assert (len(row.bodies), len(row.hinges)) == (4, 6)
    assert [body.name for body in row.bodies] == [f"mass[{k}]" for k in range(4)]
    missing = row.hinges[4]  # the strong spring from the second mass to the third one
    assert (missing.name, missing.second) == ("strong[1]", "mass[2]")
    assert_close(missing.at, [0, 1.5 * PITCH, 0])
    assert_close(missing.energy.stiffness[1, 1], 600.0)
    others = [hinge for hinge in row.hinges if hinge.name != "strong[1]"]
    mechanism = tj.Mechanism(row.bodies, others, fixed=["mass[0]"])
    load = tj.Load("mass[3]", force=(0.3, 0.0))
    end = tj.equilibrium(mechanism, loads=[load]).displacement("mass[3]")
    assert_close(end[1], 0.3 * (1 / 300 + 1 / 300 + 1 / 150))


@pytest.mark.parametrize("traced", [False, True])
def test_springs_of_a_field_of_stiffnesses_act_in_series(traced):
    stiffness, force = np.array([100.0, 300.0, 50.0, 80.0]), 0.3

    def end(stiffness):
        row = tj.lattices.repeat(row_of_masses, 4, stiffness)
        mechanism = tj.Mechanism(row.bodies, row.hinges, fixed=["mass[0]"])
        load = tj.Load("mass[3]", force=(force, 0.0))
        return tj.equilibrium(mechanism, loads=[load]).displacement("mass[3]")[1]

    flexibility = np.array([1, 1, 1, 0]) / stiffness
    if not traced:
        assert_close(end(stiffness), force * flexibility.sum())
        return
    value, gradient = jax.value_and_grad(end)(jnp.asarray(stiffness))
    assert_close(value, force * flexibility.sum())
    assert_close(gradient, -force * flexibility / stiffness)


def test_rotating_squares_on_stiff_joints_contract_in_both_directions(
    validated, pictured
):
    """The pitch is that of open squares times the cosine of the angle."""
    stiff = tj.Quadratic(np.diag([1.0, 1e9, 1e9]))
    cell = tj.lattices.rotating_squares(stiff, pitch=PITCH, angle=0.3)
    one = cell.mechanism(fixed={"a": ["x", "y"]})
    turned = np.linspace(-0.05, 0.7, 6)
    strains = np.cos(0.3 + turned) / np.cos(0.3) - 1

    def angles(strain):
        constraints = cell.periodicity(strain * np.eye(2))
        pressed = tj.equilibrium(one, constraints=constraints)
        return np.asarray(pressed.displacements)[:4, 0] * np.array([1, -1, -1, 1])

    found = np.stack([angles(strain) for strain in strains])
    exact = np.tile(turned[:, None], (1, 4))
    assert_close(found, exact, digits=6)
    name = "rotation of squares that are compressed in both directions"
    validated("Lattices", name, found, exact, "the closed form")
    caption = "Rotation of stiff squares that are compressed in both directions."
    pictured(
        "Lattices", "rotating-squares", caption, ("strain", "rotation (rad)"),
        {"squares": (strains, found[:, 0])}, {"closed form": (strains, turned)},
    )  # fmt: skip


def test_neighbors_touch_where_their_edges_are_parallel():
    """The stops carry what exceeds the moments of the joints."""
    cell = tj.lattices.rotating_squares(
        tj.Quadratic(np.diag([1.0, 1e9, 1e9])), pitch=PITCH, angle=0.3,
        stop_stiffness=1e3, stop_smoothing=1e-3,
    )  # fmt: skip
    one = cell.mechanism(fixed={"a": ["x", "y"]})
    strain = np.cos(np.pi / 4 + 2e-3) / np.cos(0.3) - 1
    pressed = tj.equilibrium(one, constraints=cell.periodicity(strain * np.eye(2)))
    turn = 2 * (np.pi / 4 + 2e-3 - 0.3)
    depth = 4e-3
    per_joint = 2 * np.sin(turn / 2) ** 2
    smooth = 1e-3
    per_stop = 1e3 * (depth**2 / 2 - depth * smooth / 2 + smooth**2 / 6)
    assert_close(pressed.energy / (8 * (per_joint + per_stop)), 1.0, digits=4)
    assert pressed.steps < 30


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3,), "repeated in 2 directions"),
        ((3, 0), "positive whole numbers"),
        pytest.param(2.5, "positive whole numbers", marks=pytest.mark.untyped),
    ],
)
def test_counts_of_cells_are_checked(arguments, message):
    cell = tj.lattices.rotating_squares(JOINT, pitch=PITCH, angle=0.3)
    with pytest.raises(ValueError, match=message):
        tj.lattices.repeat(cell, arguments)


@pytest.mark.parametrize(
    ("waves", "fixed", "message"),
    [
        (np.zeros((0, 2)), (), "is empty, but must be wave vectors"),
        pytest.param(
            [1.0, 2.0],
            (),
            "has shape \\(2,\\), but must be wave vectors",
            marks=pytest.mark.untyped,
        ),
        ([[np.nan, 0.0]], (), "nan, 0.0\\] at index 0, but must be finite"),
        ([[1.0, 0.0]], ["mass[1]"], "names the body 'mass\\[1\\]', but"),
    ],
)
def test_arguments_of_dispersion_are_checked(waves, fixed, message):
    with pytest.raises(ValueError, match=message):
        tj.dispersion(row_of_masses(100.0), waves, fixed=fixed)


def test_errors_of_cells_say_what_to_do():
    body, at = tj.Body("mass"), (0, 0, 0)
    make = tj.lattices.UnitCell
    with pytest.raises(ValueError, match="the body 'spring', but the bodies are 'mass'"):
        make([body], [tj.Hinge("h", "mass", "spring[1]", JOINT, at)], [(1, 0)])
    with pytest.raises(ValueError, match="repeated in 1 direction: give 1 whole number"):
        make([body], [tj.Hinge("h", "mass", "mass[1, 0]", JOINT, at)], [(1, 0)])
    with pytest.raises(ValueError, match=r"is 'mass\[0\]', but must be written 'mass'"):
        make([body], [tj.Hinge("h", "mass", "mass[0]", JOINT, at)], [(1, 0)])
    with pytest.raises(ValueError, match=r"is 'mass\[1,0\]', but .* 'mass\[1, 0\]'"):
        make([body], [tj.Hinge("h", "mass", "mass[1,0]", JOINT, at)], np.eye(2))
    with pytest.raises(ValueError, match="ends with an index"):
        make([tj.Body("mass[0]")], [], [(1, 0)])
    with pytest.raises(ValueError, match="must be independent vectors"):
        make([body], [], [(1, 0), (2, 0)])
    with pytest.raises(ValueError, match="but its first axes must"):
        tj.lattices.repeat(row_of_masses, 4, np.ones(3))
    with pytest.raises(ValueError, match="differ in the names"):
        tj.lattices.repeat(
            lambda k: make([tj.Body(f"mass{k}")], [], [(1, 0)]), 2, np.arange(2.0)
        )

    def cell(pitch):
        return make([body], [], jnp.stack([jnp.stack([pitch, 0.0])]))

    with pytest.raises(ValueError, match="have different vectors"):
        tj.lattices.repeat(cell, 2, np.array([1.0, 2.0]))
    with pytest.raises(ValueError, match="vectors of the cell depend on the entries"):
        jax.jit(lambda pitches: tj.lattices.repeat(cell, 2, pitches).bodies[0].part)(
            jnp.ones(2)
        )
    lattice = tj.lattices.repeat(row_of_masses(), 3)
    with pytest.raises(ValueError, match="sides are 'left', 'right'"):
        lattice.border("top")


def test_waves_along_masses_on_springs_have_the_frequencies_of_closed_forms():
    cell = row_of_masses(mass=MASS, inertia=INERTIA)
    waves = cell.wave_vectors([(0.02,), (0.5,)], 20)
    found = tj.dispersion(cell, waves, fixed={"mass": ["angle", "y"]})
    expected = 2 * np.sqrt(100.0 / MASS) * np.sin(waves[:, 0] * PITCH / 2)
    assert_close(2 * np.pi * found.frequencies[:, 0], expected, digits=10)

    def frequency(wave):
        waves = jnp.stack([wave, 0.0])[None]
        return tj.dispersion(cell, waves, modes=1, fixed=FIXED).frequencies[0, 0]

    FIXED = {"mass": ["angle", "y"]}
    velocity = 2 * np.pi * jax.grad(frequency)(7.0)
    assert_close(velocity, np.sqrt(100.0 / MASS) * PITCH * np.cos(0.35), digits=10)


def two_masses(light, count, start=0.5):
    """Return the waves from the edge of the zone, or from another start, to its center.

    A cell has two masses, which springs join in a row.
    """
    spring = tj.Quadratic(np.diag([1.0, 100.0, 1.0]))
    hinges = [
        tj.Hinge("inner", "light", "heavy", spring, (0, PITCH / 4, 0)),
        tj.Hinge("outer", "heavy", "light[1]", spring, (0, 3 * PITCH / 4, 0)),
    ]
    bodies = [
        tj.Body("light", mass=light, inertia=INERTIA),
        tj.Body("heavy", (0, PITCH / 2, 0), mass=3.0, inertia=INERTIA),
    ]
    cell = tj.lattices.UnitCell(bodies, hinges, [(PITCH, 0)])
    fixed = {name: ["angle", "y"] for name in ("light", "heavy")}
    waves = cell.wave_vectors([(start,), (0.0,)], 20)[:count]
    return tj.dispersion(cell, waves, fixed=fixed)


GAP = np.sqrt(200.0 / np.array([3.0, 1.0]))  # (2 k / m)^0.5 of both masses; rad/s


def test_two_masses_in_a_cell_have_the_band_gap_of_the_closed_form(validated):
    def edges(light):
        return 2 * np.pi * two_masses(light, 1).frequencies[0]

    assert_close(edges(1.0), GAP, digits=10)
    name = "edges of the band gap of a row of two masses"
    validated("Vibrations and waves", name, edges(1.0), GAP, "the closed form")
    gap = jax.grad(lambda light: jnp.diff(edges(light))[0])(1.0)
    assert_close(gap, -GAP[1] / 2, digits=9)


def test_waves_along_rotating_squares_agree_with_equations_of_motion_by_hand():
    """A row of squares, whose joints are above and below the axis in turn."""
    offset, stiffness = 0.02, np.array([1.5, 1e4, 2e3])
    joint = tj.Quadratic(np.diag(stiffness))
    half = PITCH / 2
    bodies = [
        tj.Body("a", (0, 0, 0), MASS, INERTIA),
        tj.Body("b", (0, PITCH, 0), MASS, INERTIA),
    ]
    hinges = [
        tj.Hinge("ab", "a", "b", joint, (0, half, offset)),
        tj.Hinge("ba", "b", "a[1]", joint, (0, 3 * half, -offset)),
    ]
    cell = tj.lattices.UnitCell(bodies, hinges, [(2 * PITCH, 0)])
    waves = cell.wave_vectors([(0.0,), (0.5,)], 7)
    found = tj.dispersion(cell, waves).frequencies

    def strains(height, phase):
        """Rotation, and displacements of the joint, from a on the left to b."""
        left = np.array([[1, 0, 0], [-height, 1, 0], [half, 0, 1.0]])
        right = np.array([[1, 0, 0], [-height, 1, 0], [-half, 0, 1.0]])
        return -left, phase * right

    for wave, row in zip(waves[:, 0], np.asarray(found), strict=True):
        a, b = strains(offset, 1.0)
        c, d = strains(-offset, np.exp(2j * wave * PITCH))
        rows = np.block([[a, b], [d, c]])
        matrix = rows.conj().T @ np.diag(np.tile(stiffness, 2)) @ rows
        inertia = np.tile([INERTIA, MASS, MASS], 2)
        scaled = matrix / np.sqrt(np.outer(inertia, inertia))
        expected = np.linalg.eigvalsh(scaled)
        squares = (2 * np.pi * row) ** 2
        np.testing.assert_allclose(squares, expected, rtol=0, atol=1e-13 * expected[-1])


def test_band_gaps_are_drawn_between_the_bands():
    axes = tj.plotting.draw_dispersion(two_masses(1.0, 21))
    assert len(axes.lines) == 2
    (shown,) = axes.patches
    assert isinstance(shown, Rectangle)
    edges = np.array([shown.get_y(), shown.get_y() + shown.get_height()])
    assert_close(2 * np.pi * edges, GAP, digits=9)
    # Bands of equal masses cross at the edge, which is no wave vector of this path.
    assert not tj.plotting.draw_dispersion(two_masses(3.0, 21, start=0.9)).patches
    plt.close("all")
    with pytest.raises(ValueError, match="two wave vectors or more"):
        tj.plotting.draw_dispersion(two_masses(1.0, 1))


def test_corners_of_the_path_are_marked_at_their_wave_vectors():
    cell = tj.lattices.rotating_squares(
        tj.Quadratic(np.diag([1.5e-3, 1.2e5, 1.2e3])), pitch=0.1, angle=0.4, mass=1e-3
    )
    waves = cell.wave_vectors([(0, 0), (0.5, 0), (0.5, 0.5), (0, 0)], 4)
    bands = tj.dispersion(cell, waves, modes=1)
    axes = tj.plotting.draw_dispersion(bands, corners=["Γ", "X", "M", "Γ"])
    edge = np.pi / 0.2  # of a cell of two pitches; rad/m
    places = edge * np.array([0.0, 1.0, 2.0, 2.0 + np.sqrt(2)])
    assert_close(np.array(axes.get_xticks()), places, digits=9)
    plt.close("all")
    with pytest.raises(ValueError, match="3 names, but the path has 4 corners"):
        tj.plotting.draw_dispersion(bands, corners=["Γ", "X", "M"])


def stretched_string(strain):
    """Return a row of masses on bars that cannot bend, and its stretched state."""
    bar = tj.energies.AxialSpring(100.0, length=PITCH)
    hinge = tj.Hinge("bar", "mass", "mass[1]", bar, at=(0, PITCH / 2, 0))
    mass = tj.Body("mass", mass=MASS, inertia=INERTIA)
    cell = tj.lattices.UnitCell([mass], [hinge], [(PITCH, 0)])
    one = cell.mechanism(fixed=["mass"])
    constraints = cell.periodicity([[strain, 0], [0, 0]])
    return cell, tj.equilibrium(one, constraints=constraints)


def test_a_tensioned_string_carries_transverse_waves(validated, pictured):
    """The frequency is 2 (T / (m a))^0.5 sin(k a / 2), with the stretched pitch a."""
    cell, about = stretched_string(0.2)
    waves = cell.wave_vectors([(0.1,), (0.5,)], 5)
    fixed = {"mass": ["angle"]}
    found = tj.dispersion(cell, waves, about=about, fixed=fixed).frequencies
    sines = np.sin(waves[:, 0] * PITCH / 2)
    tension = 100.0 * 0.2 * PITCH
    transverse = 2 * np.sqrt(tension / (MASS * 1.2 * PITCH)) * sines
    along = 2 * np.sqrt(100.0 / MASS) * sines
    computed, expected = 2 * np.pi * np.asarray(found), np.stack([transverse, along], 1)
    assert_close(computed, expected, digits=9)
    name = "waves in a stretched row of masses"
    validated("Vibrations and waves", name, computed, expected, "the closed form")
    caption = "Waves in a row of masses on bars that are stretched by 20 %."
    phases = waves[:, 0] * PITCH / np.pi
    results = {
        label: (phases, values)
        for label, values in zip(("transverse", "along"), computed.T, strict=True)
    }
    closed = {"closed form": (np.tile(phases, 2), expected.T)}
    axes = "wave number times pitch over π", "frequency (rad/s)"
    pictured("Vibrations and waves", "stretched-row", caption, axes, results, closed)


def test_a_compressed_string_is_not_stable():
    cell, about = stretched_string(-0.1)
    wave = cell.wave_vectors([(0.5,), (0.4,)], 1)
    fixed = {"mass": ["angle"]}
    with pytest.raises(RuntimeError, match="not stable with respect to waves"):
        tj.dispersion(cell, wave, about=about, fixed=fixed)
    found = tj.dispersion(cell, wave, about=about, fixed=fixed, throw=False)
    assert np.all(np.isnan(found.frequencies[:, 0]) & ~np.isnan(found.frequencies[:, 1]))


def test_states_that_are_not_periodic_are_refused():
    cell = tj.lattices.rotating_squares(
        JOINT, pitch=PITCH, angle=0.3, mass=MASS
    )  # fmt: skip
    poses = np.array(cell.mechanism().reference)
    poses[0, 0] += 0.01
    with pytest.raises(ValueError, match="is violated by"):
        tj.dispersion(cell, [[1.0, 0.0]], about=poses)


def test_dispersions_are_tables():
    cell = row_of_masses(mass=MASS, inertia=INERTIA)
    found = tj.dispersion(cell, cell.wave_vectors([(0.1,), (0.5,)], 2), modes=2)
    assert repr(found).startswith(
        "successful: 2 waves for each of 3 wave vectors\nband 1"
    )
    table = found.to_xarray()
    assert table["frequency"].dims == ("wave", "mode")
    assert table["shape_x"].shape == (3, 2, 1)


def test_waves_in_both_states_of_a_bistable_chain_have_the_closed_form(validated):
    """The stiffness in both states is 32 barrier / distance^2."""
    distance, barrier, link = 5e-3, 1e-3, 80.0
    cell = tj.lattices.bistable_chain(
        tj.Quadratic(np.diag([1.0, link, 1.0])),
        pitch=PITCH, distance=distance, barrier=barrier, mass=MASS,
    )  # fmt: skip
    fixed = {"ground": ["angle", "x", "y"], "mass": ["angle", "y"]}
    waves = cell.wave_vectors([(0.0,), (0.5,)], 4)
    sines = np.sin(waves[:, 0] * PITCH / 2) ** 2
    expected = np.sqrt((32 * barrier / distance**2 + 4 * link * sines) / MASS)
    switched = np.array(cell.mechanism().reference)
    switched[[0, 2], 1] += distance
    for about in (None, switched):
        found = tj.dispersion(cell, waves, fixed=fixed, about=about).frequencies[:, 0]
        computed = 2 * np.pi * np.asarray(found)
        assert_close(computed / expected, np.ones(5), digits=9)
    name = "waves in the second state of a bistable chain"
    validated("Vibrations and waves", name, computed, expected, "the closed form")
    spring = cell.hinges[0].energy
    assert_close(spring([0.0, distance / 2, 0.0]) / barrier, 1.0)


def test_corners_of_kagome_triangles_coincide_and_the_lattice_is_just_rigid():
    """Without stiffness against rotation, a periodic cell has two free translations."""
    joint = tj.Quadratic(np.diag([0.0, 1e3, 1e3]))
    cell = tj.lattices.kagome(joint, side=PITCH, mass=MASS)
    lattice = tj.lattices.repeat(cell, (4, 3))
    mechanism = tj.Mechanism(lattice.bodies, lattice.hinges)
    outlines = (
        np.array(list(mechanism.outlines)) + np.asarray(mechanism.reference)[:, None, 1:]
    )
    ends = np.array(mechanism.hinge_assembly.ends)
    for joint_at, pair in zip(np.asarray(mechanism.at), ends, strict=True):
        distances = np.linalg.norm(outlines[pair] - joint_at[1:], axis=-1)
        assert np.all(distances.min(axis=1) < 1e-12)
    zero, inside = (
        np.asarray(tj.dispersion(cell, waves).frequencies[0])
        for waves in ([[0.0, 0.0]], [[9.0, 4.0]])
    )
    assert np.sum(zero < 1e-6 * zero.max()) == 3  # and the rotation of all triangles
    assert np.sum(inside < 1e-6 * inside.max()) == 0


def test_a_leaf_far_from_a_copy_in_a_lattice_is_reported():
    """Its length and the outlines of its bodies are known."""
    squares = tj.lattices.repeat(
        tj.lattices.rotating_squares(JOINT, pitch=PITCH, angle=0.3), (2, 2)
    )
    wall = tj.Body("wall", outline=[(-1.0, -1.0), (5.0, -1.0), (5.0, -0.9), (-1.0, -0.9)])
    steel = tj.Material(210e9, 0.3)
    leaf = tj.flexures.linear_leaf(steel, length=0.02, thickness=1e-4, width=0.01)

    def build(y):
        hinge = tj.Hinge("leaf", "wall", "a[1, 0]", leaf, at=(np.pi / 2, 2 * PITCH, y))
        return tj.Mechanism([*squares.bodies, wall], [*squares.hinges, hinge], ["wall"])

    with pytest.warns(UserWarning, match="The start of the hinge 'leaf'"):
        build(3.0)
    with pytest.warns(UserWarning, match="is 0 m away from the outline of its first"):
        build(-0.895)  # at the wall
