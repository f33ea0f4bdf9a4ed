"""Evaluation of a study for many designs, with one dataset as the result."""

import operator
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TYPE_CHECKING

import jax
import numpy as np
from jaxtyping import Bool

from .._utils.memory import memory_error, require_memory
from .._utils.progress import announced, progress_bar
from .._utils.validation import compilation_error, quote, require_package, warn
from ..designs.designs import Designs, Grid as Grid, grid_chunk_size
from ..designs.sampling import sample_designs as sample_designs
from ..results.codes import result_message, RESULT_NAMES
from ..results.tables import Column, dataset
from .dataset import (
    finish_dataset,
    Layout,
    MINIMUM_OUTPUT_SIZE,
    NOT_COMPUTED,
    RESULT_FLAGS,
)
from .executor import (
    default_chunk_size,
    default_memory,
    find_program,
    gather,
    Program,
    synchronize,
)
from .names import check_storable
from .outputs import StudyOutput
from .stores.creation import require_writable
from .stores.files import clear_errors, damage_error
from .stores.identity import open_store, sweep_identity
from .stores.store import Store


if TYPE_CHECKING:
    import xarray


@announced("sweep")
def sweep(
    study: Callable[[Any], Any],
    designs: Any,
    *,
    derivatives: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
    chunk_size: int | None = None,
    memory: float | int | None = None,
    mesh: jax.sharding.Mesh | None = None,
    store: str | Path | None = None,
    resume: bool = False,
    part: tuple[int, int] | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: bool = False,
) -> "xarray.Dataset":
    """Evaluate a study for many designs.

    The designs are evaluated in chunks, each of which is one vectorized call of a
    compiled program. If a design fails, its real and complex outputs are NaN, `succeeded`
    is False and `result` holds the reason; the other designs are unaffected. A warning
    reports the number of failed designs.

    Args:
        study: Function of one design, which has the structure of `designs`. It typically
            builds a mechanism, solves it with `throw=False`, and returns a solution, a
            number, an array, or a mapping from names to these. If it also returns a
            `RESULTS`, such as `solution.result`, a design succeeds if this result is a
            success. Otherwise a design succeeds if all outputs are finite. The study is
            traced once in each call for all designs, with the values that its variables
            have at this time, so random numbers from `numpy.random` are the same for all
            designs. It is compiled again only if it computes something else than before.
            Functions that it calls must not be compiled by `jax.jit` if they use
            variables that change, because JAX keeps the first values of these.
        designs: Mapping from names to arrays, or another tree of arrays, whose first axis
            has one entry for each design; `sample_designs` returns such a tree. A `Grid`
            contains all combinations of given values.
        derivatives: Names of the outputs that are differentiated with respect to each
            parameter in the same pass. The derivative of `gain` with respect to `web` has
            the name `gain_by_web`.
        units: Units of parameters, and of outputs without a unit of their own, by name.
        chunk_size: Number of designs that a device evaluates in one call. The default is
            at most 4096 on a processor and 131,072 on an accelerator, or less if `memory`
            requires it.
        memory: Memory that a chunk may use on each device; bytes. The default is 1 GiB on
            a processor, and half of the memory of an accelerator.
        mesh: Devices of this process, or of all processes that `jax.distributed`
            connects. Each device evaluates chunks of its own. The default is one device.
        store: Folder in zarr format in which each chunk is saved as soon as it is
            computed, so that an interrupted sweep can be resumed. Several processes need
            a common folder. Names in a store must not contain spaces or slashes. The
            outputs of a grid have its axes in the store, unless a given `chunk_size` does
            not fit to them; `open_sweep` returns the grid in any case.
        resume: Whether an existing store is continued. Intact chunks are not computed
            again. Damaged or missing files are written again.
        part: The k-th of n parts of the sweep, as `(k, n)` with k from 1 to n, for the
            jobs of a cluster that share a `store`. It has every n-th chunk. Parts may run
            at the same time and on several machines with one file system, and may be
            killed and repeated: each creates or continues the store, whose files have the
            bits of a sweep without parts.
        settings: Further entries for the attributes of the dataset, which JSON can
            represent. A store is resumed only if they are the same.
        progress: Whether a progress bar is shown.

    Returns:
        A dataset with the axis `design`, or with the parameters of a grid as axes. It
        holds the parameters, the outputs, `succeeded` and `result`. With a store, it is
        what `open_sweep` returns; the designs of other parts may be missing, and
        `chunks_missing` is the number of chunks that are.

    Raises:
        ImportError: xarray is not installed, or a store is used and zarr is not
            installed.
        ValueError: The designs have different lengths; a name is unknown, is used twice
            or cannot be stored; an output is not numeric; the store exists, `resume` is
            False, and there is no `part`; the store belongs to another sweep; there is no
            such part; a chunk does not fit into `memory`; or the dataset does not fit
            into the memory of the machine.
        OSError: The store cannot be read or written, or its manifest is damaged.
        RuntimeError: A solve in the study raised an error, because it was called without
            `throw=False`.

    Example:
        >>> import jax.numpy as jnp
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> def cantilever(design):
        ...     leaf = tj.flexures.leaf(
        ...         steel, length=0.05, thickness=design["thickness"], width=0.01
        ...     )
        ...     mechanism = tj.Mechanism(
        ...         bodies=[tj.Body("wall"), tj.Body("tip", pose=(0.0, 0.05, 0.0))],
        ...         hinges=[tj.Hinge("leaf", "wall", "tip", leaf, at=(0.0, 0.025, 0.0))],
        ...         fixed=["wall"],
        ...     )
        ...     load = tj.Load("tip", (0.0, 0.0, -1.0))
        ...     solution = tj.equilibrium(mechanism, loads=[load], throw=False)
        ...     deflection = -solution.displacement("tip")[2]
        ...     return {"deflection": deflection, "result": solution.result}
        >>> thickness = jnp.array([0.5e-3, 1e-3])
        >>> units = {"thickness": "m", "deflection": "m"}
        >>> table = tj.sweep(cantilever, {"thickness": thickness}, units=units)
        >>> table.deflection.values
        array([0.00190..., 0.00023...])
    """
    require_packages(store)
    if not callable(study):
        raise ValueError(f"`study` is {study!r}, but must be a function of one design.")
    designs = Designs(designs)
    if isinstance(derivatives, str):
        derivatives = (derivatives,)
    if chunk_size is not None and chunk_size < 1:
        raise ValueError(f"`chunk_size` is {chunk_size}, but must be at least 1.")
    memory = default_memory(mesh) if memory is None else memory
    if not memory > 0:
        raise ValueError(f"`memory` is {memory} bytes, but must be positive.")
    if resume and store is None:
        raise ValueError("`resume` is True, but there is no `store`. Specify its path.")
    of_part = rows_of_part(part, store)
    resume = resume or part is not None
    existing = None
    if store is not None:
        check_storable(designs.names)
        if Path(store).exists():
            existing = Store(store)
        else:
            require_writable(Path(store))
    # Outputs in a store are read when they are used, except for those of a grid.
    in_memory = store is None or designs.dims != ("design",)
    needed = sum(array.nbytes for array in designs.arrays)
    needed += MINIMUM_OUTPUT_SIZE * len(designs) if in_memory else 0
    require_memory(len(designs), needed)
    # Every process must look for the store before the first of them creates it.
    synchronize("store checked")
    if existing is not None and not resume:
        raise ValueError(
            f"`store` is {str(store)!r}, which already exists. Continue it with "
            "`resume=True`, or use another path."
        )
    fixed_chunk_size = chunk_size is not None or existing is not None
    if chunk_size is None and existing is not None:
        chunk_size = existing.identity["chunk_size"]
    elif chunk_size is None:
        chunk_size = default_chunk_size(-(-len(designs) // of_part.step), mesh)
        if store is not None and designs.dims != ("design",):
            chunk_size = grid_chunk_size(designs.shape, chunk_size)
    try:
        program = find_program(
            study, designs.structure, tuple(derivatives), chunk_size, memory, mesh,
            fixed_chunk_size,
        )  # fmt: skip
    except jax.errors.JAXTypeError as error:
        raise compilation_error("study", "about the design", error) from error
    layout = Layout(designs, program.output, dict(units or {}))
    if store is not None:
        layout.check_storable()
    needed = layout.memory_size(outputs=in_memory)
    require_memory(len(designs), needed)
    program.fit_memory()
    if store is None:
        try:
            values = layout.allocate()
        except MemoryError:
            raise memory_error(len(designs), needed) from None
        chunks = range(program.chunk_count(designs))
        for chunk, output in _run(program, designs, chunks, progress):
            first = chunk * program.chunk_size
            for name, chunk_values in layout.values(output).items():
                rows = values[name][first : first + program.chunk_size]
                rows[:] = chunk_values[: len(rows)]
        owners = np.repeat(program.chunk_owners(designs), program.chunk_size)
        gathered = gather(values, owners[: len(designs)])
        identity = sweep_identity(study, designs, program, units, settings)
        table = _assemble(layout, gathered, identity)
    else:
        identity = sweep_identity(study, designs, program, units, settings)
        opened = open_store(Path(store), layout, identity, resume)
        own = np.zeros(program.chunk_count(designs), bool)
        own[of_part] = True
        missing = np.flatnonzero(own & ~opened.intact_chunks(own))
        synchronize("sweep started")
        for chunk, output in _run(program, designs, missing.tolist(), progress):
            opened.write(chunk, layout.values(output))
        synchronize("sweep finished")
        if part is not None:  # Each part reads and reports its own failures only.
            flags = {name: opened.read(name, own) for name in ("succeeded", "result")}
            warn_of_failures(flags)
            return _dataset(opened)
        table = open_sweep(store, verify=False)
    warn_of_failures(table)
    return table


def rows_of_part(part: tuple[int, int] | None, store: str | Path | None) -> slice:
    """Return which chunks of a sweep, or searches, a part has: every n-th one.

    Which they are does not depend on what is missing, because parts begin at different
    times. Without a part, these are all.
    """
    if part is None:
        return slice(0, None, 1)
    if store is None:
        raise ValueError(
            f"`part` is {quote(part)}, but there is no `store` for all parts. Specify "
            "its path."
        )
    try:
        k, n = (operator.index(number) for number in part)
    except (TypeError, ValueError):
        k, n = 0, 0
    if not 1 <= k <= n:
        raise ValueError(
            f"`part` is {quote(part)}, but must be (k, n), the k-th of n parts, with k "
            "from 1 to n."
        )
    return slice(k - 1, None, n)


def open_sweep(store: str | Path, *, verify: bool = True) -> "xarray.Dataset":
    """Open the dataset of a sweep that was saved in a store.

    The sweep may be incomplete. The outputs of a design that has not been computed, or
    whose files are damaged, are NaN; its `succeeded` is False and its `result` is -1. The
    attribute `chunks_missing` is the number of such chunks, which `sweep` computes if it
    resumes the store. Coordinates, labels and metadata are always verified.

    Args:
        store: Folder of the store.
        verify: Whether all outputs are read once and compared with their checksums.
            Otherwise they are read when they are used, and damaged files may remain
            undetected.

    Returns:
        The dataset, as `sweep` returns it.

    Raises:
        ImportError: xarray or zarr is not installed.
        ValueError: The folder is not a store of a sweep, or has another format.
        OSError: The store does not exist, cannot be read, or its coordinates, labels or
            metadata are damaged.
    """
    require_packages(store)
    opened = Store(store).open("r")
    available = opened.intact_chunks() if verify else opened.written_chunks()
    return _dataset(opened, available, verify=verify)


def _dataset(
    opened: Store,
    available: Bool[np.ndarray, " chunks"] | None = None,
    *,
    verify: bool = False,
) -> "xarray.Dataset":
    """Return the dataset of a store, without the chunks that are not available.

    If none are given, all are taken as they are, and read when they are used.
    """
    import xarray

    with clear_errors(opened.path, "read"):
        table = xarray.open_zarr(
            opened.path, consolidated=False, chunks=None, zarr_format=3
        )
    # The order in which zarr finds the arrays is that of the file system.
    coordinates = {name: table.coords[name] for name in sorted(map(str, table.coords))}
    outputs = {name: table[name].variable for name in opened.output_names}
    table = xarray.Dataset(outputs, coordinates, table.attrs)
    missing = ~(opened.written_chunks() if available is None else available)
    table = table.assign_attrs(chunks_missing=int(np.sum(missing)))
    if available is not None and missing.any():
        outputs = {
            name: table[name].copy(data=opened.read(name, available))
            for name in opened.output_names
        }
        table = table.assign(outputs)
    try:
        table = finish_dataset(table, opened.grid, opened.coordinates)
        return table.load() if opened.grid else table
    except Exception:  # Without verification, what is read here may be damaged.
        if verify:
            raise
        remedy = "Open it with `verify=True`."
        raise damage_error(opened.path, "an output", remedy) from None


def require_packages(store: str | Path | None) -> None:
    """Check that the packages for datasets, and for a store if given, are installed."""
    require_package("xarray", "Sweeps", "data")
    if store is not None:
        require_package("zarr", "Stores", "data")


def failures(table: "xarray.Dataset | Mapping[str, np.ndarray]") -> dict[str, int]:
    """Count the failed designs of a dataset for each result name.

    Designs that have not been evaluated are not counted.
    """
    codes = np.asarray(table["result"])[~np.asarray(table["succeeded"])]
    names = [RESULT_NAMES[code] for code in codes.ravel() if code != NOT_COMPUTED]
    return dict(Counter(names))


def warn_of_failures(table: "xarray.Dataset | Mapping[str, np.ndarray]") -> None:
    """Warn if designs of a dataset failed, with their number and the reasons."""
    if not (counts := failures(table)):
        return
    reasons = " ".join(
        f"{count:,} {name}: {result_message(name)}" for name, count in counts.items()
    )
    evaluated = int(np.sum(np.asarray(table["result"]) != NOT_COMPUTED))
    warn(
        f"{sum(counts.values()):,} of {evaluated:,} designs failed, and their outputs "
        f"are NaN. {reasons}"
    )


def _run(
    program: Program, designs: Designs, chunks: Sequence[int], progress: bool
) -> Iterator[tuple[int, StudyOutput]]:
    """Evaluate chunks of designs, with a progress bar that counts designs."""
    count, size = len(designs), program.chunk_size
    total = sum(min(size, count - chunk * size) for chunk in chunks)
    with progress_bar(total, "design", progress, unit_scale=True) as bar:
        for chunk, output in program.run(designs, chunks):
            yield chunk, output
            bar.update(min(size, count - chunk * size))


def _assemble(
    layout: Layout, values: Mapping[str, np.ndarray], attributes: Mapping[str, Any]
) -> "xarray.Dataset":
    """Assemble the dataset from values in memory."""
    outputs = {
        name: Column(values[name], column.axes, column.unit, column.labels)
        for name, column in layout.outputs.items()
    }
    table = dataset({**layout.parameters, **outputs}, RESULT_FLAGS)
    table = table.set_coords(layout.designs.names).assign_attrs(attributes)
    return finish_dataset(table, layout.grid, layout.coordinates)
