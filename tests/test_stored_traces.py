"""Traces on disk: the results are those of a new trace, and no other trace is loaded."""

import enum
import functools
import os
import pickle
import random
import subprocess
import sys
import threading
import time
from pathlib import Path
from unittest import mock

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mostly_slow
from jax.core import Tracer

import twistorjax as tj
from twistorjax._compile import stored_gradients, stored_traces, trace_folder
from twistorjax._compile.compilation import fast_compile
from twistorjax._compile.result_structure import from_text, to_text
from twistorjax._compile.trace_folder import TraceFolder
from twistorjax._compile.trace_keys import canonical_text, NoCanonicalTextError
from twistorjax.flexures.beams.beam import arc_rotation
from twistorjax.mechanism.misfits import Temperature


TIMES = [0.0, 0.02, 0.05]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Store traces in a folder of the test, and trace all functions anew."""
    jax.clear_caches()
    monkeypatch.setattr(trace_folder, "_warned", False)
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
    spring = energy(np.diag([1.0, 1.0, 0.5]) * stiffness)
    settings = {"damping": damping, "expansion": tj.Expansion(1e-5, length=0.1)}
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0), **settings)
    bodies = [tj.Body("wall"), tj.Body("block", mass=0.1, inertia=0.01)]
    return tj.Mechanism(bodies, [hinge], fixed=["wall"])


class Softer(tj.Quadratic):
    """Half of a quadratic energy, defined by a user."""

    def stored_energy(self, displacement):
        return super().stored_energy(displacement) / 2


def strain_energy(kind=tj.Quadratic):
    """Return an energy of 0.5 J, which is traced within milliseconds."""
    return kind(np.diag([1.0, 100.0, 50.0]))(jnp.array([0.0, 0.1, 0.0]))


def wrench():
    """Call another function that is traced within milliseconds."""
    return tj.Quadratic(np.diag([1.0, 100.0, 50.0])).wrench(jnp.array([0.0, 0.1, 0.0]))


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
    "linearize": tj.linearize,
    "equilibrium": push,
    "simulate": shake,
    "vibrations": tj.vibrations,
    "gradient": gradient,
}


@functools.cache
def unstored(solve, *arguments):
    """Return the result of a solver for the oscillator without stored traces."""
    with mock.patch.object(stored_traces, "_folder", None):
        return solve(oscillator(), *arguments)


@pytest.mark.parametrize("name", mostly_slow(SOLVERS))
def test_a_stored_trace_gives_the_same_result(name, folder, traced):
    expected = unstored(SOLVERS[name])
    for _ in range(2):
        jax.clear_caches()  # as in a new process
        result = SOLVERS[name](oscillator())
        assert_same(result, expected)
        # JAX compiles a function again for arguments that are committed to a device.
        leaves = jax.tree.leaves(result)
        assert not any(leaf.committed for leaf in leaves if isinstance(leaf, jax.Array))
    assert len(traced) == (2 if name == "gradient" else 1)
    assert len(list(folder.iterdir())) == len(traced)


def test_the_energy_of_a_user_is_traced(folder, traced):
    assert strain_energy(Softer) == pytest.approx(0.25)
    assert strain_energy() == pytest.approx(0.5)
    assert len(traced) == 1


def test_another_option_of_jax_or_another_version_is_another_trace(
    folder, traced, monkeypatch
):
    strain_energy()
    jax.clear_caches()
    with jax.default_matmul_precision("float32"):
        strain_energy()
    assert len(traced) == 2
    monkeypatch.setattr(stored_traces, "_environment", lambda: "other sources")
    jax.clear_caches()
    strain_energy()
    assert len(traced) == 3


class Intruder:
    """An object that creates a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


