"""Compiled program that evaluates chunks of designs on one or several devices.

The devices may belong to several processes, which `jax.distributed` connects.
"""

import contextlib
import hashlib
from collections import deque, OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from .._compile.batching import CPU_BATCH_SIZE, single_threaded_batch_size
from .._compile.compilation import compile_lowered
from .._compile.program_key import program_key
from .._utils.host import padded_size
from ..designs.designs import Designs, DesignStructure
from .outputs import study_output, StudyOutput


# Smallest and largest default number of designs in a chunk of a large sweep, and the
# largest fraction of padding, on a processor and on an accelerator. An accelerator
# evaluates a few large chunks in less time than many small ones.
_CPU_CHUNKS, _ACCELERATOR_CHUNKS = (128, 4096, 1 / 4), (2**14, 2**17, 1 / 2)

# Memory that a chunk may use by default: bytes on a processor, and a fraction of the
# memory of an accelerator
_CPU_MEMORY, _ACCELERATOR_MEMORY = 2**30, 1 / 2

_MOST_PROGRAMS = 32  # that are kept


def default_chunk_size(count: int, mesh: Mesh | None) -> int:
    """Choose the number of designs that each device evaluates in one call.

    It is a power of two, so that sweeps over other numbers of designs use the same
    program. With more designs than the smallest chunk has, the padding of the last chunk
    is at most a quarter of the designs on a processor, and half of them on an
    accelerator, if possible.
    """
    devices = jax.devices()[:1] if mesh is None else list(mesh.devices.flat)
    per_device = -(-count // len(devices))
    on_cpu = devices[0].platform == "cpu"
    smallest, largest, padding = _CPU_CHUNKS if on_cpu else _ACCELERATOR_CHUNKS
    if per_device <= smallest:
        return padded_size(per_device)
    size = largest
    while size > smallest and -per_device % size > padding * per_device:
        size //= 2
    return size


def default_memory(mesh: Mesh | None) -> float | int:
    """Choose the memory that a chunk may use on each device; bytes."""
    device = (jax.local_devices() if mesh is None else mesh.local_devices)[0]
    statistics = device.memory_stats() or {}  # a processor has none
    if "bytes_limit" not in statistics:
        return _CPU_MEMORY
    return _ACCELERATOR_MEMORY * statistics["bytes_limit"]


class Program:
    """Compiled program that evaluates one chunk of designs on each device.

    A device evaluates `chunk_size` designs in one call. If they need more than `memory`
    bytes, `fit_memory` reduces the size, unless it is fixed. `derivatives` are the names
    of the outputs that are differentiated. Without a mesh, the default device is used.
    """

    def __init__(
        self,
        study: Callable[[Any], Any],
        structure: DesignStructure,
        derivatives: tuple[str, ...],
        chunk_size: int,
        memory: float | int,
        mesh: Mesh | None,
        fixed_chunk_size: bool,
    ):
        self.structure, self.mesh, self.memory = structure, mesh, memory
        self._evaluate = study_output(study, structure, derivatives)
        self._batch_size = CPU_BATCH_SIZE
        self._compiled: Any = None
        self._fixed_chunk_size, self.chunk_size = fixed_chunk_size, chunk_size
        self._trace()
        settings = structure, derivatives, chunk_size, memory, mesh, fixed_chunk_size
        outputs = jax.tree.structure(self._traced.out_info)
        self.key = settings, outputs, program_key(self._traced.jaxpr)

    def fit_memory(self) -> None:
        """Reduce the chunk size until a chunk fits into the memory.

        This compiles the program. A program with a fixed chunk size is compiled when it
        runs for the first time.
        """
        while not self._fixed_chunk_size:
            self._compile()
            fits = self._needed_memory <= self.memory
            self._fixed_chunk_size = fits or self.chunk_size == 1
            if not self._fixed_chunk_size:
                fraction = 0.9 * self.memory / self._needed_memory
                fitting = int(fraction * self.chunk_size)
                self.chunk_size = max(1, fitting)
                self._trace()
                self.lower()

    @property
    def device_count(self) -> int:
        return 1 if self.mesh is None else self.mesh.size

    @property
    def platform(self) -> str:
        """Platform of the devices, such as "cpu" or "gpu"."""
        if self.mesh is None:
            return jax.default_backend()
        return self.mesh.devices.flat[0].platform

    def chunk_count(self, designs: Designs) -> int:
        return -(-len(designs) // self.chunk_size)

    def run(
        self, designs: Designs, chunks: Sequence[int]
    ) -> Iterator[tuple[int, StudyOutput]]:
        """Evaluate chunks of designs, and yield those that this process has evaluated.

        A chunk has its number, and the outputs of its designs. The devices evaluate the
        next chunks while the caller uses the previous ones. The last chunk of a sweep is
        padded with copies of the last design. An error of a solve in the study is raised
        as a `RuntimeError`.
        """
        if not chunks:
            return
        if self._compiled is None:
            self._compile()
        if (needed := self._needed_memory) > self.memory:
            remedy = "Reduce `chunk_size`, or increase `memory`."
            if self.chunk_size == 1:
                remedy = "Increase `memory`."
            raise ValueError(
                f"`chunk_size` is {self.chunk_size:,}, for which a device needs "
                f"{needed / 2**20:,.3g} MiB, but `memory` is "
                f"{self.memory / 2**20:,.3g} MiB. {remedy}"
            )
        running: deque[tuple[tuple[int, ...], StudyOutput]] = deque()
        with _clear_study_errors():
            for first in range(0, len(chunks), self.device_count):
                group = tuple(chunks[first : first + self.device_count])
                running.append((group, self._start(designs, group)))
                if len(running) > 1:
                    yield from self._collect(*running.popleft())
            while running:
                yield from self._collect(*running.popleft())

    def evaluate(self, parameters: Sequence[np.ndarray]) -> StudyOutput:
        """Evaluate one chunk of designs on the default device.

        The first axis of each parameter has one entry for each design.
        """
        if self._compiled is None:
            self._compile()
        compiled: Any = self._compiled
        with _clear_study_errors():
            return jax.tree.map(np.asarray, compiled(list(parameters)))

    def chunk_owners(self, designs: Designs) -> np.ndarray:
        """Determine the index of the process that evaluates each chunk of a sweep."""
        chunks = np.arange(self.chunk_count(designs))
        if self.mesh is None:
            return np.full(len(chunks), jax.process_index())
        owners = np.array([device.process_index for device in self.mesh.devices.flat])
        return owners[chunks % self.device_count]

    def _trace(self) -> None:
        """Trace the study anew, because the values that it uses may have changed."""

        def evaluate_chunk(parameters: list[jax.Array]) -> StudyOutput:
            return self._evaluate_chunk(parameters)

        self._traced = jax.jit(evaluate_chunk).trace(self._arguments(self.chunk_size))

    def lower(self) -> None:
        """Lower the program, and determine the shapes of its outputs."""
        while True:
            lowered = self._traced.lower()
            text = lowered.as_text()
            batch_size = single_threaded_batch_size(text)
            if batch_size >= min(self._batch_size, self.chunk_size):
                break
            self._batch_size = batch_size
            self._trace()
        self.output: StudyOutput = jax.tree.map(_shape, lowered.out_info)
        self.fingerprint = hashlib.sha256(text.encode()).hexdigest()
        self._lowered = lowered

    def _compile(self) -> None:
        """Compile the program, and determine the memory that it needs on a device."""
        if self.mesh is None and self.chunk_size == 1:
            # It compiles for longer than it runs.
            self._compiled = compile_lowered(self._lowered, self.platform)
        elif self.mesh is None:
            self._compiled = self._lowered.compile()
        else:
            self._compiled = self._compile_for_mesh(self.mesh)
        self._needed_memory = _memory_size(self._compiled)

    def _compile_for_mesh(self, mesh: Mesh) -> Any:
        """Compile a program in which each device evaluates a chunk of its own."""
        spec, sharding = self._partition, NamedSharding(mesh, self._partition)
        sharded = jax.shard_map(
            self._evaluate_chunk, mesh=mesh, in_specs=spec, out_specs=spec,
            check_vma=False,
        )  # fmt: skip
        arguments = [
            jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding)
            for leaf in self._arguments(self.chunk_size * self.device_count)
        ]
        return jax.jit(sharded).lower(arguments).compile()

    @property
    def _partition(self) -> PartitionSpec:
        """Partition of the designs over all axes of the mesh."""
        assert self.mesh is not None
        return PartitionSpec(tuple(self.mesh.axis_names))

    def _arguments(self, count: int) -> list[jax.ShapeDtypeStruct]:
        """List the shapes and number types of the parameters of so many designs."""
        return [
            jax.ShapeDtypeStruct((count, *shape), dtype)
            for shape, dtype in self.structure.shapes
        ]

    def _evaluate_chunk(self, parameters: list[jax.Array]) -> StudyOutput:
        """Evaluate a chunk of designs, in batches if it runs on a processor."""
        count = len(parameters[0])
        if count == 1:
            # A batch would compute both branches of each condition.
            output = self._evaluate([parameter[0] for parameter in parameters])
            return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], output)
        if self.platform != "cpu" or count <= self._batch_size:
            return jax.vmap(self._evaluate)(parameters)
        # The last batch is padded with the last design, because a shorter batch would
        # have to be compiled in addition.
        padding = -count % self._batch_size
        padded = [jnp.concatenate([p, p[-1:].repeat(padding, 0)]) for p in parameters]
        output = jax.lax.map(self._evaluate, padded, batch_size=self._batch_size)
        return jax.tree.map(lambda leaf: leaf[:count], output)

    def _start(self, designs: Designs, group: tuple[int, ...]) -> StudyOutput:
        """Start the evaluation of a group of chunks, at most one for each device.

        The devices may still be computing the outputs when they are returned.
        """
        group += (group[-1],) * (self.device_count - len(group))
        size = self.chunk_size
        chunks = [designs.rows(chunk * size, (chunk + 1) * size) for chunk in group]
        if self.mesh is None:
            return self._compiled(chunks[0])
        sharding = NamedSharding(self.mesh, self._partition)

        def of_device(parameter: int) -> Callable[..., np.ndarray]:
            """Return the function by which JAX obtains the chunk of a device."""
            return lambda index: chunks[(index[0].start or 0) // size][parameter]

        return self._compiled(
            [
                jax.make_array_from_callback(argument.shape, sharding, of_device(k))
                for k, argument in enumerate(self._arguments(len(group) * size))
            ]
        )

    def _collect(
        self, group: tuple[int, ...], output: StudyOutput
    ) -> Iterator[tuple[int, StudyOutput]]:
        """Wait for a group of chunks, and yield those that this process has evaluated."""
        if self.mesh is None:
            yield group[0], jax.tree.map(np.asarray, output)
            return
        leaves, tree = jax.tree.flatten(output)
        starts = [shard.index[0].start or 0 for shard in leaves[0].addressable_shards]
        for shard, start in enumerate(starts):
            position = start // self.chunk_size
            if position < len(group):
                arrays = [leaf.addressable_shards[shard].data for leaf in leaves]
                outputs = jax.tree.unflatten(tree, map(np.asarray, arrays))
                yield group[position], outputs


def find_program(*arguments: Any) -> Program:
    """Create a program, or find an equal one, which may be compiled already.

    The study is traced in each call, because it may use values that have changed.
    """
    program = Program(*arguments)
    try:
        known = _programs.get(program.key)
    except TypeError:  # A design with static lists cannot be hashed.
        program.lower()
        return program
    if known is not None:
        _programs.move_to_end(program.key)
        return known
    program.lower()
    _programs[program.key] = program
    if len(_programs) > _MOST_PROGRAMS:
        _programs.popitem(last=False)
    return program


_programs: OrderedDict[Hashable, Program] = OrderedDict()


@contextlib.contextmanager
def _clear_study_errors() -> Iterator[None]:
    """Explain the error of a solve that a study calls without `throw=False`."""
    try:
        yield
    except jax.errors.JaxRuntimeError as error:
        if "callback" not in str(error).lower():
            raise
        raise RuntimeError(
            "A solve in the study failed for a design and raised an error, which stopped "
            "all others. Call the solver with `throw=False` and return its `result`; a "
            "failed design then returns NaN and a failure code, and the others continue."
        ) from error


def synchronize(step: str) -> None:
    """Wait until all processes have reached a step, which has the same name in each."""
    if jax.process_count() > 1:
        from jax.experimental import multihost_utils

        multihost_utils.sync_global_devices(step)


def gather(
    values: Mapping[str, np.ndarray], owners: np.ndarray
) -> Mapping[str, np.ndarray]:
    """Combine the values that several processes have computed.

    The first axis of each array has one entry for each design. In each process, only the
    entries of its own designs are valid; `owners` has the index of the process for each.
    """
    if jax.process_count() == 1:
        return values
    from jax.experimental import multihost_utils

    rows = np.arange(len(owners))
    return {
        name: np.asarray(multihost_utils.process_allgather(array))[owners, rows]
        for name, array in values.items()
    }


def _shape(leaf: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype)


def _memory_size(compiled: Any) -> int:
    """Memory that a program needs on a device, if its backend reports it; bytes."""
    analysis = compiled.memory_analysis()
    names = ("temp_size_in_bytes", "output_size_in_bytes", "argument_size_in_bytes")
    return sum(int(getattr(analysis, name, 0)) for name in names)
