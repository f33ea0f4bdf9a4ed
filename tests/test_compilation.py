"""Numbers of compiled programs, programs on disk, and functions of the user in them."""

import gc
import json
import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mostly_slow

import twistorjax as tj
from twistorjax._compile import compilation
from twistorjax._compile.compilation import fast_compile
from twistorjax._compile.traced_function import traced, TracedFunction
from twistorjax.examples import four_bar, stage


COUNT = """
import json
import jax
import twistorjax as tj

{first}
tj.configure(cache={cache!r})
compiled, loaded, counts = [], [], []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, *_, **__: compiled.append(name)
    if name == "/jax/core/compile/backend_compile_duration" else None
)
jax.monitoring.register_event_listener(
    lambda name, **__: loaded.append(name)
    if name == "/jax/compilation_cache/cache_hits" else None
)
for step in {steps!r}:
    exec(step)
    counts.append((len(compiled), len(loaded)))
    compiled.clear(), loaded.clear()
print(json.dumps(counts))
"""


def count_programs(
    *steps: str, cache: bool | str = False, first: str = "", test_flags: bool = True
):
    """Count the programs that each step requests, and those loaded from the cache.

    Args:
        steps: Python code.
        cache: Argument of `configure`.
        first: Python code before the call of `configure`.
        test_flags: Whether the options of XLA are those of the tests.
    """
    code = COUNT.format(steps=steps, cache=cache, first=first)
    environment = dict(os.environ)
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    if not test_flags:
        environment.pop("XLA_FLAGS", None)
    process = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )
    return json.loads(process.stdout)


BUILD = "stage = tj.examples.stage.microstage()"
SOLVE = "tj.equilibrium(stage, drives=[tj.Drive('6', x=5e-6)])"


MAPS = (
    "se2.compose(pose, pose)",
    "se2.twist(pose)",
    "se2.exp(pose)",
    "se2.transform_wrench(pose, pose)",
    "twistors.twistor(pose)",
    "leaf(pose)",
    "leaf.wrench(pose)",
    "leaf.tangent_stiffness(pose)",
)


@pytest.fixture(scope="module")
def counts():
    """Count the programs of public maps and of equilibria, in one process."""
    setup = (
        "import numpy as np; from twistorjax.geometry import se2, twistors; "
        "pose = jax.device_put(np.array([0.3, 1e-3, 2e-3])); "
        "leaf = tj.Quadratic(np.eye(3))"
    )
    equilibria = (
        BUILD,
        "first = tj.equilibrium(stage, loads=[tj.Load('6', force=(1.0, 0.0))])",
        "tj.equilibrium(stage, loads=[tj.Load('6', force=(1.0, 0.0)), "
        "tj.Load('4', moment=1e-3), tj.Load('2', (0, 0, 1), at=(1e-3, 0))])",
        "tj.equilibrium(stage, loads=[tj.Load('6', force=(2.0, 0.0))], start=first)",
    )
    counts = count_programs(setup, *MAPS, "; ".join(MAPS), *equilibria)
    return {"maps": counts[:-4], "equilibria": counts[-4:]}


def test_each_public_map_is_one_program(counts):
    assert counts["maps"] == [[0, 0], *len(MAPS) * [[1, 0]], [0, 0]]


@pytest.mark.slow
def test_a_second_process_loads_the_program_from_the_cache(tmp_path):
    """Only the equilibrium is compiled, and the order of the imports does not matter."""
    settings = {"cache": str(tmp_path), "test_flags": False}
    assert count_programs(BUILD, SOLVE, **settings) == [[0, 0], [1, 0]]
    early = "from twistorjax.solve import statics"
    assert count_programs(BUILD, SOLVE, first=early, **settings) == [[0, 0], [1, 1]]


@pytest.mark.slow
def test_another_number_of_times_does_not_compile_again():
    setup = """
hinge = tj.Hinge("spring", "wall", "block", tj.Quadratic(np.eye(3)), at=(0, 0, 0))
bodies = [tj.Body("wall"), tj.Body("block", mass=1.0, inertia=1.0)]
oscillator = tj.Mechanism(bodies, [hinge], fixed=["wall"])
def drive(time):
    return [tj.Drive("block", x=time**2)]
"""
    counts = count_programs(
        f"import numpy as np\n{setup}",
        "tj.simulate(oscillator, [0.0, 0.01], drives=drive)",
        "tj.simulate(oscillator, [0.0, 0.005, 0.01], drives=drive)",
    )
    assert counts[1][0] > 0
    assert counts[2][0] == 0


def test_other_loads_and_an_equilibrium_as_start_do_not_compile_again(counts):
    assert counts["equilibria"] == [[0, 0], [1, 0], [0, 0], [0, 0]]