DAMAGES = {
    "empty": lambda content: b"",
    "text": lambda content: b"no trace",
    "half": lambda content: content[: len(content) // 2],
    "bit": lambda content: content[:-9] + bytes([content[-9] ^ 16]) + content[-8:],
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_trace_is_replaced(name, folder, traced):
    expected = strain_energy()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(DAMAGES[name](whole))
    jax.clear_caches()
    assert strain_energy() == expected
    assert len(traced) == 2
    assert len(file.read_bytes()) == len(whole)


KEY, OTHER_KEY = 64 * "a", 64 * "b"


def test_no_flipped_bit_and_no_part_of_a_file_is_read(tmp_path):
    folder = TraceFolder(tmp_path)
    content = random.Random(0).randbytes(200)
    folder.write(KEY, content)
    file = tmp_path / KEY
    whole = file.read_bytes()
    for position in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[position // 8] ^= 1 << position % 8
        file.write_bytes(damaged)
        assert folder.read(KEY) is None
    for size in range(len(whole)):
        file.write_bytes(whole[:size])
        assert folder.read(KEY) is None
    (tmp_path / OTHER_KEY).write_bytes(whole)  # the trace of another function
    assert folder.read(OTHER_KEY) is None
    file.write_bytes(whole)
    assert folder.read(KEY) == content


@pytest.mark.slow
def test_a_file_of_others_is_never_executed_even_with_a_right_digest(folder, tmp_path):
    expected = push(oscillator())
    (file,) = folder.iterdir()
    created = tmp_path / "executed"
    attack = pickle.dumps(Intruder(created))
    pickle.loads(attack)
    created.unlink()  # It would have worked.
    writer = TraceFolder(folder)
    for content in (attack, b'["posix:system", ["touch"]]\n' + attack):
        writer.write(file.name, content)
        assert writer.read(file.name) == content
        jax.clear_caches()
        assert_same(push(oscillator()), expected)
        assert not created.exists()
        assert writer.read(file.name) != content  # replaced by a trace


@pytest.mark.parametrize(
    "text",
    [
        '["name", "os:system"]', '["os:stat_result", [1]]', '["name", "jax.numpy:sin"]',
        '["partial", ["f", [], {}]]', '["twistorjax:Load", {"unknown": 1}]',
        '["twistorjax.solve.continuation.program:PathRun", [1]]', '["list"]', "[", "",
        "[1, 2]",
    ],
)  # fmt: skip
def test_only_known_classes_are_read_from_a_text(text):
    with pytest.raises((ValueError, AttributeError, TypeError)):
        from_text(text)


def test_a_result_is_recovered_from_its_text():
    value = (
        None,
        True,
        1,
        -0.0,
        float("inf"),
        "ö\n",
        [1.5],
        {"a": (), 2: frozenset("a")},
    )
    temperature = Temperature(5.0, hinges={"heater": 200.0}, bodies={}, gradients={})
    placeholder = stored_traces._Placeholder(3, weak=True)
    thickness = jax.tree_util.Partial(arc_rotation, placeholder)
    everything = value, tj.Load, temperature, [placeholder, thickness]
    recovered = from_text(to_text(everything))
    assert repr(recovered) == repr(everything)
    assert recovered[1] is tj.Load and type(recovered[2]) is Temperature
    for unknown in (Color.RED, Color, object(), push, {1, 2}, np.zeros(1)):
        with pytest.raises(NoCanonicalTextError):
            to_text((1, unknown))


posix = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="permissions of POSIX")


@pytest.mark.slow
@posix
@pytest.mark.parametrize("unsafe", ["owner", "file", "folder"])
def test_what_others_may_have_written_is_read_only_if_asked_for(
    unsafe, folder, traced, monkeypatch
):
    expected = push(oscillator())
    (file,) = folder.iterdir()
    if unsafe == "owner":
        own = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: own + 1)
    else:
        (file if unsafe == "file" else folder).chmod(0o777)
    jax.clear_caches()
    stored_traces.store_traces_in(folder, shared=True)
    assert_same(push(oscillator()), expected)
    assert len(traced) == 1
    jax.clear_caches()
    stored_traces.store_traces_in(folder)
    if unsafe == "file":  # Its folder is safe, so that it is replaced.
        assert_same(push(oscillator()), expected)
        assert not file.stat().st_mode & 0o022
    else:
        with pytest.warns(UserWarning, match="another user owns this folder or") as found:
            assert_same(push(oscillator()), expected)
            tj.vibrations(oscillator())
        assert len(found) == 1
    assert len(traced) == (2 if unsafe == "file" else 3)


@posix
def test_a_pipe_in_the_place_of_a_trace_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / KEY)
    assert TraceFolder(tmp_path).read(KEY) is None


