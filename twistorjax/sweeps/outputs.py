"""What a study tells of one design: named columns, derivatives, and how it ended."""

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Int

from ..solve.results import RESULTS
from ..solve.tables import Column, Columns
from .designs import Kind


# more numbers of a design than these are differentiated in reverse
_MANY = 32


class StudyOutput(eqx.Module):
    """All that is kept of one design.

    Args:
        columns: what the study answers, and derivatives of it.
        result: how it ended, the number of an outcome.
        succeeded: whether that is an answer.
    """

    columns: Columns
    result: Int[Array, "*designs"]
    succeeded: Bool[Array, "*designs"]


def study_output(
    study: Callable[[Any], Any], kind: Kind, derivatives: Sequence[str]
) -> Callable[[list[Array]], StudyOutput]:
    """The study, as a function of the parameters that tells what is to be kept.

    Args:
        study: of one design.
        kind: of what the designs consist.
        derivatives: names of the columns that are to be differentiated by all of them.
    """

    def plain(leaves: list[Array]) -> tuple[Columns, list[RESULTS]]:
        answer = study(kind.design(leaves))
        told = dict(_columns(answer, ""))
        if not told:
            raise ValueError(
                f"The study answers {answer!r}, but must answer an array, or a tree of "
                "them."
            )
        return told, _results(answer)

    def tell(leaves: list[Array]) -> StudyOutput:
        told, results = (
            _differentiated(plain, leaves, kind.names, derivatives)
            if derivatives
            else plain(leaves)
        )
        slopes = {f"{name}_by_{by}" for name in derivatives for by in kind.names}
        floats = [
            column.values
            for name, column in told.items()
            if name not in slopes and eqx.is_inexact_array(column.values)
        ]
        if results:
            result = results[0]
            for other in results[1:]:
                result = RESULTS.where(_fine(result), other, result)
            code, succeeded = result._value, _fine(result)
        else:
            finite = [jnp.all(jnp.isfinite(values)) for values in floats]
            succeeded = jnp.all(jnp.stack(finite)) if finite else jnp.asarray(True)
            result = RESULTS.where(succeeded, RESULTS.successful, RESULTS.not_finite)
            code = result._value

        def kept(name: str, column: Column) -> Column:
            if not eqx.is_inexact_array(column.values) or column.axes == (name,):
                return column
            values = jnp.where(succeeded, column.values, jnp.nan)
            return eqx.tree_at(lambda column: column.values, column, values)

        masked = {name: kept(name, column) for name, column in told.items()}
        return StudyOutput(masked, jnp.asarray(code), succeeded)

    return tell


def _fine(result: RESULTS) -> Bool[Array, ""]:
    return (result == RESULTS.successful) | (result == RESULTS.event_occurred)


def _results(answer: Any) -> list[RESULTS]:
    """How each part of an answer ended."""
    if hasattr(answer, "columns") and hasattr(answer, "result"):
        return [answer.result]  # that of the whole, and not of its parts
    if isinstance(answer, RESULTS):
        return [answer]
    return [result for _, part in _parts(answer) for result in _results(part)]


def _columns(answer: Any, name: str):
    """The columns of any tree, by the path to each."""
    if isinstance(answer, Column):
        yield name or "answer", answer
    elif callable(getattr(answer, "columns", None)):
        for inner, column in answer.columns().items():
            yield f"{name}.{inner}" if name else inner, column
    elif isinstance(answer, RESULTS):
        return
    elif eqx.is_array_like(answer):
        name, array = name or "answer", jnp.asarray(answer)
        axes = tuple(f"{name}_{axis}" for axis in range(array.ndim))
        yield name, Column(array, axes)
    else:
        parts = _parts(answer)
        if not (parts or answer is None or isinstance(answer, dict | tuple | list)):
            where = f" as {name!r}" if name else ""
            raise ValueError(
                f"The study answers {answer!r}{where}, but must answer numbers, arrays, "
                "or trees of them."
            )
        for inner, part in parts:
            yield from _columns(part, f"{name}.{inner}" if name else inner)