@pytest.mark.slow
def test_another_number_of_readings_does_not_compile_again():
    setup = """
from twistorjax.identification import BodySensor, HingeTest, Parameter, StaticTest
def spring(stiffness):
    energy = tj.Quadratic(jax.numpy.diag(jax.numpy.stack([1.0, stiffness, 10.0])))
    hinge = tj.Hinge("spring", "wall", "block", energy, at=(0.0, 0.0, 0.0))
    return tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])
camera = BodySensor("block", "x", standard_deviation=1e-4)
def identify(*forces):
    cases = [[tj.Load("block", force=(force, 0.0))] for force in forces]
    displacements = [[force / 100] for force in forces]
    poses = [[0.0, force / 100, 0.0] for force in forces]
    data = [
        StaticTest(cases, [camera]).measurement(displacements),
        HingeTest("spring", poses, (1e-3, 0.1, 0.1)).measurement(
            [[0.0, force, 0.0] for force in forces]
        ),
    ]
    found = tj.identification.identify(spring, Parameter(80.0, "N/m", lower=0), data)
    assert abs(found.estimates - 100) < 1e-6
    assert found.jacobian.shape == (4 * len(forces), 1)
    assert [len(table) for table in found.residuals] == 2 * [len(forces)]
"""
    counts = count_programs(setup, "identify(2.0, 3.0, 5.0)", "identify(1.0, 4.0)")
    assert counts[1][0] > 0
    assert counts[2][0] == 0


@pytest.mark.slow
def test_another_number_of_designs_does_not_compile_again():
    sweep = "tj.sweep(study, {{'x': np.linspace(0.0, 1.0, {})}})"
    counts = count_programs(
        "import numpy as np; study = lambda design: {'y': design['x'] ** 2}",
        sweep.format(70),
        sweep.format(100),
    )
    assert counts[1][0] > 0
    assert counts[2][0] == 0


@pytest.mark.slow
def test_another_path_of_the_same_structure_does_not_compile_again():
    setup = """
from twistorjax.examples.truss import von_mises_truss
push = [tj.Load("apex", force=(0.0, -40.0))]
"""
    counts = count_programs(
        setup,
        "tj.path(von_mises_truss(), loads=push, max_points=200)",
        "tj.path(von_mises_truss(0.31), loads=push, max_points=150, largest_step=0.08)",
        "tj.path(von_mises_truss(), loads=push, max_points=210, load_factors=(-1, 0.9))",
        "tj.path(von_mises_truss(), loads=push, max_points=180, direction=-1)",
    )
    assert counts[1][0] > 0
    assert [new for new, _ in counts[2:]] == [0, 0, 0]


def solvers():
    """Return a function of each solver, and its argument."""
    loads = [tj.Load("4", force=(0.0, 1.0))]
    small = stage.microstage()
    linkage = four_bar.four_bar()
    beam = tj.flexures.Beam(
        tj.Material(modulus=1e9, poisson=0.3), length=0.1, thickness=0.01, width=0.01
    )
    return {
        "equilibrium": lambda: tj.equilibrium(small, loads=loads, throw=False),
        "linearize": lambda: tj.linearize(small)(loads=loads, throw=False),
        "vibrations": lambda: tj.vibrations(linkage, throw=False).frequencies,
        "frequency_response": lambda: (
            tj.frequency_response(linkage, [1.0], throw=False).displacements
        ),
        "simulate": lambda: (
            four_bar.driven_motion(
                linkage, jnp.array([0.0, 0.01]), throw=False
            ).displacements
        ),
        "beam_under_load": lambda: tj.flexures.beam_under_load(beam, jnp.zeros(3)).pose,
        "surrogate": lambda: tj.flexures.surrogate(beam, rotation=0.5, order=4).energy,
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", list(solvers()))
def test_programs_contain_no_callbacks(name):
    """JAX does not store a program with callbacks to Python on disk."""
    function = solvers()[name]
    text = jax.jit(lambda: eqx.filter(function(), eqx.is_array)).lower().as_text()
    assert "callback" not in text


@pytest.mark.slow
def test_a_cache_folder_that_is_already_set_is_kept(tmp_path):
    code = (
        "import jax, twistorjax as tj; tj.configure(); print(jax.numpy.zeros(1).dtype, "
        "jax.config.jax_compilation_cache_dir, jax.config.jax_compilation_cache_max_size)"
    )
    process = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "JAX_COMPILATION_CACHE_DIR": str(tmp_path)},
    )
    assert process.stdout.split() == ["float64", str(tmp_path), "-1"]


def test_an_invalid_size_of_the_cache_is_reported():
    with pytest.raises(ValueError, match="`cache_size` is 0, but must be positive"):
        tj.configure(cache_size=0)


