"""A sweep's program, chunk after chunk, on one device or on many."""

import hashlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from .lanes import Lanes
from .telling import Told


class Program:
    """What is done to one chunk of designs, compiled; on each device of a mesh at once.

    Args:
        tell: what is told of one design.
        lanes: the designs.
        chunk: how many a device takes at once.
        memory: that a chunk may take on a device; bytes. Where it would take more the
            chunk is made smaller.
        mesh: of devices, or nothing for the default one.
        fixed: whether the chunk must stay as it is.

    Raises:
        ValueError: not even one design fits, or a fixed chunk does not.
    """

    def __init__(
        self,
        tell: Callable[[list[jax.Array]], Told],
        lanes: Lanes,
        chunk: int,
        memory: float,
        mesh: Mesh | None,
        fixed: bool,
    ):
        self.lanes, self.mesh = lanes, mesh
        self._one = jax.vmap(tell)
        while True:
            self.chunk = chunk
            lowered = jax.jit(self._one).lower(self._arguments(chunk))
            self.told: Told = jax.tree.map(_shape, lowered.out_info)
            self.fingerprint = hashlib.sha256(lowered.as_text().encode()).hexdigest()
            self._compiled = lowered.compile() if mesh is None else self._spread(mesh)
            needed = _bytes(self._compiled) / self.devices
            if needed <= memory or (chunk == 1 and not fixed):
                break
            if fixed or chunk == 1:
                raise ValueError(
                    f"`chunk` is {chunk:,}, which takes {needed / 2**20:,.0f} MiB on a "
                    f"device, but `memory` is {memory / 2**20:,.0f} MiB. Make the chunk "
                    "smaller, or leave it out."
                )
            chunk = max(1, int(0.9 * chunk * memory / needed))

    @property
    def devices(self) -> int:
        """How many there are."""
        return 1 if self.mesh is None else self.mesh.size

    def run(self, chunks: Sequence[int]) -> Iterator[tuple[int, Told]]:
        """What is told of some chunks, by their numbers: of those on this process.

        The next chunks are under way while one is read.
        """
        waiting: deque[tuple[tuple[int, ...], Told]] = deque()
        for first in range(0, len(chunks), self.devices):
            group = tuple(chunks[first : first + self.devices])
            waiting.append((group, self._start(group)))
            if len(waiting) > 1:
                yield from self._read(*waiting.popleft())
        while waiting:
            yield from self._read(*waiting.popleft())

    @property
    def owners(self) -> np.ndarray:
        """The number of the process that has each chunk, if all are to be done."""
        chunks = np.arange(-(-len(self.lanes) // self.chunk))
        if self.mesh is None:
            return np.full(len(chunks), jax.process_index())
        each = np.array([device.process_index for device in self.mesh.devices.flat])
        return each[chunks % self.devices]

    def rows(self, chunk: int) -> np.ndarray:
        """The designs of a chunk; the last is repeated to fill it."""
        first = chunk * self.chunk
        return np.minimum(np.arange(first, first + self.chunk), len(self.lanes) - 1)

    def _start(self, group: tuple[int, ...]) -> Told:
        group += (group[-1],) * (self.devices - len(group))
        rows = [self.rows(chunk) for chunk in group]
        if self.mesh is None:
            return self._compiled(self.lanes.take(rows[0]))
        sharding = NamedSharding(self.mesh, self._split)
        leaves = self.lanes.take(np.concatenate(rows))
        return self._compiled(
            [
                jax.make_array_from_callback(
                    leaf.shape, sharding, lambda index, leaf=leaf: leaf[index]
                )
                for leaf in leaves
            ]
        )

    def _read(self, group: tuple[int, ...], told: Told) -> Iterator[tuple[int, Told]]:
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

    @property
    def _split(self) -> PartitionSpec:
        """Over all axes of the mesh, whatever they are called."""
        assert self.mesh is not None
        return PartitionSpec(tuple(self.mesh.axis_names))

    def _arguments(self, count: int) -> list[jax.ShapeDtypeStruct]:
        one = self.lanes.take(np.zeros(1, int))
        kinds = [jax.dtypes.canonicalize_dtype(leaf.dtype) for leaf in one]
        return [
            jax.ShapeDtypeStruct((count, *leaf.shape[1:]), kind)
            for leaf, kind in zip(one, kinds, strict=True)
        ]

    def _spread(self, mesh: Mesh) -> Any:
        """The program on all devices, each with a chunk of its own to the end."""
        split, sharding = self._split, NamedSharding(mesh, self._split)
        alone = jax.shard_map(
            self._one, mesh=mesh, in_specs=split, out_specs=split, check_vma=False
        )
        arguments = [
            jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding)
            for leaf in self._arguments(self.chunk * self.devices)
        ]
        return jax.jit(alone).lower(arguments).compile()


def _shape(leaf: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype)


def _bytes(compiled: Any) -> int:
    """What a program takes while it runs, as far as its backend tells."""
    told = compiled.memory_analysis()
    names = ("temp_size_in_bytes", "output_size_in_bytes", "argument_size_in_bytes")
    return sum(int(getattr(told, name, 0)) for name in names)
