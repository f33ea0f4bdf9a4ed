"""Vibrations and frequency response against reference values and closed forms."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.linalg
from helpers import assert_close
from motion_helpers import oscillator

import twistorjax as tj
from twistorjax.examples import four_bar, stage


# Natural frequencies from another program, which computes with 50 digits; Hz
STAGE = [
    306.1366849, 4719.7317869, 6302.6505985, 9474.0135068, 12316.9615762, 14874.9283712,
]  # fmt: skip
FOUR_BAR = [
    36.3871815, 568.9155405, 681.1718392, 1230.3478384, 1300.4124816, 3078.9487182,
    3578.5604614, 7433.2397532, 9639.3729878,
]  # fmt: skip


def test_frequencies_of_stage_and_linkage_agree_with_the_reference(validated):
    fixed_input = tj.vibrations(stage.microstage(), {"6": ["x"]})
    frequencies = np.asarray(fixed_input.frequencies)[:6]
    np.testing.assert_allclose(frequencies, STAGE, rtol=1e-7)
    linkage = tj.vibrations(four_bar.four_bar())
    np.testing.assert_allclose(linkage.frequencies, FOUR_BAR, rtol=1e-7)
    oracle = "an independent derivation, by LAPACK"
    validated("The stage", "six natural frequencies", frequencies, STAGE, oracle)
    what = "nine natural frequencies"
    validated("Four-bar linkages", what, linkage.frequencies, FOUR_BAR, oracle)
    assert repr(linkage).startswith("successful: 9 vibrations")


def test_mode_shapes_are_orthonormal_with_respect_to_inertia():
    linkage = four_bar.four_bar()
    shapes = np.asarray(tj.vibrations(linkage).shapes)
    inertia = np.asarray(linkage.inertia())
    weighted = np.where(np.isinf(inertia), 0.0, inertia)[None] * shapes
    assert_close(np.einsum("ibk,jbk->ij", weighted, shapes), np.eye(9), digits=9)


def column(force, stiffness=2.0):
    """Return a rigid rod on a torsion hinge and a load that presses on its upper end."""
    spring = tj.Quadratic(np.diag([stiffness, 1e7, 1e7]))
    hinge = tj.Hinge("h", "base", "rod", spring, (0, 0, 0))
    rod = tj.Body("rod", pose=(0, 0, 0.5), mass=1e-4, inertia=0.3)
    mechanism = tj.Mechanism([tj.Body("base"), rod], [hinge], ["base"])
    return mechanism, [tj.Load("rod", force=(0, -force), at=(0, 0.5))]


def test_compression_lowers_the_frequency_of_a_column():
    """I w^2 = k - P L, with the inertia I about the hinge."""

    def frequency(force):
        mechanism, loads = column(force)
        about = tj.equilibrium(mechanism, loads=loads, throw=False)
        found = tj.vibrations(mechanism, about=about, loads=loads, throw=False)
        return found.frequencies[0]

    inertia = 0.3 + 1e-4 * 0.5**2
    expected = np.sqrt((2.0 - 1.2) / inertia) / (2 * np.pi)
    value, derivative = jax.jit(jax.value_and_grad(frequency))(1.2)
    np.testing.assert_allclose(value, expected, rtol=1e-5)
    np.testing.assert_allclose(derivative, -expected / (2 * (2.0 - 1.2)), rtol=1e-5)


def test_unstable_equilibrium_has_no_vibrations():
    mechanism, loads = column(2.1)
    compressed = np.asarray(mechanism.reference) - [[0, 0, 0], [0, 0, 2.1 / 1e7]]
    with pytest.raises(RuntimeError, match="without an increase of the energy"):
        tj.vibrations(mechanism, about=compressed, loads=loads)
    result = tj.vibrations(mechanism, about=compressed, loads=loads, throw=False)
    assert not result.succeeded and np.isnan(np.asarray(result.frequencies)[0])


@pytest.mark.parametrize("pinned", [False, True], ids=["springs", "pin"])
@pytest.mark.parametrize("force", [0.5, 1.0 + 1e-6, 1.5])
def test_an_instability_is_found_however_slow_it_is(pinned, force):
    """A rod on a torsion spring of 1 N m/rad, pressed at 1 m, beside modes at 5 MHz."""
    stiff = 0.0 if pinned else 1e15
    spring = tj.Quadratic(np.diag([1.0, stiff, stiff]))
    bodies = [tj.Body("wall"), tj.Body("rod", (0, 0, 0.4), mass=1.0, inertia=1.0)]
    hinges = [tj.Hinge("h", "wall", "rod", spring, (0, 0, 0))]
    pins = [tj.Pin("pin", "wall", "rod", at=(0, 0))] if pinned else []
    mechanism = tj.Mechanism(bodies, hinges, ["wall"])
    loads = [tj.Load("rod", force=(0.0, -force), at=(0.0, 0.6))]
    about = mechanism.reference
    if not pinned:
        about = tj.equilibrium(
            mechanism, drives=[tj.Drive("rod", angle=0.0)], loads=loads
        )
    found = tj.vibrations(
        mechanism, about=about, loads=loads, constraints=pins, throw=False
    )
    frequencies = np.asarray(found.frequencies)
    if force > 1:
        assert tj.result_names(found.result) == "unstable"
        assert np.isnan(frequencies[0])
        assert np.all(frequencies[1:] > 1e6)
    else:
        assert found.succeeded
        exact = np.sqrt((1.0 - force) / (1.0 + 0.4**2)) / (2 * np.pi)
        assert_close(frequencies[0] / exact, 1.0, digits=9)


def test_a_mechanism_that_floats_freely_is_not_unstable():
    spring = tj.Quadratic(np.diag([1e3, 1e12, 1e12]))
    bodies = [
        tj.Body(name, (0.3, x, -0.7), mass=1.0, inertia=0.1)
        for name, x in (("a", 0.2), ("b", 1.3))
    ]
    hinge = tj.Hinge("h", "a", "b", spring, (0.1, 0.6, -0.3))
    found = tj.vibrations(tj.Mechanism(bodies, [hinge]))
    frequencies = np.asarray(found.frequencies)
    assert np.all(frequencies[:3] < 1e-3) and frequencies[3] > 1


@pytest.mark.slow
def test_a_state_that_is_not_an_equilibrium_is_refused():
    """The loads of the state must be given, and its prescribed coordinates."""
    mechanism, loads = column(1.2)
    solution = tj.equilibrium(mechanism, loads=loads)
    small, output = tj.Load("rod", force=(1.0, 0.0)), {"x": ("rod", "x")}
    analyses = [
        lambda **state: tj.vibrations(mechanism, **state),
        lambda **state: tj.linearize(mechanism, **state),
        lambda **state: tj.state_space(mechanism, {"f": small}, output, **state),
        lambda loads=(), **state: tj.frequency_response(
            mechanism, [1.0], loads=[small], static_loads=loads, **state
        ),
    ]
    _, half = column(0.6)
    unbalanced = r"loads`: on the body 'rod', a force of {} N along y is not balanced"
    for analysis in analyses:
        analysis(about=solution, loads=loads)
        for force, state in (
            ("-1.2", {"loads": loads}),
            ("1.2", {"about": solution}),
            ("0.6", {"about": solution, "loads": half}),
        ):
            with pytest.raises(ValueError, match=unbalanced.format(force)):
                analysis(**state)
    turned = tj.equilibrium(mechanism, drives=[tj.Drive("rod", angle=0.1)])
    tj.vibrations(mechanism, {"rod": ["angle"]}, about=turned)
    with pytest.raises(ValueError, match=r"'rod', a moment of -0\.1997 N m is not"):
        tj.vibrations(mechanism, about=turned)

    @jax.vmap
    def in_batch(force):
        loads = [tj.Load("rod", force=(0.0, -force), at=(0.0, 0.5))]
        found = tj.vibrations(mechanism, about=solution, loads=loads, throw=False)
        return found.result

    names = tj.result_names(in_batch(jnp.array([1.2, 1.3])))
    assert names is not None and names.tolist() == ["successful", "not_finite"]


@pytest.mark.untyped
def test_prescribed_coordinates_that_are_not_names_are_reported():
    mechanism, _ = column(1.0)
    with pytest.raises(ValueError, match="`prescribed` is 5, but must be a list of na"):
        tj.vibrations(mechanism, 5)  # pyright: ignore
    with pytest.raises(ValueError, match="`prescribed` of the body 'rod' is 'x', but"):
        tj.linearize(mechanism, {"rod": "x"})


class Preloaded(tj.AbstractEnergy):
    """A spring that is loaded by 3 N in its reference configuration."""

    def stored_energy(self, displacement):
        angle, x, y = displacement.twist()
        return 50 * angle**2 + 500 * (x**2 + y**2) + 3 * x


def test_a_preloaded_hinge_is_not_linearized_where_it_is_no_equilibrium():
    bodies = [tj.Body("wall"), tj.Body("block", mass=1.0, inertia=0.1)]
    hinge = tj.Hinge("spring", "wall", "block", 2 * Preloaded(), at=(0, 0, 0))
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    for analysis in (tj.vibrations, tj.linearize):
        with pytest.raises(ValueError, match="a force of -6 N along x is not balanced"):
            analysis(mechanism)
    state = tj.equilibrium(mechanism)
    assert_close(state.displacement("block"), [0.0, -0.003, 0.0], digits=12)
    squares = (2 * np.pi * tj.vibrations(mechanism, about=state).frequencies) ** 2
    stiffness = jax.hessian(2 * Preloaded())(state.displacement("block"))
    inertia = np.diag([0.1, 1.0, 1.0])
    assert_close(squares, scipy.linalg.eigvalsh(stiffness, inertia), digits=9)


def test_vibrations_with_follower_loads_are_an_error():
    mechanism, _ = column(1.0)
    follower = tj.Load("rod", force=(0, -1.0), follower=True)
    with pytest.raises(ValueError, match="follower load"):
        tj.vibrations(mechanism, loads=[follower])


@pytest.mark.untyped
@pytest.mark.parametrize("analysis", [tj.vibrations, tj.buckling, tj.linearize])
def test_one_load_instead_of_a_list_is_an_error(analysis):
    mechanism, _ = column(1.0)
    load = tj.Load("rod", force=(0, -1.0))
    with pytest.raises(ValueError, match="`loads` is one Load: put it in a list"):
        analysis(mechanism, loads=load)


def test_response_to_a_load_is_that_of_a_damped_oscillator():
    time = 0.02
    frequencies = np.array([0.0, 0.5, 0.8, 3.0])
    load = tj.Load("block", force=(1.0, 0))
    response = tj.frequency_response(oscillator(time), frequencies, loads=[load])
    assert repr(response) == "successful: 4 frequencies, 0 to 3 Hz"
    omega = 2 * np.pi * frequencies
    expected = 1 / (50 - 2 * omega**2 + 1j * omega * time * 50)
    displacement = np.asarray(response.displacement("block"))[:, 1]
    assert_close(displacement, expected, digits=12)
    reaction = -expected * 50 * (1 + 1j * omega * time)
    assert_close(np.asarray(response.reaction("wall"))[:, 1], reaction)


def test_reaction_of_a_harmonic_drive_is_the_dynamic_stiffness():
    omega = 2 * np.pi * 0.5
    drives = [tj.Drive("block", y=1e-3)]
    response = tj.frequency_response(oscillator(0.02), [0.5], drives=drives)
    expected = 1e-3 * (80 - 2 * omega**2 + 1j * omega * 0.02 * 80)
    assert_close(np.asarray(response.reaction("block"))[0, 2], expected)


def test_response_at_an_undamped_resonance_is_an_error():
    resonance = float(np.asarray(tj.vibrations(oscillator()).frequencies)[1])
    load = tj.Load("block", force=(1.0, 1.0))
    with pytest.raises(RuntimeError, match="a resonance without damping"):
        tj.frequency_response(oscillator(), [1.0, resonance], loads=[load])
    assert tj.frequency_response(oscillator(0.1), [resonance], loads=[load]).succeeded


@pytest.mark.untyped
def test_frequencies_must_be_a_row():
    with pytest.raises(ValueError, match="must be a list or a"):
        tj.frequency_response(oscillator(0.1), 3.0)


def exact_frequencies(origins, hinges, inertia, additional):
    """Compute frequencies of bodies on hinges with 60 digits.

    Args:
        origins: Positions of the origins of the bodies; m.
        hinges: For each hinge, its two bodies, where -1 is the ground; its stiffness; and
            its frame.
        inertia: Inertia of each coordinate.
        additional: Stiffness that is added to that of the hinges.

    Returns:
        Natural frequencies, the smallest first; Hz.
    """
    with mpmath.workdps(60):
        size = 3 * len(origins)
        total = mpmath.matrix(additional.tolist())
        for ends, stiffness, (angle, x, y) in hinges:
            cos, sin = mpmath.cos(angle), mpmath.sin(angle)
            strain = mpmath.zeros(3, size)
            for body, sign in zip(ends, (-1, 1), strict=True):
                if body < 0:
                    continue
                arm = mpmath.mpf(x) - origins[body][0], mpmath.mpf(y) - origins[body][1]
                # Displacement of the hinge by each coordinate of the body.
                translations = (-arm[1], arm[0]), (1, 0), (0, 1)
                for k, (dx, dy) in enumerate(translations):
                    strain[0, 3 * body + k] += sign * (k == 0)
                    strain[1, 3 * body + k] += sign * (cos * dx + sin * dy)
                    strain[2, 3 * body + k] += sign * (cos * dy - sin * dx)
            total += strain.T * mpmath.matrix(stiffness.tolist()) * strain
        root = mpmath.diag([1 / mpmath.sqrt(value) for value in inertia])
        squares = mpmath.eigsy(root * total * root, eigvals_only=True)
        return np.array([float(mpmath.sqrt(s) / (2 * mpmath.pi)) for s in squares])


@pytest.mark.parametrize("loaded", [False, True])
def test_small_frequencies_beside_large_ones_are_accurate(loaded):
    """Stiffnesses differ by 1e16, so an assembled matrix does not contain the small ones.

    The load acts at a distance from the origin of its body. Its stiffness is force times
    distance, also if the mechanism is not displaced.
    """
    origins = [(0.3, -0.2), (1.1, 0.4)]
    stiffness = np.diag([1.0, 1e16, 0.5])
    hinges = [
        ((-1, 0), stiffness, (0.3, -0.4, 0.7)),
        ((0, 1), stiffness, (-1.1, 0.6, 0.2)),
    ]
    masses, inertias = (2.0, 1.0), (0.5, 0.1)
    bodies = [tj.Body("wall")]
    for k, origin in enumerate(origins):
        pose = (0.0, *origin)
        bodies.append(tj.Body(str(k), pose, mass=masses[k], inertia=inertias[k]))
    energy = tj.Quadratic(stiffness)
    mechanism = tj.Mechanism(
        bodies,
        [
            tj.Hinge("first", "wall", "0", energy, hinges[0][2]),
            tj.Hinge("second", "0", "1", energy, hinges[1][2]),
        ],
        fixed=["wall"],
    )
    loads, additional = [], np.zeros((6, 6))
    if loaded:
        loads = [tj.Load("1", force=(0.2, 0.0), at=(1.5, 0.0))]
        additional[3, 3] = 0.2 * 1.5
    inertia = np.array([0.5, 2.0, 2.0, 0.1, 1.0, 1.0])
    expected = exact_frequencies(origins, hinges, inertia, additional)
    frequencies = tj.vibrations(mechanism, loads=loads).frequencies
    assert expected[0] < 1 < 1e6 < expected[-1]
    np.testing.assert_allclose(frequencies, expected, rtol=1e-12)


def block_on(spring):
    """Return a block of 1 kg and 0.1 kg m2 on a spring at its origin."""
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
    block = tj.Body("block", mass=1.0, inertia=0.1)
    return tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])


@pytest.mark.release
def test_sum_of_equal_frequencies_has_second_derivatives():
    """Three small changes are made to a spring with equal stiffness in x and y."""

    def frequencies(change):
        x, y, coupling = change
        stiffness = jnp.array(
            [[1e4, 0, 0], [0, 400 + x, coupling], [0, coupling, 400 + y]]
        )
        return tj.vibrations(block_on(tj.Quadratic(stiffness))).frequencies[:2]

    def total(change):
        return jnp.sum(frequencies(change))

    unchanged = jnp.zeros(3)
    first, second = frequencies(unchanged)
    assert_close(first, second)
    size = 0.1
    step = size * np.eye(3)
    signs = (1, 1), (1, -1), (-1, 1), (-1, -1)
    corners = [
        [s * step[a] + t * step[b] for s, t in signs] for a in range(3) for b in range(3)
    ]
    sums = jax.vmap(jax.vmap(total))(jnp.array(corners))
    differences = (sums[:, 0] - sums[:, 1] - sums[:, 2] + sums[:, 3]) / (4 * size**2)
    hessian = jax.jit(jax.hessian(total))(unchanged).reshape(-1)
    np.testing.assert_allclose(hessian, differences, rtol=1e-5, atol=1e-9)


@pytest.mark.release
def test_energies_that_are_not_positive_contribute_to_the_frequencies():
    """A coupling energy, which is indefinite, and a spring with negative stiffness."""
    spring = tj.Quadratic(jnp.diag(jnp.array([2.0, 50.0, 30.0])), "twist")
    coupling = tj.energies.Polynomial(
        [5.0, 3.0, 1e-9], [(1, 0, 1), (0, 1, 1), (2, 0, 0)], "twist"
    )
    negative = tj.energies.Polynomial([-4.0, 1e-12], [(0, 0, 2), (0, 2, 0)], "twist")
    energy = spring + coupling + negative
    hinge = tj.Hinge("h", "wall", "block", energy, at=(0.2, 0.1, 0.3))
    block = tj.Body("block", mass=2.0, inertia=0.1)
    mechanism = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
    stiffness = np.asarray(mechanism.stiffness(mechanism.reference))[1, :, 1]
    root = np.sqrt([0.1, 2.0, 2.0])
    squares = np.linalg.eigvalsh(stiffness / np.outer(root, root))
    expected = np.sqrt(squares) / (2 * np.pi)
    assert_close(tj.vibrations(mechanism).frequencies, expected)


def test_vibrations_need_a_free_coordinate():
    spring = tj.Quadratic(jnp.diag(jnp.array([1e4, 400.0, 100.0])))
    with pytest.raises(ValueError, match="No coordinate can vibrate"):
        tj.vibrations(block_on(spring), ["block"])
