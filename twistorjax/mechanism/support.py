"""Check that every body of a mechanism is connected to a fixed body."""

from collections.abc import Sequence

from .mechanism import Mechanism


def require_support(
    mechanism: Mechanism,
    constrained: Sequence[Sequence[int]],
    prescribed: Sequence[int] = (),
) -> None:
    """Check that hinges or constraints connect every body to a fixed one.

    Args:
        mechanism: The mechanism.
        constrained: Indices of the bodies of each constraint.
        prescribed: Indices of the prescribed degrees of freedom, whose bodies are
            supported as well.

    Raises:
        ValueError: A body is not connected.
    """
    neighbors: dict[int, set[int]] = {}
    for group in (*mechanism.hinge_assembly.ends, *constrained):
        for body in group:
            neighbors.setdefault(body, set()).update(group)
    connected = {dof // 3 for dof in (*mechanism.fixed, *prescribed)}
    front = list(connected)
    while front:
        new = neighbors.get(front.pop(), set()) - connected
        connected |= new
        front.extend(new)
    names = [name for k, name in enumerate(mechanism.names) if k not in connected]
    if names:
        plural = len(names) > 1
        raise ValueError(
            f"The {'bodies' if plural else 'body'} {' and '.join(map(repr, names))} "
            f"{'are' if plural else 'is'} not connected to a body in `fixed` by hinges "
            "or constraints. Fix or prescribe the position of one of them, or add a "
            "hinge."
        )
