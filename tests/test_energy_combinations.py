"""Optional properties of energies, inside of every sum, multiple, and validity range."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, mostly_slow
from saved_models import saved_mechanism

import twistorjax as tj
from twistorjax.energies.base import (
    AbstractEnergy,
    AbstractWrapper,
    out_of_range,
    parallel_terms,
    validation_error,
)
from twistorjax.energies.dilation import dilated
from twistorjax.geometry.twistors import Displacement


POSE = jnp.array([0.2, 1e-3, 0.05])
RATES = (jnp.array(0.3), jnp.array(0.02), jnp.array(-0.4))
STIFFNESS = np.diag([2.0, 300.0, 40.0])


class Quartic(AbstractEnergy):
    """User-defined energy with the one method that is required."""

    stiffness: jax.Array

    def stored_energy(self, displacement):
        lengths = displacement.angle**2 + displacement.x1**2 + displacement.x2**2
        return self.stiffness * (lengths + lengths**2)


class Renamed(AbstractWrapper):
    """User-defined wrapper that forwards no optional method."""

    energy: AbstractEnergy
    label: str = eqx.field(static=True)


def mixed():
    powers = [(2, 0, 0), (0, 2, 0), (0, 2, 1), (0, 0, 2)]
    return tj.energies.MixedEnergy([1.0, 6.0, 0.6, -5e-4], powers, length=1.0, force=1.0)


POLYNOMIAL = tj.energies.Polynomial(
    [0.5, 200.0, 30.0], [(2, 0, 0), (0, 2, 0), (0, 0, 2)], "twist"
)
SQUARES = tj.energies.SumOfSquares([[0.1, 0.7]], [(1, 0, 0), (0, 0, 1)], "twist")
ENERGIES = {
    "quadratic of the twist": tj.Quadratic(STIFFNESS, "twist"),
    "quadratic of the twistor": tj.Quadratic(STIFFNESS, "twistor"),
    "polynomial": POLYNOMIAL,
    "polynomial in other frames": tj.energies.Polynomial(
        [0.5, 200.0, 30.0], [(0, 2, 0, 0), (0, 0, 2, 0), (0, 0, 0, 2)], "twistor"
    ).change_frames(jnp.array([0.1, 0.2, 0.3]), jnp.array([0.1, 0.2, 0.3])),
    "rational": tj.energies.Rational(POLYNOMIAL, SQUARES),
    "mixed": mixed(),
    "point charges": tj.energies.PointCharges(
        [1e-6, -1e-6], [[0.0, 0.1], [0.3, 0.0]], [1e-6], [[0.5, 0.5]]
    ),
    "axial spring": tj.energies.AxialSpring(500.0, length=0.8),
    "stop": tj.energies.Stop("-y", gap=-0.4, stiffness=80.0, smoothing=0.1),
    "stop of the angle": tj.energies.Stop(
        "+angle", gap=-2.0, stiffness=3.0, smoothing=0.1
    ),
    "corner and edge": tj.energies.CornerContact(
        (0.1, 0.2), ((1.0, 0.7), (-1.0, 0.9)), stiffness=50.0, smoothing=0.1
    ),
    "user-defined": Quartic(jnp.array(3.0)),
}


def value(energy, pose=POSE):
    return energy.stored_energy(Displacement.from_pose(pose))


@eqx.filter_jit
def value_and_gradient(energy):
    return jax.value_and_grad(value, argnums=1)(energy, POSE)


def limited(energy, rotation=1.0):
    return tj.energies.WithValidityRange(energy, rotation, 1e9, [1e-3, 1e-3, 1e-3])


def combinations(energy):
    """Return different expressions whose value is the same energy."""
    zero = tj.Quadratic(np.zeros((3, 3)))
    return {
        "multiple": 0.5 * (2.0 * energy),
        "range": limited(energy),
        "multiple of a range": 0.5 * limited(2.0 * energy),
        "sum with zero": energy + zero,
        "sum of halves": 0.5 * energy + 0.5 * energy,
        "multiple of a sum": 2.0 * (0.25 * energy + 0.25 * energy),
        "range of a sum": limited(0.5 * energy + zero + 0.5 * energy),
        "user-defined wrapper": Renamed(energy, "leaf"),
        "range of a wrapper": limited(Renamed(2.0 * Renamed(0.5 * energy, "a"), "b")),
        "range of all of these": limited(
            0.5 * Renamed(0.5 * energy, "a") + zero + 0.75 * energy
        ),
    }


NAMES = list(combinations(tj.Quadratic(STIFFNESS)))
EACH_COMBINATION = pytest.mark.parametrize(
    ("energy", "name"),
    [
        pytest.param(
            energy,
            name,
            id=f"{name}-{label}",
            marks=[]
            if name == "range of all of these" or label == "mixed"
            else [pytest.mark.slow],
        )
        for label, energy in ENERGIES.items()
        for name in NAMES
    ],
)


@EACH_COMBINATION
def test_a_combination_has_the_same_energy_and_gradient(energy, name):
    found, gradient = value_and_gradient(combinations(energy)[name])
    expected, expected_gradient = value_and_gradient(energy)
    assert_close(found, expected)
    assert_close(gradient, expected_gradient)


@pytest.mark.parametrize("name", mostly_slow(NAMES[::-1]))
def test_a_combination_has_the_same_wrench(name):
    energy = ENERGIES["user-defined"]
    combined = combinations(energy)[name]
    assert_close(combined(POSE), energy(POSE))
    assert_close(combined.wrench(POSE), energy.wrench(POSE))


@eqx.filter_jit
def properties(energy, term, stress):
    """Return the properties of a term of an energy, with its share of the stress.

    They are its scale of translations, model for Newton's method, damping, and resisted
    rates.
    """
    at = Displacement.from_pose(POSE)
    found = {
        "scale": term.translation_scale(at),
        "model": value(term.newton_model(tuple(stress))),
        "rates": jnp.stack(term.resisted_rates(at, RATES)),
    }
    if not isinstance(energy, tj.energies.PointCharges):  # which are not in equilibrium
        damping = term.proportional_damping(jnp.array(0.1)).damping
        found["damping"] = damping
    return found


@EACH_COMBINATION
def test_the_terms_of_a_combination_keep_the_properties_of_the_energy(energy, name):
    """The stress, the model for Newton's method, and the damping are sums."""
    terms = parallel_terms(combinations(energy)[name])
    stress, (whole, _) = np.array([0.3, 2.5, -0.7]), value_and_gradient(energy)
    shares = [float(value_and_gradient(term)[0]) / float(whole) for term in terms]
    expected = properties(energy, energy, stress)
    sums = dict.fromkeys(expected.keys() - {"scale", "rates"}, 0.0)
    for term, share in zip(terms, shares, strict=True):
        if share == 0:
            continue  # the zero of the sum, or a validity range
        found = properties(energy, term, share * stress)
        assert_close(found["scale"], expected["scale"])
        assert_close(found["rates"], expected["rates"])
        sums = {key: total + np.asarray(found[key]) for key, total in sums.items()}
        assert term.resists_all_rates == energy.resists_all_rates
    assert_close(sum(shares), 1.0)
    for key, total in sums.items():
        assert_close(total, expected[key])


