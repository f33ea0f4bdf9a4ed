"""Equilibrium paths of leaves in segments: a column, and a bistable curved beam."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
import scipy.special
from test_chain import deep_arch

import twistorjax as tj


class TestColumn:
    """A slender cantilever of 20 surrogates under an axial force at its end."""

    @pytest.fixture(scope="class")
    @classmethod
    def euler(cls):
        """Buckling load of the column (N), and the column of unit length."""
        steel = tj.Material(modulus=210e9, poisson=0.3)
        leaf = tj.flexures.Beam(steel, length=1.0, thickness=1e-3, width=10e-3)
        load = np.pi**2 / 4 * float(leaf.rotational_stiffness)
        chain = tj.flexures.chain(
            "leaf", leaf, "wall", "end", at=(np.pi / 2, 0.0, 0.5), rotation=2.2,
            force=5 * load, segments=20,
        )  # fmt: skip
        bodies = [tj.Body("wall"), tj.Body("end", pose=(np.pi / 2, 0.0, 1.0))]
        column = tj.Mechanism([*bodies, *chain.bodies], chain.hinges, fixed=["wall"])
        return load, column

    @pytest.mark.slow
    def test_both_buckled_sides_are_the_elastica(self, euler, validated):
        load, column = euler
        press = [tj.Load("end", force=(0.0, -load))]
        # One condition and one number of points for all paths, which share a program.
        settings: dict[str, Any] = {
            "until": lambda point: abs(point.displacement("end")[0]) - 2.0,
            "max_points": 64,
        }
        straight = tj.path(column, loads=press, load_factors=(0.0, 1.2), **settings)
        first = straight.critical_points[0]
        assert first.kind == "branch"
        # A column is shortened by the load, and the buckling load grows by this strain.
        np.testing.assert_allclose(first.load_factor, 1.0, rtol=1e-5)
        for side in (1, -1):
            buckled = tj.path(
                column, loads=press, start=first, direction=side,
                load_factors=(0.0, 4.0), largest_step=0.3, **settings,
            )  # fmt: skip
            assert len(buckled.load_factors) < 64
            assert buckled.stable[1:].all()
            rotation, x, y = np.asarray(buckled.displacement("end"))[5:].T
            modulus = np.sin(np.abs(rotation) / 2) ** 2
            complete = scipy.special.ellipk(modulus)
            exact = (2 * complete / np.pi) ** 2
            np.testing.assert_allclose(buckled.load_factors[5:], exact, rtol=1e-5)
            down = 2 - 2 * scipy.special.ellipe(modulus) / complete
            np.testing.assert_allclose(-y, down, rtol=1e-4, atol=1e-5)
            sideways = 2 * np.sqrt(modulus) / complete
            np.testing.assert_allclose(np.abs(x), sideways, rtol=1e-4)
            found, oracle = (
                buckled.load_factors[5:],
                "the elastica, by elliptic integrals",
            )
            what = "load of a buckled column of 20 surrogates"
            validated("Equilibrium paths", what, found, exact, oracle)
            assert np.ptp(np.sign(x)) == 0 and np.sign(x[0]) == -np.sign(rotation[0])


RISE, LENGTH, THICKNESS, WIDTH = 3e-3, 0.1, 0.5e-3, 10e-3


def half_of_a_curved_beam(rise, rotation, force):
    """Half of the beam y = h / 2 (1 - cos(2 pi x / L)), clamped, with a guided middle.

    Its eight segments are valid up to a rotation (rad) and a force (N).
    """

    @jax.tree_util.Partial
    def curvature(position):
        wave = 2 * jnp.pi / LENGTH
        return rise / 2 * wave**2 * jnp.cos(wave * (position + LENGTH / 4))

    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.Beam(
        steel, length=LENGTH / 2, thickness=THICKNESS, width=WIDTH, curvature=curvature
    )
    slope = np.arctan(np.pi * rise / LENGTH)
    chain = tj.flexures.chain(
        "beam", leaf, "wall", "shuttle", at=(slope, LENGTH / 4, rise / 2),
        rotation=rotation, force=force, segments=8, error=2e-3,
    )  # fmt: skip
    shuttle = tj.Body("shuttle", pose=(0.0, LENGTH / 2, rise))
    fixed = {"wall": ["angle", "x", "y"], "shuttle": ["angle", "x"]}
    bodies = [tj.Body("wall"), shuttle, *chain.bodies]
    return tj.Mechanism(bodies, chain.hinges, fixed=fixed)


@pytest.mark.release
class TestCurvedBeam:
    """Half of a clamped cosine beam with a guided middle, and h / t = 6.

    Qiu, Lang and Slocum, A curved-beam bistable mechanism, J. MEMS 13, 2004. The second
    mode is suppressed by the guide. The force is that of the whole beam in units of
    E I h / L^3, and the displacement is in units of h.
    """

    UNIT = 210e9 * WIDTH * THICKNESS**3 / 12 * RISE / LENGTH**3

    @pytest.fixture(scope="class")
    @classmethod
    def half(cls):
        return half_of_a_curved_beam(RISE, rotation=0.6, force=1750.0)

    @staticmethod
    def force_on_the_branch(displacement):
        """Linear theory under the axial load of the third mode, with all modes.

        The mode 1 - cos(N x / L) with N = 2 pi, 6 pi, 10 pi, ... has the bending
        stiffness N^4 / 2 and the axial load reduces it by 16 pi^2 N^2 / 2. The closed
        form of the paper has the first mode only.
        """
        waves = (4 * np.arange(50) + 2) * np.pi
        compliances = 8 / (waves**4 - 16 * np.pi**2 * waves**2)
        return (4 / 3 - displacement) / -np.sum(compliances)

    def test_the_force_falls_on_a_line_and_the_beam_is_bistable(self, half):
        down = [tj.Drive("shuttle", y=-2.2 * RISE)]
        before = tj.path(half, drives=down, load_factors=(0.0, 0.12), max_points=64)
        first = before.critical_points[0]
        assert first.kind == "branch"  # to the third mode
        found = tj.path(
            half, drives=down, load_factors=(0.0, 1.0), start=first, largest_step=0.2,
            until=lambda point: -point.displacement("shuttle")[2] / RISE - 1.7,
        )  # fmt: skip
        displacement = -np.asarray(found.displacement("shuttle")[:, 2]) / RISE
        force = -2 * np.asarray(found.reaction("shuttle")[:, 2]) / self.UNIT
        on_line = (displacement > 0.25) & (displacement < 1.7)
        exact = self.force_on_the_branch(displacement)
        error = np.abs(force - exact)[on_line]
        assert np.max(error) < 0.02 * np.max(exact)
        zero = np.interp(0.0, -force, displacement)
        np.testing.assert_allclose(zero, 4 / 3, rtol=0.01)
        assert np.min(force) < -0.3 * np.max(force)  # It stays on the other side.
        np.testing.assert_allclose(
            force[0], self.force_on_the_branch(displacement[0]), rtol=0.02
        )


@pytest.mark.release
@pytest.mark.parametrize(("ratio", "bistable"), [(2.26, False), (2.36, True)])
def test_the_rise_above_which_a_guided_beam_is_bistable(ratio, bistable):
    """Without the antisymmetric mode, it is h / t = sqrt(16 / 3) = 2.31.

    All modes but the first one vanish where the force is zero, so the limit is exact for
    a shallow beam.
    """
    rise = ratio * THICKNESS
    beam = half_of_a_curved_beam(rise, rotation=0.3, force=1500.0)
    found = tj.path(
        beam, drives=[tj.Drive("shuttle", y=-2.0 * rise)], load_factors=(0.0, 0.9),
        largest_step=0.05,
    )  # fmt: skip
    force = -np.asarray(found.reaction("shuttle"))[:, 2]
    assert np.max(force) > 0 and (np.min(force[1:]) < 0) == bistable


@pytest.mark.release
class TestFrameOfLee:
    """A column and a beam of 1.2 m in segments, joined rigidly, with pinned ends."""

    MODULUS, WIDTH, THICKNESS = 7.2e9, 0.03, 0.02

    @pytest.fixture(scope="class")
    @classmethod
    def frame(cls):
        metal = tj.Material(modulus=cls.MODULUS, poisson=0.3)
        poses = {
            "foot": (0.0, 0.0, 0.0),
            "corner": (0.0, 0.0, 1.2),
            "load": (0.0, 0.24, 1.2),
            "end": (0.0, 1.2, 1.2),
        }
        bodies = [tj.Body(name, pose) for name, pose in poses.items()]
        hinges = []
        for length, first, second, at, rotation, segments in (
            (1.2, "foot", "corner", (np.pi / 2, 0.0, 0.6), 3.0, 6),
            (0.24, "corner", "load", (0.0, 0.12, 1.2), 1.0, 2),
            (0.96, "load", "end", (0.0, 0.72, 1.2), 3.0, 6),
        ):
            leaf = tj.flexures.Beam(
                metal, length=length, thickness=cls.THICKNESS, width=cls.WIDTH,
                shear_factor=1e6, steps=8,
            )  # fmt: skip
            part = tj.flexures.chain(
                f"{first} to {second}", leaf, first, second, at, rotation=rotation,
                force=2500.0, segments=segments, error=1e-2,
            )  # fmt: skip
            bodies += part.bodies
            hinges += part.hinges
        pinned = {"foot": ("x", "y"), "end": ("x", "y")}
        return tj.Mechanism(bodies, hinges, fixed=pinned)

    def shoot(self, rotation, unknowns):
        """Integrate extensible beams from the foot: misfit at the end, descent of load.

        The unknowns are the force at the foot and the load, in kN.
        """
        bending = self.MODULUS * self.WIDTH * self.THICKNESS**3 / 12
        axial = self.MODULUS * self.WIDTH * self.THICKNESS
        *force, load = 1e3 * np.asarray(unknowns)

        def leg(state, force, length):
            def rates(_, state):
                _, _, angle, moment = state
                along = np.array([np.cos(angle), np.sin(angle)])
                dx, dy = (1 + along @ force / axial) * along
                return [dx, dy, moment / bending, dy * force[0] - dx * force[1]]

            options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12}
            found = scipy.integrate.solve_ivp(rates, (0, length), state, **options)
            return found.y[:, -1]

        state = leg(np.array([0.0, 0.0, np.pi / 2 + rotation, 0.0]), force, 1.2)
        state = leg(state - np.array([0.0, 0.0, np.pi / 2, 0.0]), force, 0.24)
        down = 1.2 - state[1]
        state = leg(state, [force[0], force[1] + load], 0.96)
        return np.array([state[0] - 1.2, state[1] - 1.2, state[3] / 100]), down

    def extremum(self, found, index, load, quantity):
        """Extremum of the load (N) or of the descent (m), by three rotations of the foot.

        The guess is the critical point of the path with this index.
        """
        points = found.critical_points
        foot = float(points[index].displacement("foot")[0])
        reaction = found.reaction("foot")[int(points.rows[index]), 1:]
        guess = np.append(-np.asarray(reaction), load) / 1e3
        rotations, rows = foot + np.array([-0.01, 0.0, 0.01]), []
        for rotation in rotations:
            solution = scipy.optimize.root(
                lambda z, at=rotation: self.shoot(at, z)[0], guess, tol=1e-12
            ).x
            rows.append((1e3 * solution[2], self.shoot(rotation, solution)[1]))
        curved = np.polyfit(rotations - foot, np.array(rows)[:, quantity], 2)
        return curved[2] - curved[1] ** 2 / 4 / curved[0]

    def test_limit_loads_and_snap_back_of_the_load(self, frame):
        """The published first limit load is 1855.67 N at 0.48735 m."""
        push = tj.Load("load", force=(0.0, -3000.0))
        found = tj.path(frame, loads=[push], throw=False, largest_step=0.2)
        loads = 3000 * np.asarray(found.critical_points.load_factors)
        np.testing.assert_allclose(loads[0], 1855.67, rtol=1e-5)
        first = found.critical_points[0].displacement("load")
        np.testing.assert_allclose(first[2], -0.48735, rtol=2e-5)
        exact = [self.extremum(found, k, loads[k], 0) for k in range(2)]
        np.testing.assert_allclose(loads[:2], exact, rtol=3e-5)
        # The displacement of the load turns back twice, where a prescribed one snaps.
        down = [tj.Drive("load", y=-1.0)]
        found = tj.path(frame, drives=down, load_factors=(0.0, 0.7), largest_step=0.2)
        rows = np.asarray(found.critical_points.rows)
        forces = -np.asarray(found.reaction("load"))[rows, 2]
        exact = [self.extremum(found, k, forces[k], 1) for k in range(2)]
        turns = found.critical_points.load_factors
        np.testing.assert_allclose(turns, exact, rtol=1e-5)


@pytest.mark.filterwarnings("ignore:`length` is 187")  # as published
@pytest.mark.release
def test_the_critical_load_of_a_deep_arch():
    """The published value is 897."""
    push = tj.Load("crown", force=(0.0, -1000.0))
    found = tj.path(deep_arch(force=700.0), loads=[push], throw=False)
    first = found.critical_points[0]
    assert first.kind == "limit"
    np.testing.assert_allclose(1000 * first.load_factor, 897.0, rtol=2e-3)
