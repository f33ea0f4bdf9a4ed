"""A sweep equals separate evaluations of its designs, for any chunks and derivatives."""

import itertools
import sys
from functools import partial
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sweep_helpers import area, compiled as compiled, pulled_block, SIDES, spring

import twistorjax as tj
from twistorjax.examples import stage
from twistorjax.examples.sweep_studies import stage_gain
from twistorjax.sweeps.executor import default_chunk_size, default_memory


pytest.importorskip("xarray")
pytest.importorskip("zarr")


def test_each_design_has_the_result_of_a_single_evaluation():
    designs = {"k": np.linspace(50.0, 150.0, 7), "force": np.linspace(-0.2, 0.3, 7)}
    table = tj.sweep(pulled_block, designs, chunk_size=4)
    np.testing.assert_allclose(table.travel, designs["force"] / designs["k"], rtol=1e-9)
    assert table.travel.dims == ("design",)
    np.testing.assert_array_equal(table.k, designs["k"])
    assert bool(table.succeeded.all()) and not table.result.any()


def test_a_grid_contains_all_combinations_of_its_values():
    a, b = np.array([0.5, 1.0, 2.0]), np.array([1.0, 2.0])
    units = {"a": "m", "area": "m2"}
    table = tj.sweep(area, tj.Grid({"a": a, "b": b}), chunk_size=4, units=units)
    assert table.area.dims == ("a", "b")
    np.testing.assert_allclose(table.area, np.sin(a)[:, None] * b, rtol=1e-9)
    assert table.a.attrs["units"] == "m" and table.area.attrs["units"] == "m2"


def test_derivatives_are_exact_and_have_units():
    k, force = np.array([50.0, 100.0, 150.0, 200.0]), np.array([0.1, 0.3, 0.5, 0.7])
    designs = {"k": k, "force": force}
    units = {"k": "N/m", "force": "N", "travel": "m"}
    table = tj.sweep(pulled_block, designs, derivatives=("travel",), units=units)
    np.testing.assert_allclose(table.travel_by_force, 1 / k, rtol=1e-9)
    np.testing.assert_allclose(table.travel_by_k, -force / k**2, rtol=1e-9)
    assert table.travel_by_k.attrs["units"] == "m/(N/m)"
    assert table.travel_by_force.attrs["units"] == "m/N"


def test_many_parameters_are_differentiated_in_reverse_mode():
    def study(design):
        return {"sum": jnp.sum(design["x"] ** 3), "pair": design["x"][:2] ** 2}

    x = np.arange(80.0).reshape(2, 40)
    table = tj.sweep(study, {"x": x}, derivatives=("sum", "pair"))
    np.testing.assert_allclose(table.sum_by_x, 3 * x**2)
    assert table.pair_by_x.dims == ("design", "pair_0", "x_0")
    np.testing.assert_allclose(table.pair_by_x[1, 1, 1], 2 * x[1, 1])


@pytest.mark.parametrize("size", [3, 40])
def test_complex_outputs_are_differentiated_in_both_modes(size):
    """In forward mode for few parameters, in reverse mode for many."""
    x = np.linspace(0.1, 1.0, 2 * size).reshape(2, size)

    def study(design):
        return {"h": (jnp.sum(design["x"]).astype(complex) * (1 + 2j)) ** 2}

    table = tj.sweep(study, {"x": x}, derivatives=["h"])
    exact = 2 * (1 + 2j) ** 2 * x.sum(axis=1)
    np.testing.assert_allclose(table.h_by_x, np.tile(exact, (size, 1)).T, rtol=1e-12)


def test_an_output_with_an_infinite_derivative_succeeds():
    """The square root at zero, with and without derivatives."""
    for derivatives in ((), ("root",)):
        table = tj.sweep(
            lambda design: {"root": jnp.sqrt(design["x"])},
            {"x": np.array([0.0, 4.0])},
            derivatives=derivatives,
        )
        assert table.succeeded.all()
        np.testing.assert_array_equal(table.root, [0.0, 2.0])


