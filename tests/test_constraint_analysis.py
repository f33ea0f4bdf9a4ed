"""Motions that no stiff direction resists, and over-constraints, by name."""

import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import four_bar


UP = np.pi / 2
LEAF = tj.Quadratic(np.diag([1.0, 1e8, 1e4]))
PIVOT = tj.Quadratic(np.diag([1.0, 1e8, 1e8]))


def guide(*positions):
    """Return a table on vertical leaves at some positions along x."""
    hinges = [
        tj.Hinge(f"leaf {k}", "base", "table", LEAF, (UP, x, 0.0))
        for k, x in enumerate(positions)
    ]
    bodies = [tj.Body("base"), tj.Body("table", (0.2, 0.3, 0.4))]
    return tj.Mechanism(bodies, hinges, fixed=["base"])


def test_a_parallel_guide_moves_along_its_table():
    found = tj.constraint_analysis(guide(-0.1, 0.1))
    assert found.moving_bodies == (("table",),)
    assert_close(np.abs(found.motions[0, 1]) > 1e-9, [False, True, False])
    assert found.releases == ()


def test_a_doubled_leaf_is_an_over_constraint_of_these_two_leaves():
    found = tj.constraint_analysis(guide(-0.1, 0.1, 0.1))
    assert found.releases == (("axial force of 'leaf 1'", "axial force of 'leaf 2'"),)
    assert_close(np.sum(found.self_stresses), 0.0)
    assert len(found.motions) == 1
    assert "release one of axial force of 'leaf 1'" in repr(found)


