"""Identity of a sweep, by which its store is recognized and continued."""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ... import __version__
from ...designs.designs import Designs
from ..dataset import Layout
from ..executor import Program, synchronize
from .creation import create_store, rewrite_static_files
from .store import Store


def open_store(
    path: Path, layout: Layout, identity: Mapping[str, Any], resume: bool
) -> Store:
    """Create the store of a sweep, or prepare an existing one, and open it."""
    if jax.process_index() == 0 and (
        path.exists() or not create_store(path, identity, layout)
    ):
        if not resume:
            raise ValueError(
                f"`store` is {str(path)!r}, which another process created after this "
                "sweep began. Continue it with `resume=True`, or use another path."
            )
        existing = Store(path)
        existing.check_identity(identity)
        if existing.damaged_files():
            rewrite_static_files(path, identity, layout, existing.block)
        existing.remove_partial_files()
    synchronize("store opened")
    return Store(path).open()


def sweep_identity(
    study: Callable[[Any], Any],
    designs: Designs,
    program: Program,
    units: Mapping[str, str] | None,
    settings: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Collect the entries by which sweeps are distinguished, which JSON can represent."""
    digest = hashlib.sha256()
    for name, array in zip(designs.names, designs.arrays, strict=True):
        digest.update(f"{name} {array.dtype} {array.shape};".encode())
        digest.update(np.ascontiguousarray(array).data)
    try:
        settings_text = json.dumps(dict(settings or {}), sort_keys=True)
    except TypeError as error:
        raise ValueError(
            f"`settings` must contain numbers, strings and lists of these: {error}."
        ) from None
    return {
        "study": getattr(study, "__qualname__", type(study).__qualname__),
        "settings": settings_text,
        "units": json.dumps(dict(units or {}), sort_keys=True),
        "chunk_size": program.chunk_size,
        "program": program.fingerprint,
        "designs": digest.hexdigest(),
        "twistorjax": __version__,
        "jax": jax.__version__,
        "backend": jax.default_backend(),
    }