def test_a_study_without_forward_mode_is_differentiated_in_reverse_mode():
    """Motions are such studies by default."""

    @jax.custom_vjp
    def square(x):
        return x**2

    def forward(x):
        return x**2, x

    def backward(x, cotangent):
        return (2 * x * cotangent,)

    square.defvjp(forward, backward)
    designs = {"x": np.arange(1.0, 4.0)}
    table = tj.sweep(lambda d: {"y": square(d["x"])}, designs, derivatives=["y"])
    np.testing.assert_allclose(table.y_by_x, [2.0, 4.0, 6.0])


def test_a_failed_design_is_nan_and_does_not_affect_others():
    """A spring of negative stiffness has no stable equilibrium; one load is NaN."""
    designs = {"k": np.array([100.0, -50.0, 100.0, 100.0]), "force": np.ones(4)}
    designs["force"][2] = np.nan
    with pytest.warns(UserWarning, match="2 of 4 designs failed") as found:
        table = tj.sweep(pulled_block, designs, derivatives=("travel",))
    assert found[0].filename == __file__
    assert table.succeeded.values.tolist() == [True, False, False, True]
    assert np.isnan(table.travel[1:3]).all() and np.isnan(table.travel_by_k[1:3]).all()
    np.testing.assert_array_equal(table.travel[[0, 3]], 0.01)
    names = table.result.attrs["flag_meanings"].split()
    results = [names[code] for code in table.result.values]
    assert results == ["successful", "unstable", "not_finite", "successful"]


def test_solutions_and_columns_have_names_and_units():
    def study(design):
        loads = [tj.Load("block", (0, 1, 0))]
        solution = tj.equilibrium(spring(design), loads=loads, throw=False)
        stiffness = tj.solve.Column(design["k"], unit="N/m")
        return {"solution": solution, "stiffness": stiffness}

    table = tj.sweep(study, {"k": np.array([50.0, 100.0])})
    assert table["solution.x"].attrs["units"] == "m"
    np.testing.assert_allclose(table["solution.x"].sel(body="block"), [0.02, 0.01])
    assert table["stiffness"].attrs["units"] == "N/m"


@pytest.mark.slow
def test_the_times_of_a_motion_are_a_coordinate():
    """The block oscillates with v / omega sin(omega t) after an initial velocity v."""

    def study(design):
        block = tj.Body("block", mass=1.0, inertia=1.0)
        stiffness = jnp.diag(jnp.stack([jnp.ones(()), design["k"], jnp.ones(())]))
        hinge = tj.Hinge("s", "wall", "block", tj.Quadratic(stiffness), at=(0, 0, 0))
        oscillator = tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])
        velocities = {"block": (0.0, 0.01, 0.0)}
        times = [0.0, 0.05, 0.1]
        return tj.simulate(
            oscillator, times, velocities=velocities, tolerance=1e-9, throw=False
        )

    k = np.array([100.0, 400.0])
    table = tj.sweep(study, {"k": k})
    np.testing.assert_array_equal(table.time, [0.0, 0.05, 0.1])
    assert table.x.dims == ("design", "time", "body")
    exact = 0.01 / np.sqrt(k) * np.sin(np.sqrt(k) * 0.1)
    np.testing.assert_allclose(table.x.sel(body="block")[:, -1], exact, rtol=1e-5)


