"""Many designs at once: what a study says of each, as one table."""

import hashlib
import importlib.metadata
import json
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TYPE_CHECKING

import jax
import numpy as np

from .._utils.validation import compilation_error
from ..solve.results import result_message, RESULT_NAMES
from ..solve.tables import Column, dataset, require_xarray
from .dataset import finished, Layout, OUTCOMES, UNKNOWN
from .designs import Designs
from .executor import chunk_of, Program
from .memory import LEAST, need_memory, too_large
from .names import check_storable
from .outputs import StudyOutput
from .store import Store
from .store_creation import create_store, need_writable, rewrite_fixed_files
from .store_files import clear_errors, damage


if TYPE_CHECKING:
    import xarray


def sweep(
    study: Callable[[Any], Any],
    designs: Any,
    *,
    derivatives: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
    chunk: int | None = None,
    memory: float | int = 2**30,
    mesh: jax.sharding.Mesh | None = None,
    store: str | Path | None = None,
    resume: bool = False,
    settings: Mapping[str, Any] | None = None,
    progress: bool = False,
) -> "xarray.Dataset":
    """What a study says of each of many designs.

    They are taken in chunks, each side by side in one program. A design that has no
    answer harms no other: its numbers are NaN, but for whole ones, `succeeded` is false
    and `result` tells why; a warning counts such designs.

    Args:
        study: of one design, as `designs` has them: builds a mechanism, solves it with
            `throw=False`, and answers with an equilibrium, vibrations, a motion, a
            number, an array, or a mapping of these by names. What such a mapping has of
            type `RESULTS`, as `reference.result`, tells of each design whether it succeeded;
            otherwise those do whose numbers are finite. It is traced once for all
            designs, so numbers of `np.random` are the same for all.
        designs: a mapping from names to arrays, or another tree of them, each with an
            entry for each design along its first axis; `sample_designs` makes such ones. Or a
            `Grid`, for all combinations.
        derivatives: names of answers that are differentiated by each parameter, in the
            same pass: `gain_by_web`.
        units: of parameters and answers that do not tell their own, by name.
        chunk: how many designs a device takes at once, by default up to 4096, on
            accelerators 131,072, or as few as `memory` allows.
        memory: that a chunk may take on each device; bytes.
        mesh: of devices, of this process or of all that `jax.distributed` has joined.
            Each takes chunks of its own.
        store: a folder, in zarr's format, in which chunks are kept as they are found, so
            that nothing of them is lost when the sweep is ended, however it is. Several
            processes need one that they share. Names in it must be without spaces and
            slashes.
        resume: whether to go on with a store, from what it has: chunks that are whole
            are not computed again. Chunks, coordinates and labels whose files are
            damaged or missing are written again.
        settings: more to be kept with the table, and, in a store, to know it by.
        progress: whether a bar is shown.

    Returns:
        A dataset over `design`, or over the parameters of a grid; of a store as
        `open_sweep` reads it.

    Raises:
        ImportError: xarray is not installed, or zarr, for a store.
        ValueError: the designs are of different lengths; a name is not known, or used
            twice; an answer is no number; the store is another sweep's, or is there and
            not to be resumed; the chunk does not fit the memory; the table does not fit
            the memory of the machine; a name cannot be kept.
        OSError: The store cannot be read or written, or its manifest is damaged.
        RuntimeError: a solve within the study raised, for want of `throw=False`.

    Example:
        >>> import jax.numpy as jnp
        >>> from twistorjax import Body, equilibrium, Hinge, Load, Material
        >>> from twistorjax.flexures import leaf
        >>> from twistorjax import Mechanism
        >>> steel = Material(modulus=210e9, poisson=0.3)
        >>> def sag(design):
        ...     spring = leaf(steel, length=0.05, width=0.01, **design)
        ...     hinge = Hinge("leaf", "wall", "tip", spring, at=(0.0, 0.025, 0.0))
        ...     bodies = [Body("wall"), Body("tip", (0.0, 0.05, 0.0))]
        ...     beam = Mechanism(bodies, [hinge], fixed=["wall"])
        ...     push = Load("tip", (0.0, 0.0, -1.0))
        ...     bent = equilibrium(beam, loads=[push], throw=False)
        ...     return {"sag": -bent.displacement("tip")[2], "result": bent.result}
        >>> thicknesses = jnp.array([0.5e-3, 1e-3])
        >>> table = sweep(sag, {"thickness": thicknesses}, units={"sag": "m"})
        >>> table.sag.values
        array([0.00190..., 0.00023...])
    """
    require_xarray()
    if not callable(study):
        raise ValueError(f"`study` is {study!r}, but must be a function of one design.")
    designs = Designs(designs)
    if isinstance(derivatives, str):
        derivatives = (derivatives,)
    if (chunk is not None and chunk < 1) or not memory > 0:
        raise ValueError(
            f"`chunk` is {chunk} and `memory` {memory}, but they must be at least 1, and "
            "positive."
        )
    if resume and store is None:
        raise ValueError("`resume` is given, but no `store` to go on with.")
    there = None
    if store is not None:
        check_storable(designs.names)
        if Path(store).exists():
            there = Store(store)  # refused where it is none
        else:
            need_writable(Path(store))
    # the answers in a store are read as they are used, unless they become a grid
    fixed = store is None or designs.dims != ("design",)
    parameters = sum(array.nbytes for array in designs.arrays)
    need_memory(len(designs), parameters + (LEAST * len(designs) if fixed else 0))
    _together("looked")  # before the first of them makes it
    if there is not None and not resume:
        raise ValueError(
            f"`store` is {str(store)!r}, which is there already: go on with it by "
            "`resume=True`, or give another path."
        )
    if there is not None and chunk is None:
        chunk = there.made_by["chunk"]
    size = chunk_of(len(designs), mesh) if chunk is None else chunk
    try:
        program = _program(
            study, designs.kind, tuple(derivatives), size, memory, mesh, chunk is not None
        )
    except jax.errors.JAXTypeError as error:
        raise compilation_error("study", "about the design", error) from error
    layout = Layout(designs, program.told, dict(units or {}))
    if store is not None:
        layout.check_storable()
    needed = layout.size(answers=fixed)
    need_memory(len(designs), needed)
    program.fit()
    if store is None:
        try:
            kept = layout.empty()
        except MemoryError:
            raise too_large(len(designs), needed) from None
        for number, told in _shown(
            program, designs, range(program.count(designs)), progress
        ):
            first = number * program.chunk
            for name, values in layout.values(told).items():
                rows = kept[name][first : first + program.chunk]
                rows[:] = values[: len(rows)]
        attributes = _identity(study, designs, program, units, settings)
        table = _in_memory(layout, _gathered(kept, designs, program), attributes)
    else:
        made_by = _identity(study, designs, program, units, settings)
        keeper = _opened(store, layout, program, made_by, resume)
        left = np.flatnonzero(~keeper.finished())
        _together("begun")
        for number, told in _shown(program, designs, left.tolist(), progress):
            keeper.write(number, layout.values(told))
        _together("ended")
        table = open_sweep(store, verify=False)
    warn_of_failures(table)
    return table