@posix
def test_other_users_may_read_a_shared_folder_and_write_as_into_its_parent(tmp_path):
    for mode, shared, expected in ((0o2775, True, 0o2775), (0o2775, False, 0o755)):
        parent = tmp_path / str(shared)
        parent.mkdir()
        parent.chmod(mode)
        TraceFolder(parent / "traces", shared=shared).write(KEY, b"content")
        assert (parent / "traces").stat().st_mode & 0o777 == expected & 0o777
        assert (parent / "traces" / KEY).stat().st_mode & 0o777 == 0o644


def test_traces_in_a_read_only_folder_are_used(folder, traced, monkeypatch):
    expected = strain_energy()

    def fail(*_, **__):
        raise PermissionError

    monkeypatch.setattr(os, "utime", fail)
    monkeypatch.setattr(trace_folder.tempfile, "mkstemp", fail)
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)
    jax.clear_caches()
    assert strain_energy() == expected
    assert len(traced) == 1
    wrench()  # is not stored, without a warning
    assert len(list(folder.iterdir())) == 1


def test_a_full_disk_leaves_no_files_and_is_reported_once(tmp_path, monkeypatch):
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(trace_folder, "_warned", False)
    folder, before = TraceFolder(tmp_path), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.warns(UserWarning, match="File too large") as found:
            for key in (KEY, OTHER_KEY):
                folder.write(key, bytes(2000))
        assert len(found) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


def test_the_oldest_traces_are_deleted(folder):
    wrench()
    (first,) = folder.iterdir()
    stored_traces.store_traces_in(folder, size=first.stat().st_size + 10)
    strain_energy()
    (second,) = folder.iterdir()
    assert second != first


def test_files_of_killed_processes_count_and_are_deleted_when_they_are_old(tmp_path):
    folder = TraceFolder(tmp_path, size=1000)
    file_of_the_user = tmp_path / "data.csv"
    file_of_the_user.write_bytes(bytes(5000))
    old, new = tmp_path / "tmpabcdefg1", tmp_path / "tmpabcdefg2"
    for path in (old, new):
        path.write_bytes(bytes(500))
    day_before = time.time() - 86_400
    os.utime(old, (day_before, day_before))
    folder.write(KEY, bytes(300))
    assert not old.exists() and new.exists() and (tmp_path / KEY).exists()
    folder.write(OTHER_KEY, bytes(300))  # There is no room for both.
    assert not (tmp_path / KEY).exists() and (tmp_path / OTHER_KEY).exists()
    folder.write(KEY, bytes(600))  # There is room for nothing else.
    folder.write(KEY, bytes(1000))
    assert {path.name for path in tmp_path.iterdir()} == {new.name, "data.csv"}