EMITTERS = "xla_cpu_use_fusion_emitters: false"
LOOPS = "xla_cpu_small_while_loop_byte_threshold"
if_emitters_are_an_option = pytest.mark.skipif(
    compilation._JAXLIB >= (0, 11),
    reason="jaxlib 0.10 is the last version with an option for the fusion emitters",
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "arguments", "expected"),
    [
        ("", "fast_compilation=False", {LOOPS}),
        *(
            pytest.param(*case, marks=if_emitters_are_an_option)
            for case in (
                ("", "", {EMITTERS, LOOPS}),
                ("", "fast_loops=False", {EMITTERS}),
                ("--xla_cpu_use_fusion_emitters=true", "", {LOOPS}),
            )
        ),
    ],
)
def test_configure_sets_options_of_xla(tmp_path, given, arguments, expected):
    """The options that XLA uses are in a file that it writes about each program."""
    code = (
        f"import jax, twistorjax as tj; tj.configure(cache=False, {arguments}); "
        "jax.jit(jax.numpy.sin)(1.0)"
    )
    dump = f"--xla_dump_to={tmp_path} --xla_dump_hlo_as_text {given}"
    subprocess.run(
        [sys.executable, "-c", code], check=True, env={**os.environ, "XLA_FLAGS": dump}
    )
    (used,) = tmp_path.glob("*jit_sin.debug_options")
    options = used.read_text()
    assert {option for option in (EMITTERS, LOOPS) if option in options} == expected


def test_options_that_xla_does_not_know_are_left_out(monkeypatch):
    """The attempt to compile with them is not repeated, which would take time."""
    monkeypatch.setitem(compilation._FAST, "xla_unknown", True)
    attempts = []

    def jit(function, **settings):
        compiled = jax.jit(function, **settings)

        def call(*arguments):
            attempts.append("compiler_options" in settings)
            return compiled(*arguments)

        return call

    doubled = fast_compile(lambda value: 2 * value, jit=jit)
    assert [doubled(jnp.asarray(x)) for x in (1.5, 2.0)] == [3.0, 4.0]
    assert attempts == [True, False, False]
    lowered = jax.jit(lambda value: 3 * value).lower(1.0)
    assert compilation.compile_lowered(lowered, "cpu")(2.0) == 6.0


def test_the_garbage_collection_pauses_only_while_a_program_is_traced():
    enabled = []

    @fast_compile
    def doubled(value):
        enabled.append(gc.isenabled())
        if value.ndim:
            raise TypeError
        return 2 * value

    assert doubled(jnp.asarray(1.5)) == 3.0
    with pytest.raises(TypeError):
        doubled(jnp.ones(2))
    assert enabled == [False, False]
    assert gc.isenabled()


def block(stiffness=100.0):
    """Return a block on a spring, which can move along x only."""
    energy = tj.Quadratic(jnp.diag(jnp.stack([1.0, jnp.asarray(stiffness), 1.0])))
    hinge = tj.Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
    bodies = [tj.Body("wall"), tj.Body("block", mass=1.0, inertia=1.0)]
    fixed = {"wall": ["angle", "x", "y"], "block": ["angle", "y"]}
    return tj.Mechanism(bodies, [hinge], fixed=fixed)


# Value that the following functions use, which are the same in all calls
VALUE = np.array([0.1])


def constant_load(time):
    return [tj.Load("block", force=(100.0 * VALUE[0], 0.0))]


def position_after_half_a_period():
    """A constant force f on a spring k moves a block to 2 f / k."""
    settings = {"loads": constant_load, "tolerance": 1e-9}
    motion = tj.simulate(block(), [0.0, np.pi / 10], **settings)
    return motion.displacement("block")[-1, 1] / 2


def stroke(factor):
    return {"spring": jnp.stack([0.0, factor * VALUE[0], 0.0])}


def distance(point):
    return point.displacement("block")[1] - VALUE[0] ** 2


def load_factor_at_the_end_of_a_path():
    """A stroke moves a block without a load."""
    path = tj.path(block(), strokes=stroke, until=distance)
    return path.load_factors[-1]


STOP = tj.Constraint("stop", ["block"], lambda pose, time: pose[1] - VALUE[0])


def position_by_a_constraint():
    return tj.equilibrium(block(), constraints=[STOP]).displacement("block")[1]


def scaled_block(stiffness):
    return block(100.0 * stiffness / VALUE[0])


def identified_stiffness():
    from twistorjax.identification import BodySensor, identify, Parameter, StaticTest

    camera = BodySensor("block", "x", standard_deviation=1e-4)
    test = StaticTest([[tj.Load("block", force=(1.0, 0.0))]], [camera])
    start, data = Parameter(0.5, lower=0.0), [test.measurement([[0.01]])]
    return identify(scaled_block, start, data).estimates