def _parts(answer: Any) -> list[tuple[str, Any]]:
    """What a tree consists of, by names."""
    if isinstance(answer, dict):
        return [(str(key), part) for key, part in answer.items()]
    if isinstance(answer, eqx.Module):
        return [
            (field.name, getattr(answer, field.name))
            for field in fields(answer)
            if not field.metadata.get("static", False)
        ]
    if hasattr(answer, "_asdict"):
        return list(answer._asdict().items())
    if isinstance(answer, tuple | list):
        return [(str(place), part) for place, part in enumerate(answer)]
    return []


def _differentiated(
    plain: Callable[[list[Array]], tuple[Columns, list[RESULTS]]],
    leaves: list[Array],
    names: Sequence[str],
    derivatives: Sequence[str],
) -> tuple[Columns, list[RESULTS]]:
    """The columns and their derivatives by each parameter, in one pass."""
    moving = [place for place, leaf in enumerate(leaves) if eqx.is_inexact_array(leaf)]
    if not moving:
        raise ValueError(
            f"`derivatives` asks for those by {', '.join(names)}, but these are whole "
            "numbers."
        )
    row, unravel = ravel_pytree([leaves[place] for place in moving])

    def chosen(row: Array) -> tuple[list[Array], tuple[Columns, list[RESULTS]]]:
        every = list(leaves)
        for place, leaf in zip(moving, unravel(row), strict=True):
            every[place] = leaf
        told, results = plain(every)
        for name in derivatives:
            if name not in told or not eqx.is_inexact_array(told[name].values):
                real = [n for n, c in told.items() if eqx.is_inexact_array(c.values)]
                raise ValueError(
                    f"`derivatives` names {name!r}, but what the study answers and can "
                    f"be differentiated is {', '.join(map(repr, real)) or 'nothing'}."
                )
        return [told[name].values for name in derivatives], (told, results)

    slopes, (told, results) = _slopes(chosen, row)
    ends = np.cumsum([leaves[place].size for place in moving])[:-1]
    told = dict(told)
    for name, slope in zip(derivatives, slopes, strict=True):
        whole = told[name]
        for place, part in zip(moving, jnp.split(slope, ends, -1), strict=True):
            shape = leaves[place].shape
            own = tuple(f"{names[place]}_{axis}" for axis in range(len(shape)))
            values = part.reshape(*slope.shape[:-1], *shape)
            column = Column(values, (*whole.axes, *own), "", whole.labels)
            told[f"{name}_by_{names[place]}"] = column
    return told, results


def _slopes(function: Callable[[Array], Any], row: Array) -> tuple[list[Array], Any]:
    """The derivatives of some arrays by a row of numbers, and what is told beside."""
    if row.size <= _MANY:
        try:
            return _forwards(function, row)
        except TypeError as error:  # of a motion, by default
            if "custom_vjp" not in str(error):
                raise
    return _in_reverse(function, row)


def _forwards(function: Callable[[Array], Any], row: Array) -> tuple[list[Array], Any]:
    """By one pass for each number."""

    def along(direction: Array) -> Any:
        return jax.jvp(function, (row,), (direction,), has_aux=True)

    _, slopes, beside = jax.vmap(along, out_axes=(None, -1, None))(jnp.eye(row.size))
    return slopes, beside


def _in_reverse(function: Callable[[Array], Any], row: Array) -> tuple[list[Array], Any]:
    """By one pass for each entry of the arrays."""

    def real(row: Array) -> tuple[list[tuple[Array, ...]], Any]:
        values, beside = function(row)
        parts = [(v.real, v.imag) if jnp.iscomplexobj(v) else (v,) for v in values]
        return jax.tree.map(lambda part: part.astype(row.dtype), parts), beside

    values, back, beside = jax.vjp(real, row, has_aux=True)
    flat, shaped = ravel_pytree(values)
    rows = jax.vmap(lambda cotangent: back(shaped(cotangent))[0])(jnp.eye(flat.size))
    slopes = jax.vmap(shaped, in_axes=1, out_axes=-1)(rows)
    return [s[0] if len(s) == 1 else jax.lax.complex(*s) for s in slopes], beside
