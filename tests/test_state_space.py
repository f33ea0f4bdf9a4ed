"""State-space models against frequency responses, equilibria, and motions."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from helpers import with_value

import twistorjax as tj
from twistorjax.examples import stage


FREQUENCIES = np.array([0.0, 1.0, 30.0, 120.0, 400.0, 900.0, 3000.0, 1e5])
DRIVE = tj.Drive("6", x=1.0)
PUSH = tj.Load("4", force=(1.0, 0.0), moment=0.2)
FOLLOWER = tj.Load("4", force=(1.0, 0.0), follower=True)
STROKE = {"c": (0.0, 1.0, 0.0)}
OUTPUTS = {"output": ("4", "x"), "rotation": ("3", "angle"), "input": ("6", "x")}


@pytest.fixture(scope="module")
def mechanism():
    return stage.microstage(damping=1e-5)


def zeros_like(value):
    return jax.device_put(np.zeros(np.shape(value)))


def responses(mechanism, frequencies, inputs, outputs, **settings):
    """Return the frequency responses, computed one by one.

    All coordinates of the drives are prescribed; the inputs that are not considered are
    zero, so that all inputs use the same compiled program.
    """
    columns = []
    for given in inputs:
        now = [
            each if each is given else jax.tree.map(zeros_like, each) for each in inputs
        ]
        (strokes,) = [each for each in now if isinstance(each, dict)] or [{}]
        found = tj.frequency_response(
            mechanism,
            frequencies,
            drives=[each for each in now if isinstance(each, tj.Drive)],
            loads=[each for each in now if isinstance(each, tj.Load)],
            strokes=strokes,
            **settings,
        )
        rows = [
            np.asarray(found.displacement(body))[:, ("angle", "x", "y").index(name)]
            for body, name in outputs.values()
        ]
        columns.append(np.stack(rows, axis=1))
    return np.stack(columns, axis=2)


def response_of(model):
    return np.asarray(jax.jit(lambda: model.frequency_response(FREQUENCIES))())


def assert_same_response(model, expected):
    found = response_of(model)
    size = np.max(np.abs(expected), axis=(0, 1), keepdims=True)
    np.testing.assert_allclose(found / size, expected / size, atol=1e-9)


def test_all_modes_have_the_frequency_response(mechanism, validated):
    """The inputs are a displacement, a load, and a stroke with damping."""
    inputs = {"drive": DRIVE, "push": PUSH, "stroke": STROKE}
    model = tj.state_space(mechanism, inputs, OUTPUTS)
    assert model.a.shape == (24, 24) and model.inputs == tuple(inputs)
    expected = responses(mechanism, FREQUENCIES, inputs.values(), OUTPUTS)
    assert_same_response(model, expected)
    what = "state-space model of the stage, 8 frequencies"
    found = response_of(model)[:, 0, 0]
    reference = "harmonic equations, solved at each frequency"
    validated("Vibrations", what, np.abs(found), np.abs(expected[:, 0, 0]), reference)


@pytest.mark.slow
def test_three_modes_have_the_exact_static_gain(mechanism):
    inputs = {"drive": DRIVE, "push": PUSH}
    model = tj.state_space(mechanism, inputs, OUTPUTS, modes=3)
    assert model.a.shape == (6, 6)
    linear = tj.linearize(mechanism, {"6": ["x"]})
    for column, (drives, loads) in enumerate(
        (([DRIVE], []), ([tj.Drive("6", x=0.0)], [PUSH]))
    ):
        moved = linear(drives=drives, loads=loads)
        expected = [
            moved.displacement(body)[("angle", "x", "y").index(name)]
            for body, name in OUTPUTS.values()
        ]
        np.testing.assert_allclose(
            model.static_gain[:, column], expected, rtol=1e-9, atol=1e-15
        )
    # Below the first mode that was left out, the response is close to the exact one.
    frequencies = tj.vibrations(mechanism, {"6": ["x"]}).frequencies
    low = np.linspace(0.1, 1.5, 8) * float(frequencies[0])
    exact = responses(mechanism, low, [*inputs.values(), STROKE], OUTPUTS)[..., :2]
    size = np.max(np.abs(exact), axis=(0, 1), keepdims=True)
    error = np.abs(model.frequency_response(low) - exact) / size
    assert float(frequencies[3]) > 3 * low[-1] and np.max(error) < 1e-3


@pytest.mark.slow
def test_a_pin_transmits_the_inertia_of_a_prescribed_displacement():
    """The end of a lever is driven; a body on the lever follows with its mass."""
    leaf = tj.Quadratic(np.diag([2.0, 5e3, 4e3]))
    bodies = [
        tj.Body("base"),
        tj.Body("lever", (0.0, 0.1, 0.0), 0.3, 2e-3),
        tj.Body("block", (0.0, 0.3, 0.0), 0.2, 1e-4),
        tj.Body("slide", (0.0, 0.2, 0.0), 0.1, 1e-4),
    ]
    hinges = [
        tj.Hinge("one", "base", "lever", leaf, at=(0.0, 0.0, 0.0), damping=1e-4),
        tj.Hinge("two", "lever", "block", leaf, at=(0.0, 0.25, 0.0), damping=1e-4),
        tj.Hinge("three", "slide", "base", leaf, at=(0.0, 0.2, 0.1), damping=1e-4),
    ]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["base"])
    pin = tj.Pin("pin", "lever", "slide", at=(0.2, 0.0))
    drive = tj.Drive("slide", y=1.0)
    outputs = {"block": ("block", "y"), "lever": ("lever", "angle")}
    model = tj.state_space(mechanism, {"drive": drive}, outputs, constraints=[pin])
    expected = responses(mechanism, FREQUENCIES, [drive], outputs, constraints=[pin])
    assert_same_response(model, expected)


def loaded_block():
    """Return a damped block on a leaf that is bent by a load, and its equilibrium."""
    leaf = tj.Quadratic(np.diag([0.4, 6e4, 500.0]))
    bodies = [tj.Body("wall"), tj.Body("block", (0.0, 25e-3, 0.0), 0.5, 2e-4)]
    hinge = tj.Hinge("leaf", "wall", "block", leaf, at=(0, 0, 0), damping=1e-4)
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    weight = [tj.Load("block", force=(-3.0, 1.0))]
    return mechanism, weight, tj.equilibrium(mechanism, loads=weight)


@pytest.mark.slow
def test_the_step_response_about_a_loaded_equilibrium_is_the_motion():
    """The oracle is the difference of two motions under opposite additional loads."""
    mechanism, weight, about = loaded_block()
    times, small = np.linspace(0.0, 0.2, 41), 2e-3
    push = tj.Load("block", force=(0.0, 1.0))
    model = tj.state_space(
        mechanism, {"push": push}, {"y": ("block", "y")}, about=about, loads=weight
    )
    _, found = scipy.signal.step(model.to_scipy(), T=times)
    up, down = (
        tj.simulate(
            mechanism,
            times,
            loads=[*weight, tj.Load("block", force=(0.0, force))],
            start=about,
            tolerance=1e-12,
        ).displacement("block")[:, 2]
        for force in (small, -small)
    )
    expected = (np.asarray(up) - np.asarray(down)) / (2 * small)
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-6)


def test_a_base_that_moves_acts_as_an_inertial_force():
    """In the frame of the base, the acceleration is a force on each mass."""
    spring = tj.Quadratic(np.diag([2.0, 4e4, 900.0]))

    def block_on_base(*, fixed):
        bodies = [
            tj.Body("base", mass=3.0, inertia=0.1),
            tj.Body("block", (0.0, 0.2, 0.1), mass=0.7, inertia=2e-3),
        ]
        hinge = tj.Hinge(
            "spring", *("base", "block"), spring, (0.4, 0.1, 0), damping=1e-3
        )
        return tj.Mechanism(bodies, [hinge], fixed=fixed)

    output = {"y": ("block", "y")}
    moved = tj.state_space(
        block_on_base(fixed=[]),
        {"base": tj.Drive("base", y=1.0)},
        output,
        prescribed={"base": ["angle", "x"]},
    )
    push = {"force": tj.Load("block", force=(0.0, 0.7))}
    pushed = tj.state_space(block_on_base(fixed=["base"]), push, output)
    squares = (2 * np.pi * FREQUENCIES[:, None, None]) ** 2
    assert_same_response(moved, 1 + squares * response_of(pushed))


@pytest.mark.slow
def test_python_control_has_the_same_step_response():
    import control

    mechanism, weight, about = loaded_block()
    push = tj.Load("block", force=(0.0, 1.0))
    model = tj.state_space(
        mechanism, {"push": push}, {"y": ("block", "y")}, about=about, loads=weight
    )
    times = np.linspace(0.0, 0.2, 41)
    converted = model.to_control()
    assert converted.input_labels == ["push"] and converted.output_labels == ["y"]
    _, expected = scipy.signal.step(model.to_scipy(), T=times)
    found = control.step_response(converted, T=times).outputs
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9 * expected.max())


@pytest.mark.slow
def test_derivatives_and_batches():
    """The input is a displacement, and one of three modes is left out."""

    def gain(stiffness):
        leaf = tj.Quadratic(jnp.diag(jnp.stack([jnp.array(2.0), stiffness, stiffness])))
        spring = tj.Quadratic(np.diag([3.0, 2e3, 8e3]))
        bodies = [
            tj.Body("base"),
            tj.Body("slide", (0.0, 0.1, 0.0), 0.3, 2e-3),
            tj.Body("block", (0.0, 0.3, 0.1), 0.2, 1e-4),
        ]
        hinges = [
            tj.Hinge("leaf", "slide", "block", leaf, at=(0.4, 0.2, 0.0), damping=1e-4),
            tj.Hinge("spring", "block", "base", spring, at=(1.0, 0.3, 0.2)),
        ]
        fixed = {"base": ("angle", "x", "y"), "slide": ("angle", "y")}
        mechanism = tj.Mechanism(bodies, hinges, fixed)
        drive, output = tj.Drive("slide", x=1.0), {"block": ("block", "y")}
        model = tj.state_space(mechanism, {"drive": drive}, output, modes=2)
        response = jnp.abs(model.frequency_response([20.0])[0, 0, 0])
        return model.static_gain[0, 0], response

    at, step = jnp.array(5e3), 1.0
    differentiate = jax.jacfwd(with_value(gain), has_aux=True)
    derivatives, _ = differentiate(at)
    after, before = (differentiate(at + sign * step)[1] for sign in (1, -1))
    for k in range(2):
        difference = (after[k] - before[k]) / (2 * step)
        np.testing.assert_allclose(derivatives[k], difference, rtol=1e-5)
    batch = jax.vmap(gain)(jnp.stack([at, at + step]))
    np.testing.assert_allclose(batch[0][1], after[0], rtol=1e-9)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"inputs": {}}, "`inputs` is {}, but must be a mapping"),
        ({"outputs": ["4"]}, "`outputs` is .*'4'.*, but must be a mapping"),
        ({"inputs": {"f": tj.Load("9", moment=1.0)}}, "input 'f' names the body '9'"),
        ({"inputs": {"f": FOLLOWER}}, "The input 'f' is a follower load"),
        ({"modes": 1.5}, "`modes` is 1.5, but the mechanism has 12 modes"),
        ({"outputs": {"x": ("5x", "x")}}, "names the body '5x'"),
        ({"outputs": {"x": ("4", "z")}}, "names the coordinate 'z'"),
        ({"modes": 13}, "has 12 modes"),
        ({"loads": [tj.Load("4", force=(1.0, 0.0), follower=True)]}, "follower load"),
    ],
)
def test_errors(mechanism, arguments, message):
    given = {"inputs": {"drive": DRIVE}, "outputs": OUTPUTS, **arguments}
    with pytest.raises(ValueError, match=message):
        tj.state_space(mechanism, **given)


@pytest.mark.untyped
def test_inputs_and_outputs_of_wrong_types_are_reported(mechanism):
    with pytest.raises(ValueError, match="The input 'push' is a tuple, but must be"):
        wrong: Any = ("4", "x")
        tj.state_space(mechanism, {"push": wrong}, OUTPUTS)
    with pytest.raises(ValueError, match="The output 'x' is '4', but must be the name"):
        tj.state_space(mechanism, {"drive": DRIVE}, {"x": "4"})