@EACH_COMBINATION
def test_the_validity_range_is_that_of_the_energy_and_of_the_combination(energy, name):
    """A twist is undefined at a full rotation; a range of 1 rad is exceeded earlier."""
    combined = combinations(energy)[name]

    @jax.jit
    def outside(rotation):
        at = Displacement.from_pose(jnp.array([rotation, 0.0, 0.0]))
        exceeded = out_of_range(combined, at), out_of_range(energy, at)
        return [False if flag is None else flag for flag in exceeded]

    for rotation in (0.5, 1.5, 7.0):
        found, expected = outside(rotation)
        assert found == (expected | ("range" in name and rotation > 1.0))


def test_the_length_of_a_flexure_is_that_of_its_combinations():
    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=0.05, thickness=0.5e-3, width=0.01)
    for combined in (2 * leaf, leaf / 2, leaf + leaf, tj.Quadratic(STIFFNESS) + leaf):
        assert combined.flexure_length == 0.05
    assert (2 * tj.Quadratic(STIFFNESS)).flexure_length is None


class Assembled(tj.AbstractEnergy):
    """The sum of energies in a container."""

    parts: dict[str, tj.AbstractEnergy]

    def stored_energy(self, displacement):
        energies = [part.stored_energy(displacement) for part in self.parts.values()]
        return jnp.sum(jnp.stack(energies))


def test_energies_in_a_container_are_dilated_and_keep_their_ranges():
    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=0.05, thickness=0.5e-3, width=0.01)
    pair = Assembled({"first": leaf, "second": leaf})
    small, large = (np.array([0.01, -2e-6, 2e-4]) * [1, scale, scale] for scale in (1, 2))
    grown = dilated(pair, jnp.array(2.0))
    assert_close(value(grown, jnp.array(large)), 8 * value(pair, jnp.array(small)))
    far = Displacement.from_pose(jnp.array([2.0, 0.0, 0.0]))
    assert bool(out_of_range(pair, far))


def saved_energies():
    """Return all energies that files may contain."""
    mechanism = saved_mechanism(6)
    assembly = mechanism.hinge_assembly
    return [assembly.energy_of(k) for k in range(len(mechanism.hinge_names))]


# The outlines of the saved models are those of no real body.
@pytest.mark.filterwarnings("ignore:The mass of the body")
def test_the_energy_of_a_larger_hinge_grows_with_its_volume():
    """At the same strains. An energy of unknown dimensions stays as it is."""
    small, large = jnp.array([0.05, 1e-4, 1e-3]), jnp.array([0.05, 2e-4, 2e-3])
    changed = set()
    for energy in [*ENERGIES.values(), *saved_energies()]:
        grown = dilated(energy, jnp.array(2.0))
        if grown is not energy:
            changed.add(type(energy).__name__)
            assert_close(value(grown, large), 8 * value(energy, small))
    assert changed >= {"AxialSpring", "BeamColumn", "MixedEnergy", "Quadratic"}


def test_an_invalid_value_is_found_at_any_depth():
    wrong = -1.0 * tj.Quadratic(STIFFNESS)
    for combined in combinations(wrong).values():
        error = validation_error(combined)
        assert error is not None and "not negative" in error
    for combined in combinations(tj.Quadratic(STIFFNESS)).values():
        assert validation_error(combined) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["range of all of these", "range of a wrapper", "range of a sum"]
)
def test_a_combination_takes_as_many_newton_steps_as_the_energy(name):
    """The flexure is thin, so this requires its model for Newton's method."""

    def steps(energy):
        hinge = tj.Hinge("flexure", "wall", "tip", energy, at=(0.0, 0.0, 0.0))
        mechanism = tj.Mechanism([tj.Body("wall"), tj.Body("tip")], [hinge], ["wall"])
        load = tj.Load("tip", force=(0.0, 2.0))
        return int(tj.equilibrium(mechanism, loads=[load]).steps)

    assert steps(combinations(mixed())[name]) == steps(mixed())
