"""Traces on disk: the results are those of a new trace, and no other trace is loaded."""

import enum
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.core import Tracer

import twistorjax as tj
from twistorjax._utils import compiled_gradient, stored_traces
from twistorjax._utils.canonical_text import canonical_text, NoCanonicalTextError


TIMES = [0.0, 0.02, 0.05]


@pytest.fixture
def folder(tmp_path):
    """Store traces in a folder of the test, and trace all functions anew."""
    jax.clear_caches()
    before = stored_traces._folder
    stored_traces.store_traces_in(tmp_path / "traces")
    yield tmp_path / "traces"
    stored_traces._folder = before


@pytest.fixture
def traced(monkeypatch):
    """Gather the names of the functions that are traced because they are not stored."""
    names = []
    trace = stored_traces._Trace.of

    def counted(function, *arguments):
        names.append(function.__name__)
        return trace(function, *arguments)

    monkeypatch.setattr(stored_traces._Trace, "of", counted)
    return names


def oscillator(stiffness=100.0, energy=tj.Quadratic, damping: float | None = 1e-3):
    """Return a mass on a spring, by default with damping."""
    spring = energy(jnp.diag(jnp.array([1.0, 1.0, 0.5]) * stiffness))
    settings = {"damping": damping, "expansion": tj.Expansion(1e-5, length=0.1)}
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0), **settings)
    bodies = [tj.Body("wall"), tj.Body("block", mass=0.1, inertia=0.01)]
    return tj.Mechanism(bodies, [hinge], fixed=["wall"])


def push(mechanism, force=1.0):
    return tj.equilibrium(mechanism, loads=[tj.Load("block", force=(force, 0.0))])


def shake(mechanism, force=1.0, **settings):
    settings = {
        "loads": [tj.Load("block", force=(force, 0.0))],
        "velocities": {"block": (0.0, 0.3, 0.1)},
        "tolerance": 1e-10,
        "energies": False,
    } | settings
    return tj.simulate(mechanism, TIMES, **settings)


def arrays(result):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(result) if eqx.is_array(leaf)]


def assert_same(result, other):
    assert jax.tree.structure(result) == jax.tree.structure(other)
    for value, expected in zip(arrays(result), arrays(other), strict=True):
        np.testing.assert_array_equal(value, expected)


def sum_of_squares(motion):
    return jnp.sum(motion.displacements**2)


def gradient(mechanism):
    """Derivatives of the sum of squares by the mechanism, and by the force."""

    def function(inputs):
        motion = shake(*inputs)
        assert not isinstance(motion.steps, Tracer)
        return sum_of_squares(motion)

    return eqx.filter_grad(function)((mechanism, jnp.asarray(1.0)))


SOLVERS = {
    "equilibrium": push,
    "simulate": shake,
    "vibrations": tj.vibrations,
    "linearize": tj.linearize,
    "gradient": gradient,
}


@pytest.fixture(scope="module")
def unstored():
    """Results of all solvers, and of motions under other forces, without traces."""
    before = stored_traces._folder
    stored_traces.store_traces_in(None)
    results = {name: solve(oscillator()) for name, solve in SOLVERS.items()}
    for force in (0.99, 1.01):
        results[f"{force} N"] = shake(oscillator(), force)
    yield results
    stored_traces._folder = before


@pytest.mark.parametrize("name", SOLVERS)
def test_a_stored_trace_gives_the_same_result(name, unstored, folder, traced):
    for _ in range(2):
        jax.clear_caches()  # as in a new process
        result = SOLVERS[name](oscillator())
        assert_same(result, unstored[name])
        # JAX compiles a function again for arguments that are committed to a device.
        leaves = jax.tree.leaves(result)
        assert not any(leaf.committed for leaf in leaves if isinstance(leaf, jax.Array))
    assert len(traced) == (2 if name == "gradient" else 1)
    assert len(list(folder.iterdir())) == len(traced)


def test_the_energy_of_a_user_is_traced(folder, traced):
    class Softer(tj.Quadratic):
        """Half of a quadratic energy."""

        def stored_energy(self, displacement):
            return super().stored_energy(displacement) / 2

    moved = push(oscillator(energy=Softer)).displacement("block")[1]
    assert moved == pytest.approx(2 * push(oscillator()).displacement("block")[1])
    assert len(traced) == 1


def test_another_option_of_jax_or_another_version_is_another_trace(
    folder, traced, monkeypatch
):
    push(oscillator())
    jax.clear_caches()
    with jax.default_matmul_precision("float32"):
        push(oscillator())
    assert len(traced) == 2
    monkeypatch.setattr(stored_traces, "_environment", lambda: "other sources")
    jax.clear_caches()
    push(oscillator())
    assert len(traced) == 3


@pytest.mark.parametrize("content", [b"", b"no trace", None])
def test_a_damaged_trace_is_replaced(content, folder, traced):
    expected = push(oscillator())
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if content is None else content)
    jax.clear_caches()
    assert_same(push(oscillator()), expected)
    assert len(traced) == 2
    assert len(file.read_bytes()) == len(whole)


def test_the_oldest_traces_are_deleted(folder):
    push(oscillator())
    (first,) = folder.iterdir()
    stored_traces.store_traces_in(folder, size=first.stat().st_size + 10)
    tj.vibrations(oscillator())
    (second,) = folder.iterdir()
    assert second != first


def test_a_folder_that_cannot_be_written_is_reported(tmp_path, folder):
    (tmp_path / "file").write_text("")
    stored_traces.store_traces_in(tmp_path / "file" / "traces")
    with pytest.warns(UserWarning, match=r"A traced function was not stored in '.*file"):
        assert push(oscillator()).displacement("block")[1] == pytest.approx(0.01)


