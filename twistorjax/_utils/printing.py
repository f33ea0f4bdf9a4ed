"""How the parts of a mechanism are printed: by their numbers."""

from dataclasses import fields
from typing import Any

import equinox as eqx
import jax
import numpy as np
import wadler_lindig as wl

from .host import is_traced


_MOST_NUMBERS = 12  # of an array that is printed; of others, type and shape are


class Printed(eqx.Module):
    """A module that is printed with its numbers, and without fields that are None."""

    def __repr__(self) -> str:
        return wl.pformat(self, custom=_document)


def _is_given(value: Any) -> bool:
    """Decide whether a field has a value: not None, or a module with such a field."""
    if not isinstance(value, Printed):
        return value is not None
    return any(_is_given(getattr(value, field.name)) for field in fields(value))


def _text(value: Any) -> str:
    """Return the text of a number, or of a list of them, with six digits."""
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _document(value: Any) -> wl.AbstractDoc | None:
    if isinstance(value, jax.Array | np.ndarray) and not is_traced(value):
        if value.size > _MOST_NUMBERS:
            return None
        return wl.TextDoc(_text(np.asarray(value).tolist()))
    if not isinstance(value, eqx.Module) or type(value).__repr__ is not Printed.__repr__:
        return None
    named = [
        (field.name, getattr(value, field.name))
        for field in fields(value)
        if field.repr and _is_given(getattr(value, field.name, None))
    ]
    return wl.bracketed(
        begin=wl.TextDoc(f"{type(value).__name__}("),
        docs=wl.named_objs(named, custom=_document),
        sep=wl.comma,
        end=wl.TextDoc(")"),
        indent=2,
    )