def test_a_chunk_is_reduced_until_it_fits_into_the_memory():
    def study(design):
        return {"sum": jnp.sum(jnp.sort(jnp.sin(design["a"] * jnp.arange(1000.0))))}

    table = tj.sweep(study, {"a": np.linspace(0, 1, 600)}, memory=1e6)
    assert table.attrs["chunk_size"] < 600
    whole = tj.sweep(study, {"a": np.linspace(0, 1, 600)})
    np.testing.assert_allclose(table["sum"], whole["sum"], rtol=1e-12)
    with pytest.raises(ValueError, match="`chunk_size` is 600, for which a device needs"):
        tj.sweep(study, {"a": np.linspace(0, 1, 600)}, memory=1e6, chunk_size=600)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("platform", "statistics", "count", "chunk_size", "memory"),
    [
        ("cpu", None, 100_000, 4096, 2**30),
        ("cpu", None, 5_000, 2048, 2**30),
        ("gpu", {"bytes_limit": 2**36}, 1_000_000, 2**17, 2**35),
        ("gpu", {"bytes_limit": 2**36}, 100_000, 2**17, 2**35),
        ("gpu", {"bytes_limit": 2**36}, 70_000, 2**15, 2**35),
        ("gpu", {"bytes_limit": 2**36}, 10_000, 2**14, 2**35),
    ],
)
def test_an_accelerator_evaluates_larger_chunks_in_more_memory(
    platform, statistics, count, chunk_size, memory
):
    device = SimpleNamespace(platform=platform, memory_stats=lambda: statistics)
    mesh: Any = SimpleNamespace(devices=np.array([device]), local_devices=[device])
    assert default_chunk_size(count, mesh) == chunk_size
    assert default_memory(mesh) == memory


def test_a_study_is_compiled_once_for_several_sweeps(compiled):
    for start in (0.0, 1.0, 2.0):
        # A new function that computes the same is the same program.
        table = tj.sweep(lambda design: design["a"], {"a": np.linspace(start, 5, 10)})
        np.testing.assert_array_equal(table.output, table.a)
    assert len(compiled) == 1


@pytest.mark.slow
def test_a_new_study_that_solves_the_same_mechanism_is_not_compiled_again(compiled):
    """Neither with derivatives, which have rules of their own, nor with callbacks."""
    designs = {"k": np.linspace(50.0, 150.0, 3), "force": np.ones(3)}
    for derivatives in ((), ("travel",)):
        for _ in range(2):
            tj.sweep(lambda d: pulled_block(d), designs, derivatives=derivatives)
        assert len(compiled) == (2 if derivatives else 1)

    def raising(design):
        loads = [tj.Load("block", (0.0, design["force"], 0.0))]
        return tj.equilibrium(spring(design), loads=loads).displacement("block")[1]

    for _ in range(2):
        np.testing.assert_allclose(tj.sweep(raising, designs).output, 1 / designs["k"])
    assert len(compiled) == 3


FACTOR = 1.0


class Model:
    """A study with a constant."""

    def __init__(self):
        self.factor = 1.0

    def study(self, design):
        return design["a"] * self.factor


def global_number():
    def change(value):
        global FACTOR
        FACTOR = value

    return lambda design: design["a"] * FACTOR, change


def array_in_closure():
    factors = np.ones(3)
    return lambda design: design["a"] * factors[1], lambda value: factors.fill(value)


def whole_array_in_closure():
    factors = np.ones(3)
    return lambda design: design["a"] * factors, lambda value: factors.fill(value)


def nested_function():
    factors = [1.0]

    def inner(value):
        return value * factors[0]

    return lambda design: inner(design["a"]), lambda value: factors.__setitem__(0, value)


def attribute():
    model = Model()
    return model.study, lambda value: setattr(model, "factor", value)


def argument_of_partial():
    factors = np.ones(3)

    def study(factors, design):
        return design["a"] * factors

    return partial(study, factors), lambda value: factors.fill(value)


def default_argument():
    factors = np.ones(())

    def study(design, factors=factors):
        return design["a"] * factors

    return study, lambda value: factors.fill(value)


def stiffness_of_a_mechanism():
    model = Model()

    def study(design):
        load = tj.Load("block", (0.0, model.factor * design["a"], 0.0))
        fixed = {"k": jnp.asarray(1.0)}
        return tj.equilibrium(spring(fixed), loads=[load]).displacement("block")[1]

    return study, lambda value: setattr(model, "factor", value)


def study_in_jit():
    study, change = global_number()
    return jax.jit(study), change