def thickness(position):
    return VALUE[0] + 0.0 * position


def thickness_of_a_beam():
    """The angle of the tip of a cantilever under a moment is M L / (E I)."""
    material = tj.Material(modulus=12e9, poisson=0.3)
    beam = tj.flexures.Beam(material, length=1.0, thickness=thickness, width=1.0)
    solution = tj.flexures.beam_under_load(beam, np.array([1e3, 0.0, 0.0]))
    return (1e-6 / solution.pose[0]) ** (1 / 3)


USES = [
    position_by_a_constraint, thickness_of_a_beam, position_after_half_a_period,
    load_factor_at_the_end_of_a_path, identified_stiffness,
]  # fmt: skip


@pytest.mark.parametrize("use", mostly_slow(USES, fast=2))
def test_a_function_of_the_user_has_the_values_at_the_time_of_the_call(use):
    for number in (0.1, 0.2, 0.1):
        VALUE[0] = number
        assert float(use()) == pytest.approx(number, rel=1e-6)


def test_functions_that_compute_the_same_share_compiled_programs():
    programs = []

    @fast_compile
    def evaluated(function, position):
        programs.append(function)
        return function(position)

    def function(factor, exponent=2):
        return traced(lambda x: factor * x**exponent, jnp.zeros(()))

    position = jnp.asarray(3.0)
    assert evaluated(function(2.0), position) == 18.0
    assert evaluated(function(2.0), position) == 18.0
    assert len(programs) == 1
    assert evaluated(function(4.0), position) == 36.0  # a number is in the program
    assert len(programs) == 2
    for factor in (1.0, 2.0, 4.0):  # an array is an argument of the program
        assert evaluated(function(np.array(factor)), position) == 9 * factor
    assert len(programs) == 3
    assert evaluated(function(np.array(1.0), exponent=3), position) == 27.0
    assert len(programs) == 4
    assert traced(jnp.sin) is jnp.sin
    assert isinstance(traced(lambda x: x), TracedFunction)


def test_functions_with_other_derivative_rules_are_different_programs():
    """The derivative of x^2 times a factor, which only the rule contains."""

    def square_with_rule(factor):
        @jax.custom_jvp
        def square(x):
            return x**2

        square.defjvps(lambda tangent, _, x: factor * 2 * x * tangent)
        return square

    @jax.jit
    def slope(function, position):
        return jax.grad(function)(position)

    for factor in (1.0, 3.0):
        square = traced(square_with_rule(factor), jnp.zeros(()))
        assert slope(square, 2.0) == 4 * factor


def test_a_traced_function_is_differentiated_by_what_it_contains():
    def slope(factor):
        def sum_and_others(x):
            return {"sum": factor * x, "name": "a", "number": jnp.asarray(3.0)}

        function = traced(sum_and_others, jnp.zeros(()))
        result = jax.vmap(lambda x: function(x)["sum"])(jnp.arange(4.0))
        assert function(1.0)["name"] == "a"
        assert isinstance(function(1.0)["number"], jax.Array)
        return jnp.sum(result)

    assert jax.grad(slope)(2.0) == 6.0


@pytest.mark.slow
def test_a_breakpoint_in_mechanics_is_reached_in_each_call():
    """With `debug`, no program is in between, so that the values are known there."""
    code = """
import jax.numpy as jnp
import twistorjax as tj
from jax.core import Tracer
from twistorjax.assembly.assembly import HingeAssembly

tj.configure(debug=True)
seen, tangent, angles = [], HingeAssembly.tangent, []

class Spring(tj.AbstractEnergy):
    stiffness: jnp.ndarray

    def stored_energy(self, displacement):
        angles.append(str(displacement.angle))  # GradTracer(primal=0.05)
        return self.stiffness * jnp.sum(jnp.stack(displacement.twist()) ** 2) / 2

def recorded(hinges, displacements, *predicted):
    seen.append(isinstance(displacements, Tracer))
    return tangent(hinges, displacements, *predicted)

HingeAssembly.tangent = recorded
bodies = [tj.Body("wall"), tj.Body("block"), tj.Body("end")]
hinges = [
    tj.Hinge("first", "wall", "block", Spring(jnp.array(1.0)), at=(0, 0, 0)),
    tj.Hinge("second", "block", "end", Spring(jnp.array(1.0)), at=(0, 0, 0)),
]
mechanism = tj.Mechanism(bodies, hinges, fixed=["wall"])
counts = []
for force in (0.1, 0.2):
    found = tj.equilibrium(mechanism, loads=[tj.Load("block", force=(force, 0.0))])
    assert abs(found.displacement("block")[1] - force) < 1e-12
    counts.append(len(seen))
assert not any(seen) and 0 < counts[0] < counts[1]
assert angles and not any("batched" in angle for angle in angles)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