def test_four_parallel_leaves_have_two_states_of_self_stress():
    """Their axial forces have no resultant."""
    positions = np.array([-0.2, -0.1, 0.1, 0.3])
    found = tj.constraint_analysis(guide(*positions))
    assert len(found.motions) == 1
    assert found.self_stresses.shape == (2, 4)
    np.testing.assert_allclose(np.sum(found.self_stresses, axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(found.self_stresses @ positions, 0.0, atol=1e-12)


def test_a_missing_hinge_is_a_motion_of_its_body():
    """Without its second leaf the table may rotate as well."""
    found = tj.constraint_analysis(guide(0.1))
    assert found.moving_bodies == (("table",), ("table",))
    # Each motion keeps the point at the leaf at its height.
    x = (0.1 - 0.3) / found.length
    heights = found.motions[:, 1, 2] + x * found.motions[:, 1, 0]
    np.testing.assert_allclose(heights, 0.0, atol=1e-12)


def test_the_intermediate_body_of_a_double_parallelogram_moves_alone():
    """It moves although the table is held."""
    bodies = [tj.Body(name) for name in ("base", "intermediate", "table")]
    hinges = [
        tj.Hinge(f"{first} {x}", first, "intermediate", LEAF, (UP, x, 0.0))
        for first, positions in (("base", (-0.2, 0.2)), ("table", (-0.1, 0.1)))
        for x in positions
    ]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["base"])
    free = tj.constraint_analysis(mechanism)
    assert len(free.motions) == 2
    held = tj.constraint_analysis(mechanism, prescribed={"table": ["x"]})
    assert held.moving_bodies == (("intermediate",),)
    assert held.releases == ()


def test_a_pinned_truss():
    """Maxwell's rule: a square of bars is a mechanism, and two diagonals are too many."""
    corners = {"a": (0.0, 0.0), "b": (1.0, 0.0), "c": (1.0, 1.0), "d": (0.0, 1.0)}
    bar = tj.Quadratic(np.diag([1.0, 1e8, 1.0]))

    def truss(*pairs):
        hinges = []
        for pair in pairs:
            start, end = (np.array(corners[name]) for name in pair)
            angle = np.arctan2(*(end - start)[::-1])
            at = (angle, *(start + end) / 2)
            hinges.append(tj.Hinge(pair, pair[0], pair[1], bar, at))
        bodies = [tj.Body(name, (0.0, *at)) for name, at in corners.items()]
        every = {name: ["angle"] for name in corners}
        fixed = {**every, "a": ["angle", "x", "y"], "b": ["angle", "x", "y"]}
        return tj.Mechanism(bodies, hinges, fixed=fixed)

    square = tj.constraint_analysis(truss("bc", "cd", "da"))
    assert square.moving_bodies == (("c", "d"),)
    braced = tj.constraint_analysis(truss("bc", "cd", "da", "ac"))
    assert (len(braced.motions), len(braced.self_stresses)) == (0, 0)
    crossed = tj.constraint_analysis(truss("bc", "cd", "da", "ac", "bd"))
    assert len(crossed.self_stresses) == 1
    assert len(crossed.releases[0]) == 5


def test_a_four_bar_linkage_on_pivots_has_one_motion():
    names = ("ground", "crank", "coupler", "rocker")
    points = [(0.0, 0.0), (0.1, 0.3), (0.5, 0.4), (0.4, 0.0)]
    hinges = [
        tj.Hinge(str(k), names[k], names[(k + 1) % 4], PIVOT, (0.0, *point))
        for k, point in enumerate(points)
    ]
    mechanism = tj.Mechanism([tj.Body(n) for n in names], hinges, fixed=["ground"])
    found = tj.constraint_analysis(mechanism)
    assert found.moving_bodies == (names[1:],)
    assert found.releases == ()
    # The angular velocities of crank and coupler are those of two rods that meet.
    crank, coupler, rocker = found.motions[0, 1:, 0]
    joint = np.array(points[2])
    by_crank = crank * (points[1] - np.array(points[0])) + coupler * (joint - points[1])
    np.testing.assert_allclose(by_crank, rocker * (joint - points[3]), atol=1e-12)


def test_constraints_are_rigid():
    linkage = four_bar.four_bar()
    found = tj.constraint_analysis(linkage)
    body = linkage.names[1]
    pin = tj.Pin("pin", linkage.names[0], body, at=np.asarray(linkage.reference)[1, 1:])
    pinned = tj.constraint_analysis(linkage, constraints=[pin])
    more = len(found.motions) - len(pinned.motions)
    more += len(pinned.self_stresses) - len(found.self_stresses)
    assert more == 2


def test_the_result_does_not_depend_on_the_unit_of_length():
    found = tj.constraint_analysis(guide(-0.1, 0.1, 0.1))
    hinges = [
        tj.Hinge(f"leaf {k}", "base", "table", tj.Quadratic(np.diag([1e6, 1e8, 1e4])),
                 (UP, x, 0.0))
        for k, x in enumerate((-100.0, 100.0, 100.0))
    ]  # fmt: skip
    bodies = [tj.Body("base"), tj.Body("table", (0.2, 300.0, 400.0))]
    large = tj.constraint_analysis(tj.Mechanism(bodies, hinges, fixed=["base"]))
    assert_close(found.motions, large.motions, digits=10)
    assert found.releases == large.releases


def test_an_invalid_ratio_is_reported():
    with pytest.raises(ValueError, match=r"`ratio` is 2\.0, but must be between 0 and 1"):
        tj.constraint_analysis(guide(0.0), ratio=2.0)


def test_a_failed_solve_names_the_bodies_that_nothing_holds():
    """A block that only a hinge without rotational stiffness holds, and a free pair."""
    pin = tj.Quadratic(np.diag([0.0, 1e6, 1e6]))
    hinges = [
        tj.Hinge("pin", "base", "lever", pin, (0.0, 0.1, 0.0)),
        tj.Hinge("weld", "lever", "tool", tj.Quadratic(np.eye(3)), (0.0, 0.3, 0.0)),
    ]
    bodies = [tj.Body("base"), tj.Body("lever"), tj.Body("tool")]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["base"])
    with pytest.raises(RuntimeError) as error:
        tj.equilibrium(mechanism)
    assert "Nothing resists the motion of 'lever', 'tool'" in str(error.value)
    held = tj.constraint_analysis(mechanism, prescribed={"lever": ["angle"]})
    assert not any("lever" in bodies for bodies in held.moving_bodies)


@pytest.mark.parametrize("offset", [0.0, 0.2e-3, 0.5e-3, 1e-3, 9.5e-3, 50e-3])
def test_the_freedom_of_a_pivot_does_not_depend_on_the_origin_of_its_body(offset):
    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=20e-3, thickness=0.2e-3, width=10e-3)
    bodies = [tj.Body("base"), tj.Body("mirror", (0.0, 0.0, offset))]
    hinges = [
        tj.Hinge(name, "base", "mirror", leaf, at=(angle, 0.0, 0.0))
        for name, angle in (("a", np.pi / 4), ("b", 3 * np.pi / 4))
    ]
    pivot = tj.Mechanism(bodies, hinges, fixed=["base"])
    found = tj.constraint_analysis(pivot)
    (motion,) = found.motions
    angle, x, y = motion[1]
    shift = found.length * np.array([x, y])  # m
    np.testing.assert_allclose(shift, [-offset * angle, 0.0], atol=1e-12)
    assert len(found.self_stresses) == 0
    assert "mainly angle of 'mirror'" in str(found)
    spatial = tj.out_of_plane(pivot).constraint_analysis()
    assert (len(spatial.motions), len(spatial.self_stresses)) == (0, 1)
