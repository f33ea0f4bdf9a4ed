"""Text of a result of the library: a tree of numbers, names, and instances of classes.

The text can be read without the risk of running code: it only names classes of known
packages and functions of this one, and creates instances without calling them.
"""

import dataclasses
import importlib
import json
import types
from typing import Any

from jax.tree_util import Partial

from .trace_keys import importable_name, is_known_module, NoCanonicalTextError


_SEQUENCES = {"tuple": tuple, "list": list, "frozenset": frozenset}


def to_text(value: Any) -> str:
    """Return the text of a value.

    Args:
        value: Tree of tuples, lists, dictionaries, named tuples, and dataclasses. Its
            leaves are numbers, strings, None, and names of classes and functions.

    Raises:
        NoCanonicalTextError: The value contains something else.

    Example:
        >>> to_text((1, "name"))
        '["tuple", [1, "name"]]'
        >>> from_text(to_text((1, "name")))
        (1, 'name')
    """
    return json.dumps(_encode(value))


def from_text(text: str | bytes) -> Any:
    """Return the value of a text that `to_text` has returned.

    Raises:
        ValueError: The text is not valid.
    """
    return _decode(json.loads(text))


def _encode(value: Any) -> Any:
    kind = type(value)
    if value is None or kind in (bool, int, float, str):
        return value
    if kind in _SEQUENCES.values():
        return [kind.__name__, [_encode(entry) for entry in value]]
    if kind is dict:
        return ["dict", [[_encode(key), _encode(value[key])] for key in value]]
    if isinstance(value, type | types.FunctionType):
        return ["name", _name(value)]
    if kind is Partial:
        return [
            "partial",
            [_encode(value.func), _encode(value.args), _encode(value.keywords)],
        ]
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return [_name(kind), [_encode(entry) for entry in value]]
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        present = [name for name in names if hasattr(value, name)]
        return [
            _name(kind),
            {name: _encode(getattr(value, name)) for name in present},
        ]
    raise NoCanonicalTextError(f"an object of {kind}")


def _decode(code: Any) -> Any:
    if not isinstance(code, list):
        return code
    kind, content = code
    if kind == "name":
        return _find(content)
    if kind == "partial":
        function, arguments, keywords = map(_decode, content)
        return Partial(function, *arguments, **keywords)
    if kind == "dict":
        return {_decode(key): _decode(value) for key, value in content}
    if isinstance(content, dict):
        found = _find(kind)
        names = {field.name for field in dataclasses.fields(found)}
        if not names.issuperset(content):
            raise ValueError(f"{kind} does not have the fields {sorted(content)}")
        instance = object.__new__(found)
        for name, value in content.items():
            object.__setattr__(instance, name, _decode(value))
        return instance
    values = [_decode(value) for value in content]
    if kind in _SEQUENCES:
        return _SEQUENCES[kind](values)
    found = _find(kind)
    if len(values) != len(found._fields):
        raise ValueError(f"{kind} does not have {len(values)} fields")
    return tuple.__new__(found, values)


def _name(value: Any) -> str:
    if importable_name(value) is None:
        raise NoCanonicalTextError(f"{value.__module__}.{value.__qualname__}")
    return f"{value.__module__}:{value.__qualname__}"


def _find(name: str) -> Any:
    module, _, qualified_name = name.partition(":")
    if not is_known_module(module):
        raise ValueError(f"{module} is not a module of a known package")
    found: Any = importlib.import_module(module)
    for part in qualified_name.split("."):
        found = getattr(found, part)
    is_function = isinstance(found, types.FunctionType) and module.startswith(
        "twistorjax"
    )
    if not (isinstance(found, type) or is_function):
        raise ValueError(f"{name} is not a class or a function of this package")
    return found