def _program(*arguments: Any) -> Program:
    """The program of a study, compiled once for all designs of one kind."""
    try:
        hash(arguments)
    except TypeError:  # as a study that has arrays
        return Program(*arguments)
    return _kept(*arguments)


_kept = lru_cache(maxsize=32)(Program)


def open_sweep(store: str | Path, *, verify: bool = True) -> "xarray.Dataset":
    """What a store has of a sweep; of one that is not at its end, what is there so far.

    Designs that have not been looked at are NaN, not `succeeded`, and their `result` is
    -1; so are those whose files are not whole, which `sweep` computes again. How many
    chunks are missing so is told by the attribute `chunks_missing`. Coordinates, labels
    and metadata are verified in any case.

    Args:
        store: the folder.
        verify: whether all numbers are read once, to see that they are those that were
            written. Otherwise they are read as they are used, and a file that was
            damaged is not seen.

    Raises:
        ImportError: xarray or zarr is not installed.
        ValueError: it is no store of a sweep.
        OSError: it is not there, cannot be read, or its coordinates, labels or metadata
            are damaged.
    """
    xarray, kept = require_xarray(), Store(store).open("r")
    with clear_errors(kept.path, "read"):
        table = xarray.open_zarr(kept.path, consolidated=False, chunks=None)
    table = table[list(kept.names)].assign_coords(table.coords)
    whole = kept.finished() if verify else kept.written()
    if not whole.all():
        known = {n: table[n].copy(data=kept.known(n, whole)) for n in kept.names}
        table = table.assign(known)
        table = table.assign_attrs(chunks_missing=int(np.sum(~whole)))
    try:
        return finished(table, kept.grid, kept.places)
    except Exception:  # what is read here may be damaged, unless it has been verified
        if verify:
            raise
        raise damage(kept.path, "an answer", "Open it with `verify=True`.") from None