def test_an_error_of_a_function_that_is_traced_is_raised_once(folder):
    hinge = tj.Hinge("spring", "wall", "block", tj.Quadratic(np.eye(3)), at=(0, 0, 0))
    bodies = [tj.Body("wall"), tj.Body("block")]
    with pytest.raises(ValueError, match="but has no `mass`") as caught:
        shake(tj.Mechanism(bodies, [hinge], fixed=["wall"]))
    assert "ValueError" not in repr(caught.value.__context__)


def test_a_gradient_is_exact_if_the_residuals_are_of_another_trace(monkeypatch):
    """The gradient of another trace is computed with a new forward pass."""
    names = iter("ab")
    monkeypatch.setattr(compiled_gradient, "_identity", lambda structure: next(names))

    def iterate(factor, start):
        def step(value, _):
            return jnp.sin(factor * value), value

        return jax.lax.scan(step, start, length=5), jnp.asarray(5)

    def sum_of_results(function, inputs):
        (last, values), count = function(*inputs)
        return count * (jnp.sum(values**2) + last)

    inputs = jnp.asarray(1.3), jnp.asarray(0.4)
    compiled = compiled_gradient.fast_compile_with_gradient(iterate)
    found = jax.grad(functools.partial(sum_of_results, compiled))(inputs)
    assert next(names, None) is None
    exact = jax.grad(functools.partial(sum_of_results, iterate))(inputs)
    np.testing.assert_allclose(found, exact, rtol=1e-12)


def test_the_gradient_of_a_motion_is_the_difference_quotient(unstored):
    less, more = (sum_of_squares(unstored[name]) for name in ("0.99 N", "1.01 N"))
    _, by_force = unstored["gradient"]
    assert float(by_force) == pytest.approx(float(more - less) / 0.02, rel=1e-6)


def test_functions_of_time_may_contain_what_is_differentiated():
    """An undamped oscillator under a constant force, and a linear rise of temperature.

    It moves along the other axis, so that the steps are short.
    """
    end = TIMES[-1]

    def last_position(force, rise):
        temperature = functools.partial(
            jnp.interp, xp=jnp.array([0.0, end]), fp=jnp.stack([0 * rise, rise])
        )
        motion = shake(
            oscillator(100.0 + 0 * force, damping=None),  # An argument is also traced.
            loads=lambda _: [tj.Load("block", force=(force, 0.0))],
            temperature=temperature,
            velocities={"block": (0.0, 0.0, 0.1)},
        )
        return motion.displacement("block")[-1, 1]

    by_force, by_rise = jax.grad(last_position, argnums=(0, 1))(0.0, 0.0)
    stiffness, mass, growth = 100.0, 0.1, 1e-5 * 0.1  # N/m, kg, m/K
    phase = np.sqrt(stiffness / mass) * end
    np.testing.assert_allclose(by_force, (1 - np.cos(phase)) / stiffness, rtol=1e-6)
    np.testing.assert_allclose(by_rise, growth * (1 - np.sin(phase) / phase), rtol=1e-6)


def test_a_function_that_contains_a_traced_value_has_no_text():
    def check(value):
        for function in (lambda _: value, functools.partial(jnp.interp, fp=value)):
            assert not compiled_gradient._has_text((value, function))
        assert compiled_gradient._has_text((value, jnp.interp))
        return value

    jax.eval_shape(check, 1.0)


def test_sources_that_have_changed_since_the_start_are_not_stored(folder, monkeypatch):
    monkeypatch.setattr(stored_traces, "_sources", lambda: "other sources")
    push(oscillator())
    assert not folder.exists()


class Color(enum.Enum):
    """An enumeration of a user."""

    RED = 1


def test_texts_of_values_that_lead_to_other_traces_differ():
    values = [
        None, True, 1, 1.0, "1", b"1", (1,), [1], {"a": 1}, {"b": 1}, ("a,str 'b'",),
        ("a", "b"), np.float64(1.0), np.arange(2), np.arange(2.0), jnp.arange(2.0),
        np.arange(2.0)[None], np.dtype(float), jnp.sin, jnp.cos, tj.Quadratic,
        tj.Load("a", force=(1.0, 0.0)), tj.Load("b", force=(1.0, 0.0)),
        eqx.Partial(jnp.sin, 1), eqx.Partial(jnp.sin, 2), oscillator().names,
        jax.ShapeDtypeStruct((2,), float), jax.ShapeDtypeStruct((2,), int), -0.0,
        jax.ShapeDtypeStruct((), float, weak_type=True), jnp.asarray(1.0), jnp.ones(()),
        np.dtype("int32"), frozenset("ab"), frozenset("ac"), -1, 0.0, float("nan"),
    ]  # fmt: skip
    texts = [canonical_text(value) for value in values]
    assert len(set(texts)) == len(values)


@functools.wraps(canonical_text)
def decorated(value):
    """A function of a user with the name of a function of the library."""
    return canonical_text(value) * 2


@pytest.mark.parametrize(
    "value",
    [
        push, decorated, lambda: None, eqx.Partial(push, 1), functools.partial(push),
        jax.jit(push), Color.RED, object(), np.array([object()]), type("A", (), {})(),
        jax.random.key(0), np.ma.array([1.0]), np.dtype([("a", float)]),
    ],
)  # fmt: skip
def test_functions_and_objects_of_users_have_no_text(value):
    with pytest.raises(NoCanonicalTextError):
        canonical_text((1, [value]))