def study_in_filter_jit():
    study, change = global_number()
    return eqx.filter_jit(study), change


CHANGES = [
    global_number, array_in_closure, whole_array_in_closure, nested_function, attribute,
    argument_of_partial, default_argument, study_in_jit, study_in_filter_jit,
    pytest.param(stiffness_of_a_mechanism, marks=pytest.mark.slow),
]  # fmt: skip


@pytest.mark.parametrize("create", CHANGES)
def test_a_study_uses_the_values_at_the_time_of_the_call(create, compiled):
    study, change = create()
    for value in (1.0, 2.0, 1.0, 2.0):
        change(value)
        table = tj.sweep(study, {"a": np.array([1.0, 3.0])})
        mean = np.asarray(table.output).reshape(2, -1).mean(axis=1)
        np.testing.assert_allclose(mean, [value, 3 * value])
    assert len(compiled) == 2  # Earlier programs are used again.


def test_lists_and_integers_are_parameters():
    table = tj.sweep(area, {"a": [1.0, 2.0], "b": (3.0, 4.0)})
    np.testing.assert_array_equal(table.twice, [2.0, 4.0])
    grid = tj.Grid({"n": [1, 2]})
    table = tj.sweep(lambda d: {"square": d["n"] ** 2}, grid, derivatives=["square"])
    np.testing.assert_array_equal(table.square_by_n, [2.0, 4.0])


def test_parameters_in_a_tree_are_named_by_their_paths():
    designs = {
        "leaf": {"length": np.ones(4), "sides": np.ones((4, 2))},
        "k": np.arange(4),
    }

    def study(design):
        return jnp.where(design["k"] > 1, design["leaf"]["length"], 0.0)

    table = tj.sweep(study, designs)
    np.testing.assert_array_equal(table.output, [0.0, 0.0, 1.0, 1.0])
    assert table["leaf.sides"].dims == ("design", "leaf.sides_0")
    assert set(itertools.chain(table.coords)) == {"leaf.length", "leaf.sides", "k"}


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(designs={"a": np.ones(3), "b": np.ones(2)}), "3 of a, 2 of b, but needs"),
        (dict(designs={"a": 1.0, "b": np.ones(2)}), "has the parameter 'a' of shape ()"),
        (dict(designs={}), "has no array"),
        (dict(derivatives=["areas"]), "outputs of the study are 'area', 'twice'"),
        (dict(units={"c": "mm"}, study=lambda d: {"c": tj.solve.Column(d["a"], (), "m")}),
         "`units` has the unit 'mm' for 'c', but the study returns it in 'm'"),
        (dict(study=lambda d: {"c": d["a"], "d": "word"}), "returns 'word' as 'd'"),
        (dict(study=3), "`study` is 3, but must be a function"),
        (dict(units={"c": "m"}), "names 'c', but the parameters and outputs are a, b, "),
        (dict(chunk_size=0), "`chunk_size` is 0"),
        (dict(resume=True), "`resume` is True, but there is no `store`"),
        (dict(study=lambda design: None), "but must return an array"),
        (dict(study=lambda design: {"a": design["b"]}), "returns an output 'a', but"),
        (dict(study=lambda d: {"result": d["a"]}), "returns an output 'result', but"),
        (dict(settings={"f": np.sin}), "`settings` must contain numbers, strings"),
        (dict(memory=8.0), "`chunk_size` is 1, for which a device needs"),
        (dict(study=lambda design: float(design["a"])), "`study` is a function that"),
        (
            dict(study=lambda d: {"x": tj.solve.Column(jnp.ones(2), ("n",)),
                                  "y": tj.solve.Column(jnp.ones(3), ("n",))}),
            "'y' has 3 entries along 'n', but another variable has 2",
        ),
    ],
)  # fmt: skip
def test_invalid_arguments_of_a_sweep_are_rejected(arguments, message):
    with pytest.raises(ValueError) as error:
        tj.sweep(**{"study": area, "designs": SIDES, **arguments})
    assert message in str(error.value)


