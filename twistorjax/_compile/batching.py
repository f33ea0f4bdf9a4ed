"""What keeps batches of mechanisms fast on a processor."""

import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Inexact

from .._utils.host import runs_line_by_line


Tree = TypeVar("Tree")


def map_rows(
    function: Callable, leaves: Sequence[Any], axes: Sequence[int | None], *others: Any
) -> Any:
    """Call a function of leaves and other trees for each of their rows.

    With `tj.configure(debug=True)`, it is called for one row after another, so that a
    value in it can be printed.

    Args:
        axes: For each leaf, 0 if it has rows, or None if it is the same in all calls.
        others: Trees of arrays with rows, which are further arguments of the function.
    """
    if not runs_line_by_line():
        return jax.vmap(function, (list(axes), *len(others) * (0,)))(leaves, *others)

    def call(row: int) -> Any:
        pairs = zip(leaves, axes, strict=True)
        own = [leaf if axis is None else leaf[row] for leaf, axis in pairs]
        return function(own, *jax.tree.map(lambda values: values[row], others))

    count = len(jax.tree.leaves(others)[0])
    return jax.tree.map(lambda *rows: jnp.stack(rows), *map(call, range(count)))


def computed_once(tree: Tree, finite: Inexact[Array, "*batch"]) -> Tree:
    """Return the leaves of a tree, such that XLA computes them once.

    XLA fuses each of many outputs with all that it depends on, and computes this again
    for each of them, except operations that it counts as expensive, such as a division.
    All leaves are therefore divided by one, which is computed from `finite` values of the
    same shape, so that XLA does not know it. Without this, a batch of motions takes up to
    1.15 times as long (`benchmarks.motion`). Batches of equilibria gain nothing.
    """
    one = 1 + 0 * jax.lax.stop_gradient(finite)
    return jax.tree.map(lambda leaf: leaf / one, tree)


# On a processor, a chunk is evaluated in batches of this size. The arrays of so few
# designs stay in the cache, and the slowest design of a batch delays few others.
CPU_BATCH_SIZE = 128


def single_threaded_batch_size(program: str) -> int:
    """Find the largest batch for which LAPACK calls run in a single thread.

    XLA distributes a batch of matrices among threads if the work exceeds about 2e5
    operations. Two such calls on two devices of one processor wait for each other and
    deadlock (jaxlib 0.10). The program is StableHLO text.
    """
    largest = 0.0
    for line in program.splitlines():
        if not (call := re.search(r"@lapack_.(\w+?)_ffi", line)):
            continue
        factor = {"potrf": 1 / 3, "trsm": 1 / 3, "getrf": 2 / 3}.get(call[1], 25.0)
        for shape in re.findall(r"tensor<([\dx]+)x[cf]\d+>", line):
            rows, columns = [1, 1, *map(int, shape.split("x"))][-2:]
            largest = max(largest, factor * rows * columns * max(rows, columns))
    if not largest:
        return CPU_BATCH_SIZE
    return max(1, min(CPU_BATCH_SIZE, int(2e5 / largest)))