def _opened(
    store: str | Path,
    layout: Layout,
    program: Program,
    made_by: Mapping[str, Any],
    resume: bool,
) -> Store:
    """The store of a sweep, found or made."""
    path = Path(store)
    if jax.process_index() == 0 and (
        path.exists() or not create_store(path, made_by, layout, program.chunk)
    ):
        if not resume:
            raise ValueError(
                f"`store` is {str(path)!r}, which another process has created since this "
                "sweep began: go on with it by `resume=True`, or give another path."
            )
        kept = Store(path)
        kept.check(made_by)
        if kept.damaged_files():
            rewrite_fixed_files(path, made_by, layout, program.chunk)
        kept.clear()
    _together("opened")
    return Store(path).open()


def _identity(
    study: Callable[[Any], Any],
    designs: Designs,
    program: Program,
    units: Mapping[str, str] | None,
    settings: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """What another sweep is told apart by."""
    digest = hashlib.sha256()
    for name, array in zip(designs.names, designs.arrays, strict=True):
        digest.update(f"{name} {array.dtype} {array.shape};".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    try:
        told = json.dumps(dict(settings or {}), sort_keys=True)
    except TypeError as error:
        raise ValueError(
            f"`settings` must be numbers, texts, and lists of them: {error}."
        ) from None
    return {
        "study": getattr(study, "__qualname__", type(study).__qualname__),
        "settings": told,
        "units": json.dumps(dict(units or {}), sort_keys=True),
        "chunk": program.chunk,
        "program": program.fingerprint,
        "designs": digest.hexdigest(),
        "twistorjax": importlib.metadata.version("twistorjax"),
        "jax": jax.__version__,
        "backend": jax.default_backend(),
    }


def _in_memory(
    layout: Layout, values: Mapping[str, np.ndarray], attributes: Mapping[str, Any]
) -> "xarray.Dataset":
    told = {
        name: Column(values[name], column.axes, column.unit, column.labels)
        for name, column in layout.by_design.items()
    }
    table = dataset({**layout.fixed, **told}, OUTCOMES)
    table = table.set_coords(layout.designs.names).assign_attrs(attributes)
    return finished(table, layout.grid, layout.places)


def _shown(
    program: Program, designs: Designs, chunks: Sequence[int], progress: bool
) -> Iterator[tuple[int, StudyOutput]]:
    """The chunks as they are found, with a bar that counts designs."""
    from tqdm import tqdm

    count, size = len(designs), program.chunk
    total = sum(min(size, count - number * size) for number in chunks)
    with tqdm(total=total, unit="design", unit_scale=True, disable=not progress) as bar:
        for number, told in program.run(designs, chunks):
            yield number, told
            bar.update(min(size, count - number * size))


def _together(step: str) -> None:
    """Waits until all processes are there."""
    if jax.process_count() > 1:
        from jax.experimental import multihost_utils

        multihost_utils.sync_global_devices(step)


def _gathered(
    kept: dict[str, np.ndarray], designs: Designs, program: Program
) -> dict[str, np.ndarray]:
    """The numbers of all processes, of which each has those of its own chunks."""
    if jax.process_count() == 1:
        return kept
    from jax.experimental import multihost_utils

    owner = np.repeat(program.owners(designs), program.chunk)[: len(designs)]
    rows = np.arange(len(owner))
    return {
        name: np.asarray(multihost_utils.process_allgather(values))[owner, rows]
        for name, values in kept.items()
    }


def failures(table: "xarray.Dataset") -> dict[str, int]:
    """How many designs have no answer, by what became of them."""
    codes = np.asarray(table["result"])[~np.asarray(table["succeeded"])]
    return dict(Counter(RESULT_NAMES[code] for code in codes.ravel() if code != UNKNOWN))


def warn_of_failures(table: "xarray.Dataset") -> None:
    """Counts the designs that have no answer, and says why."""
    if not (counts := failures(table)):
        return
    why = " ".join(
        f"{count:,} {name}: {result_message(name)}" for name, count in counts.items()
    )
    warnings.warn(
        f"{sum(counts.values()):,} of {table['succeeded'].size:,} designs have no "
        f"answer: their numbers are NaN. {why}",
        stacklevel=3,
    )