@pytest.mark.parametrize("analyze", [
    lambda study: tj.sweep(study, {"a": np.ones(2)}),
    lambda study: tj.sweeps.tolerances(study, {"a": tj.sweeps.Normal(1.0, 0.1)}, "c"),
    lambda study: tj.optimize(study, {"a": tj.Parameter(1.0)}, minimize="c"),
])  # fmt: skip
def test_a_parameter_that_is_missing_is_reported_with_those_given(analyze):
    with pytest.raises(KeyError, match="b") as error:
        analyze(lambda design: {"c": design["b"]})
    assert "The parameters are 'a'." in error.value.__notes__


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("values", "message"),
    [({}, "`values` is empty"), ({"a": 1.0}, "must be a one-dimensional array")],
)
def test_invalid_values_of_a_grid_are_rejected(values, message):
    with pytest.raises(ValueError, match=message):
        tj.Grid(values)


def test_a_solve_that_raises_in_a_study_is_reported_with_a_remedy():
    def study(design):
        loads = [tj.Load("block", (0.0, 1.0, 0.0))]
        return tj.equilibrium(spring(design), loads=loads).energy

    with pytest.raises(RuntimeError, match="Call the solver with `throw=False`"):
        tj.sweep(study, {"k": np.array([1.0, -1.0])})


def untraceable(design):
    raise AssertionError("The study has been traced.")


@pytest.mark.untyped
@pytest.mark.parametrize("package", ["xarray", "zarr"])
def test_a_missing_package_is_reported_before_everything_else(
    package, tmp_path, monkeypatch
):
    """Before any work, and before other errors, such as a wrong number of designs."""
    monkeypatch.setitem(sys.modules, package, None)  # as if it were not installed
    path = tmp_path / "s.zarr"
    uncertain = {"a": tj.sweeps.Normal(mean=1.0, standard_deviation=0.1)}
    calls = (
        lambda: tj.sweep(untraceable, {"a": np.ones(2), "b": np.ones(3)}, store=path),
        lambda: tj.sweeps.tolerances(untraceable, uncertain, count=0, store=path),
        lambda: tj.sweeps.open_sweep(path),
    )
    for call in calls:
        with pytest.raises(ImportError) as error:
            call()
        assert f"need {package}: install it with" in str(error.value)
        assert 'pip install "twistorjax[data]"' in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_gain_of_the_stage_is_swept_with_its_exact_derivative():
    webs = np.array([0.2e-3, 0.25e-3, 0.4e-3])
    table = tj.sweep(stage_gain, {"web": webs}, derivatives=("gain",))
    for web, gain, derivative in zip(webs, table.gain, table.gain_by_web, strict=True):
        amplification, exact = stage.amplification_and_slope(web, stage.TRAVEL)
        np.testing.assert_allclose(gain, amplification.gain, rtol=1e-11)
        np.testing.assert_allclose(derivative, exact, rtol=1e-9)
    assert table.output.attrs["units"] == "m"


def test_the_webs_of_the_stage_may_differ():
    """Each hinge is that of a stage whose webs are all equal to its own."""
    webs = np.where(np.arange(7) == 3, 0.3e-3, 0.2e-3)
    mixed = jax.jit(stage.microstage)(webs)
    equal = {web: stage.microstage(web) for web in (0.2e-3, 0.3e-3)}
    for k, web in enumerate(webs):
        found, expected = (
            mechanism.hinge_assembly.energy_of(k).tangent_stiffness()
            for mechanism in (mixed, equal[web])
        )
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    with pytest.raises(ValueError, match="one for each of the hinges a, b"):
        stage.microstage(np.full(3, 0.25e-3))


@pytest.mark.untyped
def test_a_unit_in_the_place_of_axes_is_refused():
    with pytest.raises(ValueError, match=r"write Column\(values, unit='m'\)"):
        tj.solve.Column(jnp.ones(()), "m")  # pyright: ignore[reportArgumentType]
