"""A sweep's program, chunk after chunk, on one device or on many."""

import hashlib
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from .designs import Designs, Kind
from .outputs import study_output, StudyOutput


# designs that a device takes at once by default: on a processor, on an accelerator
_CHUNK, _WIDE = 4096, 2**17
# side by side on a processor: so few that what they are about stays in its cache, and
# that a batch's slowest design holds up few others
_SIDE = 128


def chunk_of(count: int, mesh: Mesh | None) -> int:
    """How many of so many designs a device takes at once, if nothing else is asked."""
    devices = jax.devices()[:1] if mesh is None else list(mesh.devices.flat)
    most = -(-count // len(devices))
    rounds = -(-most // (_CHUNK if devices[0].platform == "cpu" else _WIDE))
    return -(-most // rounds)


class Program:
    """What is done to one chunk of designs, compiled; on each device of a mesh at once.

    Args:
        study: of one design.
        kind: of what designs consist.
        derivatives: names of answers that are differentiated.
        chunk: how many a device takes at once.
        memory: that a chunk may take on a device; bytes. Where it would take more the
            chunk is made smaller.
        mesh: of devices, or nothing for the default one.
        fixed: whether the chunk must stay as it is.
    """

    def __init__(
        self,
        study: Callable[[Any], Any],
        kind: Kind,
        derivatives: tuple[str, ...],
        chunk: int,
        memory: float | int,
        mesh: Mesh | None,
        fixed: bool,
    ):
        self.kind, self.mesh, self.memory = kind, mesh, memory
        self._tell, self._side = study_output(study, kind, derivatives), _SIDE
        self._compiled: Any = None
        self._fixed, self.chunk = fixed, chunk
        self._lower()

    def fit(self) -> None:
        """Make the chunk as small as the memory asks, unless it must stay as it is.

        This compiles the program. A program with a fixed chunk is compiled when it is
        run, if there is something to do.
        """
        while not self._fixed:
            needed = self._compile()
            self._fixed = needed <= self.memory or self.chunk == 1
            if not self._fixed:
                self.chunk = max(1, int(0.9 * self.chunk * self.memory / needed))
                self._lower()

    @property
    def devices(self) -> int:
        """How many there are."""
        return 1 if self.mesh is None else self.mesh.size

    @property
    def platform(self) -> str:
        """Of the devices: "cpu", "gpu"."""
        if self.mesh is None:
            return jax.default_backend()
        return self.mesh.devices.flat[0].platform

    def count(self, designs: Designs) -> int:
        """How many chunks some designs are."""
        return -(-len(designs) // self.chunk)

    def _lower(self) -> None:
        """Trace the program for the chunk as it is, which tells what it returns."""
        while True:
            lowered = jax.jit(self._all).lower(self._arguments(self.chunk))
            text = lowered.as_text()
            if (side := _unshared(text)) >= self._side:
                break
            self._side = side
        self.told: StudyOutput = jax.tree.map(_shape, lowered.out_info)
        self.fingerprint = hashlib.sha256(text.encode()).hexdigest()
        self._lowered = lowered

    def _compile(self) -> int:
        """Makes the program ready, and tells what it takes on a device; bytes."""
        mesh = self.mesh
        self._compiled = self._lowered.compile() if mesh is None else self._spread(mesh)
        return _bytes(self._compiled)

    def run(
        self, designs: Designs, chunks: Sequence[int]
    ) -> Iterator[tuple[int, StudyOutput]]:
        """What is told of some chunks, by their numbers: of those on this process.

        The next chunks are under way while one is read.

        Raises:
            ValueError: a chunk takes more memory than there is to be.
            RuntimeError: the study raised.
        """
        if not chunks:
            return
        needed = self._compile() if self._compiled is None else _bytes(self._compiled)
        if needed > self.memory:
            least = "Give more." if self.chunk == 1 else "Make the chunk smaller."
            raise ValueError(
                f"`chunk` is {self.chunk:,}, which takes {needed / 2**20:,.3g} MiB on a "
                f"device, but `memory` is {self.memory / 2**20:,.3g} MiB. {least}"
            )
        waiting: deque[tuple[tuple[int, ...], StudyOutput]] = deque()
        try:
            for first in range(0, len(chunks), self.devices):
                group = tuple(chunks[first : first + self.devices])
                waiting.append((group, self._start(designs, group)))
                if len(waiting) > 1:
                    yield from self._read(*waiting.popleft())
            while waiting:
                yield from self._read(*waiting.popleft())
        except jax.errors.JaxRuntimeError as error:
            if "callback" not in str(error).lower():
                raise
            raise RuntimeError(
                "A solve of some design failed within the study and raised, which ends "
                "the whole sweep. Call it with `throw=False`, and answer its `result` "
                "too: then that design is marked, and harms no other."
            ) from error

    def owners(self, designs: Designs) -> np.ndarray:
        """The number of the process that has each chunk, if all are to be done."""
        chunks = np.arange(self.count(designs))
        if self.mesh is None:
            return np.full(len(chunks), jax.process_index())
        each = np.array([device.process_index for device in self.mesh.devices.flat])
        return each[chunks % self.devices]

    def _start(self, designs: Designs, group: tuple[int, ...]) -> StudyOutput:
        group += (group[-1],) * (self.devices - len(group))
        firsts = [chunk * self.chunk for chunk in group]
        # the last design is repeated where there are no more
        rows = [
            np.minimum(np.arange(first, first + self.chunk), len(designs) - 1)
            for first in firsts
        ]
        if self.mesh is None:
            return self._compiled(designs.take(rows[0]))
        sharding = NamedSharding(self.mesh, self._split)
        leaves = designs.take(np.concatenate(rows))
        return self._compiled(
            [
                jax.make_array_from_callback(
                    leaf.shape, sharding, lambda index, leaf=leaf: leaf[index]
                )
                for leaf in leaves
            ]
        )

    def _read(
        self, group: tuple[int, ...], told: StudyOutput
    ) -> Iterator[tuple[int, StudyOutput]]:
        if self.mesh is None:
            yield group[0], jax.tree.map(np.asarray, told)
            return
        leaves, tree = jax.tree.flatten(told)
        here = [shard.index[0].start or 0 for shard in leaves[0].addressable_shards]
        for place, start in enumerate(here):
            which = start // self.chunk
            if which < len(group):
                parts = [
                    np.asarray(leaf.addressable_shards[place].data) for leaf in leaves
                ]
                yield group[which], jax.tree.unflatten(tree, parts)

    def _all(self, leaves: list[jax.Array]) -> StudyOutput:
        """What is told of a whole chunk."""
        count = len(leaves[0])
        if self.platform != "cpu" or count <= self._side:
            return jax.vmap(self._tell)(leaves)
        # filled up with the last, so that no shorter batch is compiled besides
        more = -count % self._side
        full = [jnp.concatenate([leaf, leaf[-1:].repeat(more, 0)]) for leaf in leaves]
        told = jax.lax.map(self._tell, full, batch_size=self._side)
        return jax.tree.map(lambda leaf: leaf[:count], told)

    @property
    def _split(self) -> PartitionSpec:
        """Over all axes of the mesh, whatever they are called."""
        assert self.mesh is not None
        return PartitionSpec(tuple(self.mesh.axis_names))

    def _arguments(self, count: int) -> list[jax.ShapeDtypeStruct]:
        return [
            jax.ShapeDtypeStruct((count, *shape), dtype)
            for shape, dtype in self.kind.shapes
        ]

    def _spread(self, mesh: Mesh) -> Any:
        """The program on all devices, each with a chunk of its own to the end."""
        split, sharding = self._split, NamedSharding(mesh, self._split)
        alone = jax.shard_map(
            self._all, mesh=mesh, in_specs=split, out_specs=split, check_vma=False
        )
        arguments = [
            jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding)
            for leaf in self._arguments(self.chunk * self.devices)
        ]
        return jax.jit(alone).lower(arguments).compile()


def _unshared(text: str) -> int:
    """How many designs side by side keep LAPACK from sharing its work among threads.

    Batches of matrices that it would share wait for one another in XLA's threads: of two
    devices of one processor, for ever (jaxlib 0.10). It shares what takes more than 2e5
    operations.
    """
    most = 0.0
    for line in text.splitlines():
        if not (call := re.search(r"@lapack_.(\w+?)_ffi", line)):
            continue
        part = {"potrf": 1 / 3, "trsm": 1 / 3, "getrf": 2 / 3}.get(call[1], 25.0)
        for shape in re.findall(r"tensor<([\dx]+)x[cf]\d+>", line):
            rows, columns = [1, 1, *map(int, shape.split("x"))][-2:]
            most = max(most, part * rows * columns * max(rows, columns))
    return max(1, min(_SIDE, int(2e5 / most))) if most else _SIDE


def _shape(leaf: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype)


def _bytes(compiled: Any) -> int:
    """What a program takes on a device while it runs, as far as its backend tells."""
    told = compiled.memory_analysis()
    names = ("temp_size_in_bytes", "output_size_in_bytes", "argument_size_in_bytes")
    return sum(int(getattr(told, name, 0)) for name in names)