def test_many_writers_at_the_same_time_stay_below_the_limit(tmp_path):
    folder = TraceFolder(tmp_path, size=5000)
    keys = [64 * letter for letter in "abcdef"]

    def write(seed):
        for key in random.Random(seed).choices(keys, k=30):
            folder.write(key, key.encode() * 20)
            assert folder.read(key) in (None, key.encode() * 20)

    threads = [threading.Thread(target=write, args=(seed,)) for seed in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    files = list(tmp_path.iterdir())
    assert 1 <= len(files) <= 3 and sum(file.stat().st_size for file in files) <= 5000
    assert {file.name for file in files} <= set(keys)


def test_a_folder_that_cannot_be_written_is_reported_once(tmp_path, folder):
    (tmp_path / "file").write_text("")
    stored_traces.store_traces_in(tmp_path / "file" / "traces")
    message = r"A traced function was not stored in '.*file"
    with pytest.warns(UserWarning, match=message) as found:
        assert strain_energy() == pytest.approx(0.5)
        wrench()
    assert len(found) == 1


WITHOUT_INTERNALS = """
import sys, equinox, diffrax, jax, jax.core, jax.export, jax.extend.core
import jax.extend.mlir.dialects, jax.interpreters.mlir as mlir, jax.interpreters.ad as ad
{remove}
import numpy as np, twistorjax as tj
tj.configure(cache={cache!r})
hinge = tj.Hinge("spring", "wall", "block", tj.Quadratic(np.eye(3)), at=(0, 0, 0))
guide = tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])
solution = tj.equilibrium(guide, loads=[tj.Load("block", force=(0.1, 0.0))])
print(solution.displacement("block"))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "remove",
    [
        "del ad.Zero, mlir.merge_mlir_modules, jax.export",
        "sys.modules |= dict.fromkeys(['jax.extend', 'jax.export', mlir.__name__])",
    ],
)
def test_the_library_works_without_the_internals_of_jax(remove, tmp_path):
    code = WITHOUT_INTERNALS.format(remove=remove, cache=str(tmp_path))
    process = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True, text=True, check=False,
        env={**os.environ, "JAX_COMPILATION_CACHE_DIR": ""},
    )  # fmt: skip
    assert process.stderr == ""
    assert process.stdout.split() == ["[0.", "0.1", "0.", "]"]


@pytest.mark.parametrize(
    "remove",
    [
        (jax.export, "export"), (jax.export, "deserialize"), (type(jax.config), "values"),
        (jax.lax, "convert_element_type_p"), (stored_traces, "call_program"),
    ],
)  # fmt: skip
def test_an_internal_of_jax_that_has_changed_is_not_used(remove, folder, monkeypatch):
    strain_energy()
    jax.clear_caches()
    monkeypatch.setattr(*remove, None)
    assert strain_energy() == pytest.approx(0.5)


def test_a_cache_folder_that_cannot_be_created_is_reported_once(tmp_path):
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    folder = stored_traces._folder
    (tmp_path / "file").write_text("")
    try:
        with pytest.warns(
            UserWarning, match="cannot be used: .* Nothing is sto"
        ) as found:
            tj.configure(
                cache=tmp_path / "file", fast_compilation=False, fast_loops=False
            )
        assert len(found) == 1
        assert stored_traces._folder is None and not getattr(jax.config, names[0])
    finally:
        for name, value in before.items():
            jax.config.update(name, value)
        stored_traces._folder = folder


def test_an_error_of_a_function_that_is_traced_is_raised_once(folder):
    hinge = tj.Hinge("spring", "wall", "block", tj.Quadratic(np.eye(3)), at=(0, 0, 0))
    bodies = [tj.Body("wall"), tj.Body("block")]
    with pytest.raises(ValueError, match="but has no `mass`") as caught:
        shake(tj.Mechanism(bodies, [hinge], fixed=["wall"]))
    assert "ValueError" not in repr(caught.value.__context__)


def test_a_gradient_is_exact_if_the_residuals_are_of_another_trace(monkeypatch):
    """The gradient of another trace is computed with a new forward pass."""
    names = iter("ab")
    monkeypatch.setattr(stored_gradients, "_identity", lambda structure: next(names))

    def iterate(factor, start):
        def step(value, _):
            return jnp.sin(factor * value), value

        return jax.lax.scan(step, start, length=5), jnp.asarray(5)

    def sum_of_results(function, inputs):
        (last, values), count = function(*inputs)
        return count * (jnp.sum(values**2) + last)

    inputs = jnp.asarray(1.3), jnp.asarray(0.4)
    compiled = fast_compile(iterate)
    found = jax.grad(functools.partial(sum_of_results, compiled))(inputs)
    assert next(names, None) is None
    exact = jax.grad(functools.partial(sum_of_results, iterate))(inputs)
    np.testing.assert_allclose(found, exact, rtol=1e-12)


@pytest.mark.slow
def test_the_gradient_of_a_motion_is_the_difference_quotient():
    less, more = (sum_of_squares(unstored(shake, force)) for force in (0.99, 1.01))
    _, by_force = unstored(gradient)
    assert float(by_force) == pytest.approx(float(more - less) / 0.02, rel=1e-6)


@pytest.mark.release
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
            assert not stored_gradients._has_text((value, function))
        assert stored_gradients._has_text((value, jnp.interp))
        return value

    jax.eval_shape(check, 1.0)


def test_sources_that_have_changed_since_the_start_are_not_stored(folder, monkeypatch):
    monkeypatch.setattr(stored_traces, "_sources", lambda: "other sources")
    strain_energy()
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
        *map(jax.tree.structure, [{"a": 1}, {"b": 1}, [1, 2], [1, [2]], [1, None], None]),
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
        jax.tree.structure(Softer(np.eye(3))),  # pyright: ignore[reportCallIssue]
    ],
)  # fmt: skip
def test_functions_and_objects_of_users_have_no_text(value):
    with pytest.raises(NoCanonicalTextError):
        canonical_text((1, [value]))
