"""Names of parameters and answers that a table, or a store of it, can have."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..solve.tables import Columns


# what every table has beside the parameters and answers
ALWAYS = ("succeeded", "result")


def check_parameters(names: Sequence[Any]) -> None:
    """Refuse names of parameters that a table cannot have.

    Args:
        names: Names of all parameters.

    Raises:
        ValueError: A name is no text, is empty, occurs twice, or is reserved.
    """
    for name, count in Counter(names).items():
        if not isinstance(name, str) or not name:
            raise ValueError(
                f"`designs` has a parameter {name!r}, but its name must be some text."
            )
        if count > 1:
            raise ValueError(
                f"`designs` has {count} parameters {name!r}. Give them different names."
            )
        if name in ALWAYS:
            raise ValueError(
                f"`designs` has a parameter {name!r}, but every table has a column of "
                "that name, which tells how a design ended. Give it another name; any "
                f"is allowed but {' and '.join(map(repr, ALWAYS))}."
            )


def check_columns(
    parameters: Iterable[str], grid: Sequence[str], answers: Columns
) -> None:
    """Refuse names of answers and of their axes that a table cannot have.

    Args:
        parameters: Names of the parameters.
        grid: Parameters that are axes of the table; none if the designs are no grid.
        answers: What the study returns for one design, by name.

    Raises:
        ValueError: A name is used twice, or the labels of an axis do not fit it.
    """
    parameters, axes_of_designs = set(parameters), {"design", *grid}
    taken = {*parameters, *axes_of_designs, *ALWAYS}
    labels: dict[str, tuple[str, ...]] = {}
    for name, column in answers.items():
        if name in taken:
            raise ValueError(
                f"{name!r} is what the study answers, but that name is taken: by a "
                "parameter, or by what a table always has. Call it something else."
            )
        if twice := sorted(axes_of_designs & {*column.axes}):
            raise ValueError(
                f"{name!r} has an axis {twice[0]!r}, but that is an axis of the designs. "
                "Give the axis another name."
            )
        if len(column.axes) != len(column.values.shape) - 1:
            raise ValueError(
                f"{name!r} has shape {column.values.shape[1:]}, but its axes are "
                f"{column.axes}. Name each axis."
            )
        lengths = dict(zip(column.axes, column.values.shape[1:], strict=True))
        for axis, words in column.labels:
            if len(words) != lengths.get(axis, len(words)):
                raise ValueError(
                    f"{name!r} has {lengths[axis]} entries along {axis!r}, but "
                    f"{len(words)} labels of them. Give one for each entry."
                )
            if labels.setdefault(axis, words) != words:
                raise ValueError(
                    f"The axis {axis!r} of {name!r} has other labels than that of "
                    "another answer. Give one of the axes another name."
                )
    for axis in (*labels, *(n for n, column in answers.items() if column.axes == (n,))):
        if axis in parameters or (axis in labels and axis in answers):
            raise ValueError(
                f"{axis!r} is an axis that has values or labels of its own, but also "
                "the name of a parameter or of an answer. Give one of them another name."
            )


def check_storable(names: Iterable[str]) -> None:
    """Refuse names that a store cannot have, where each is a folder.

    Args:
        names: Names of parameters, answers and labelled axes.

    Raises:
        ValueError: A name has a space, a slash or the like, or is reserved.
    """
    for name in names:
        if (
            not name.isprintable()
            or any(sign in name for sign in " /\\")
            or name.startswith("__")
            or not name.strip(".")
            or name in ("finished", "zarr.json")
        ):
            raise ValueError(
                f"A `store` cannot keep the name {name!r}: names in it must be without "
                "spaces, slashes and control characters, must not begin with '__' or "
                "consist of dots, and must not be 'finished' or 'zarr.json'. Rename it, "
                "or sweep without a store."
            )


def places_of(parameters: Iterable[str], answers: Columns) -> Mapping[str, str]:
    """Names under which the values along an axis are kept for each design.

    They become coordinates of the table if they are the same for all designs.

    Args:
        parameters: Names of the parameters.
        answers: What the study returns for one design, by name.

    Returns:
        The name of the axis, by the name under which its values are kept.

    Raises:
        ValueError: The name is that of a parameter or of an answer.
    """
    places: dict[str, str] = {}
    for name, column in answers.items():
        if column.axes != (name,):
            continue
        kept = f"{name}_places"
        if kept in {*parameters, *answers}:
            raise ValueError(
                f"{kept!r} is the name of a parameter or of an answer, but it is taken "
                f"by the values along the axis {name!r}. Give it another name."
            )
        places[kept] = name
    return places
