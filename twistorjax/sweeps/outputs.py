"""Outputs of a study for one design: named columns, their derivatives, and the result."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Int

from .._utils.pytrees import split_last_axis
from .._utils.validation import missing_parameters_noted, quote
from ..designs.designs import DesignStructure
from ..results.codes import is_success, RESULTS
from ..results.tables import Column, Columns


# Designs with more numbers than this are differentiated in reverse mode.
_MAX_FORWARD_SIZE = 32


class StudyOutput(eqx.Module):
    """Outputs of a study for one design, or for a batch of designs."""

    columns: Columns  # Outputs of the study and their derivatives, by name
    result: Int[Array, "*designs"]
    succeeded: Bool[Array, "*designs"]  # Whether the design succeeded


def study_output(
    study: Callable[[Any], Any], structure: DesignStructure, derivatives: Sequence[str]
) -> Callable[[list[Array]], StudyOutput]:
    """Convert a study to a function of the parameters of one design, in their order.

    The outputs named by `derivatives` are differentiated with respect to each parameter.
    Outputs of a failed design are NaN, except for integers and for values along an axis.
    """
    study = without_jit(study)

    def evaluate(parameters: list[Array]) -> tuple[Columns, list[RESULTS]]:
        design = structure.design(parameters)
        with missing_parameters_noted(design):
            value = study(design)
        columns = dict(_columns(value, ""))
        if not columns:
            raise ValueError(
                f"The study returns {quote(value)}, but must return an array or a tree "
                "of arrays."
            )
        return columns, _results(value)

    def output(parameters: list[Array]) -> StudyOutput:
        by_parameter: Columns = {}
        if derivatives:
            columns, by_parameter, results = _with_derivatives(
                evaluate, parameters, structure.names, derivatives
            )
        else:
            columns, results = evaluate(parameters)
        if results:
            result = results[0]
            for other in results[1:]:
                result = RESULTS.where(is_success(result), other, result)
            succeeded = is_success(result)
        else:
            # A derivative may be infinite where its output is finite.
            arrays = [column.values for column in columns.values()]
            floats = filter(eqx.is_inexact_array, arrays)
            finite = [jnp.all(jnp.isfinite(values)) for values in floats]
            succeeded = jnp.all(jnp.stack(finite)) if finite else jnp.asarray(True)
            result = RESULTS.where(succeeded, RESULTS.successful, RESULTS.not_finite)

        def mask(name: str, column: Column) -> Column:
            if not eqx.is_inexact_array(column.values) or column.axes == (name,):
                return column
            values = jnp.where(succeeded, column.values, jnp.nan)
            return eqx.tree_at(lambda column: column.values, column, values)

        columns = {**columns, **by_parameter}
        masked = {name: mask(name, column) for name, column in columns.items()}
        return StudyOutput(masked, jnp.asarray(result._value), succeeded)

    return output


def without_jit(study: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return the function inside `jax.jit` or `eqx.filter_jit`.

    The compiled function would keep the values that its variables had at its first call.
    """
    inner = getattr(study, "__wrapped__", None)
    if inner is None or not hasattr(study, "lower"):
        return study
    return without_jit(inner)


def _results(value: Any) -> list[RESULTS]:
    """Collect the results of all solves whose solutions a study returns."""
    if hasattr(value, "columns") and hasattr(value, "result"):
        return [value.result]  # It covers all parts of the solution.
    if isinstance(value, RESULTS):
        return [value]
    return [result for _, child in _children(value) for result in _results(child)]


def _columns(value: Any, name: str) -> Iterator[tuple[str, Column]]:
    """Yield the columns of a tree that a study returns, and the path to each of them.

    The path of the tree itself, such as "stage.gain", is `name`; it is empty at the root.
    """
    if isinstance(value, Column):
        yield name or "output", value
    elif callable(getattr(value, "columns", None)):
        for inner, column in value.columns().items():
            yield f"{name}.{inner}" if name else inner, column
    elif isinstance(value, RESULTS):
        return
    elif eqx.is_array_like(value):
        name, array = name or "output", jnp.asarray(value)
        axes = tuple(f"{name}_{axis}" for axis in range(array.ndim))
        yield name, Column(array, axes)
    else:
        children = _children(value)
        if not (children or value is None or isinstance(value, dict | tuple | list)):
            where = f" as {quote(name)}" if name else ""
            raise ValueError(
                f"The study returns {quote(value)}{where}, but must return numbers, "
                "arrays, or trees of them."
            )
        for inner, child in children:
            yield from _columns(child, f"{name}.{inner}" if name else inner)


