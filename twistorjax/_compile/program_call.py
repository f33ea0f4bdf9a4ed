"""Call of a program of `jax.export`, with parts of JAX that may change.

The results of `Exported.call` are committed to a device, and JAX compiles a function
again for committed arguments. This call leaves them uncommitted. If a part of JAX is
missing, this module cannot be imported.
"""

import contextlib
from collections.abc import Sequence
from typing import Any

import jax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import func
from jax.interpreters.mlir import (
    lower_fun,
    LoweringRuleContext,
    merge_mlir_modules,
    register_lowering,
)


_call = Primitive("call_stored_trace")
_call.multiple_results = True


def call_program(program: jax.export.Exported, inputs: Sequence[Any]) -> Sequence[Any]:
    """Call a program while JAX traces another one.

    Returns:
        Its results, whose types are not weak.
    """
    return _call.bind(*inputs, program=program)


@_call.def_abstract_eval
def _shapes_of_results(*_: Any, program: jax.export.Exported) -> list[ShapedArray]:
    """Return the shapes of the results of a program."""
    return [ShapedArray(result.shape, result.dtype) for result in program.out_avals]


def _insert(
    context: LoweringRuleContext, *arguments: Any, program: jax.export.Exported
) -> Sequence[Any]:
    """Insert a program into the one that JAX is lowering, and call it."""
    # Only `Exported.call` prepares calls of LAPACK. It does so for each program, and
    # imports `scipy.linalg`, which takes a third of the time of `import jax`.
    if b"lapack" not in program.mlir_module_serialized:
        with contextlib.suppress(Exception):  # of changes in JAX
            return _merge(context, arguments, program)
    by_jax = lower_fun(lambda *values: program.call(*values))
    return by_jax(context, *arguments)


def _merge(
    context: LoweringRuleContext, arguments: Sequence[Any], program: jax.export.Exported
) -> Sequence[Any]:
    module = program.mlir_module(serialized=False)
    main: Any = ir.SymbolTable(module.operation)["main"]
    outer = context.module_context
    name = merge_mlir_modules(
        outer.module, program.fun_name, module, dst_symtab=outer.symbol_table
    )
    used = [arguments[index] for index in program.module_kept_var_idx]
    called = ir.FlatSymbolRefAttr.get(name)
    call = func.CallOp(main.type.results, called, used)  # pyright: ignore
    return call.results


register_lowering(_call, _insert)
