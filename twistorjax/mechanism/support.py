"""Which bodies of a mechanism are connected to a fixed one."""

from collections.abc import Iterable, Sequence


def unsupported_bodies(
    count: int, fixed: Iterable[int], groups: Iterable[Sequence[int]]
) -> tuple[int, ...]:
    """Find the bodies that no chain of connections leads from to a fixed body.

    Args:
        count: Number of bodies.
        fixed: Indices of the bodies with a fixed coordinate.
        groups: Indices of the bodies that each hinge or constraint connects.
    """
    neighbors: dict[int, set[int]] = {}
    for group in groups:
        for body in group:
            neighbors.setdefault(body, set()).update(group)
    reached = set(fixed)
    front = list(reached)
    while front:
        fresh = neighbors.get(front.pop(), set()) - reached
        reached |= fresh
        front.extend(fresh)
    return tuple(body for body in range(count) if body not in reached)