def _children(value: Any) -> list[tuple[str, Any]]:
    """List the children of a node of a tree, with their names."""
    if isinstance(value, dict):
        return [(str(key), child) for key, child in value.items()]
    if isinstance(value, eqx.Module):
        return [
            (field.name, getattr(value, field.name))
            for field in fields(value)
            if not field.metadata.get("static", False)
        ]
    if hasattr(value, "_asdict"):
        return list(value._asdict().items())
    if isinstance(value, tuple | list):
        return [(str(index), child) for index, child in enumerate(value)]
    return []


def _with_derivatives(
    evaluate: Callable[[list[Array]], tuple[Columns, list[RESULTS]]],
    parameters: list[Array],
    names: Sequence[str],
    derivatives: Sequence[str],
) -> tuple[Columns, Columns, list[RESULTS]]:
    """Evaluate a study and the derivatives of some outputs by each parameter in one pass.

    It returns the outputs, their derivatives, and the results of the solves. The
    derivative of `gain` by `web` has the name `gain_by_web`.
    """
    real = [k for k, array in enumerate(parameters) if eqx.is_inexact_array(array)]
    if not real:
        raise ValueError(
            f"`derivatives` needs a real parameter, but {', '.join(names)} are integers."
        )
    vector, unravel = ravel_pytree([parameters[index] for index in real])

    def selected(vector: Array) -> tuple[list[Array], tuple[Columns, list[RESULTS]]]:
        changed = list(parameters)
        for index, array in zip(real, unravel(vector), strict=True):
            changed[index] = array
        columns, results = evaluate(changed)
        for name in derivatives:
            if name not in columns or not eqx.is_inexact_array(columns[name].values):
                differentiable = [
                    repr(key)
                    for key, column in columns.items()
                    if eqx.is_inexact_array(column.values)
                ]
                raise ValueError(
                    f"`derivatives` names {quote(name)}, but the differentiable outputs "
                    f"of the study are {', '.join(differentiable) or 'none'}."
                )
        return [columns[name].values for name in derivatives], (columns, results)

    jacobians, (columns, results) = _jacobians(selected, vector)
    shapes = [parameters[index].shape for index in real]
    by_parameter = {}
    for name, jacobian in zip(derivatives, jacobians, strict=True):
        output = columns[name]
        parts = split_last_axis(jacobian, shapes)
        for index, values in zip(real, parts, strict=True):
            extra = range(parameters[index].ndim)
            axes = (*output.axes, *(f"{names[index]}_{axis}" for axis in extra))
            column = Column(values, axes, "", output.labels)
            by_parameter[f"{name}_by_{names[index]}"] = column
    return columns, by_parameter, results


def _jacobians(
    function: Callable[[Array], tuple[list[Array], Any]], vector: Array
) -> tuple[list[Array], Any]:
    """Compute the Jacobians of the arrays that a function returns.

    The function also returns auxiliary outputs, which are returned unchanged. The last
    axis of each Jacobian is that of the vector.
    """
    if vector.size <= _MAX_FORWARD_SIZE:
        try:
            return jax.jacfwd(function, has_aux=True)(vector)
        except TypeError as error:
            # By default, `simulate` can be differentiated in reverse mode only.
            if "custom_vjp" not in str(error):
                raise

    def real_function(vector: Array) -> tuple[list[tuple[Array, ...]], Any]:
        values, auxiliary = function(vector)
        pairs = [(v.real, v.imag) if jnp.iscomplexobj(v) else (v,) for v in values]
        return jax.tree.map(lambda leaf: leaf.astype(vector.dtype), pairs), auxiliary

    jacobians, auxiliary = jax.jacrev(real_function, has_aux=True)(vector)
    return [j[0] if len(j) == 1 else jax.lax.complex(*j) for j in jacobians], auxiliary
