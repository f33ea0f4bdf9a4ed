"""Run the notebooks from top to bottom: `python notebooks/run.py --help`."""

import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Annotated

import nbformat
import typer
from nbclient import NotebookClient


TIMEOUT = (
    150  # for one cell; a whole notebook takes less than a minute if alone; s
)
LARGEST_OUTPUT = (
    3e5  # of one cell, so that the manual loads on slow connections; bytes
)


def main(
    keep: Annotated[
        bool,
        typer.Option("--keep", help="Write the outputs into the notebooks."),
    ] = False,
    release: Annotated[
        bool, typer.Option("--release", help="Include the long notebooks.")
    ] = False,
    part: Annotated[
        str,
        typer.Option(help="Only one of n parts of the notebooks: k/n."),
    ] = "1/1",
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Paths of notebooks. [default: all short ones]"),
    ] = None,
) -> None:
    """Run notebooks, two at a time. The exit code is 1 if one fails.

    A long notebook has the tag "release" in its metadata. As the tests with
    this mark, it is run before a release, or if its path is given.
    """
    folder = Path(__file__).parent
    paths = [Path(name) for name in names or []] or [
        path
        for path in sorted(folder.glob("*.ipynb"))
        if release or not is_long(path)
    ]
    chosen, count = map(int, part.split("/"))
    paths = paths[chosen - 1 :: count]
    failed = False
    with ProcessPoolExecutor(2) as pool:
        for path, job in [
            (path, pool.submit(run, path, keep)) for path in paths
        ]:
            error = job.exception()
            failed |= error is not None
            print(f"{path.name}: {error or job.result()}", flush=True)
    raise typer.Exit(int(failed))


def is_long(path: Path) -> bool:
    """Whether a notebook is run before a release only."""
    notebook = nbformat.read(path, as_version=4)
    return "release" in notebook.metadata.get("tags", [])


def run(path: Path, keep: bool) -> str:
    """Run one notebook.

    Args:
        path: Path of the notebook.
        keep: Whether its outputs are written into the file.

    Returns:
        The time it took and the size of its largest output, as text.

    Raises:
        ValueError: An output is larger than `LARGEST_OUTPUT`.
    """
    notebook = nbformat.read(path, as_version=4)
    metadata = dict(notebook.metadata)
    start = time.perf_counter()
    client = NotebookClient(
        notebook,
        timeout=TIMEOUT,
        record_timing=False,
        resources={"metadata": {"path": str(path.parent)}},  # as Jupyter
    )
    client.execute()
    seconds = time.perf_counter() - start
    sizes = [
        len(str(o)) for c in notebook.cells for o in c.get("outputs", [])
    ]
    if max(sizes, default=0) > LARGEST_OUTPUT:
        raise ValueError(
            f"An output has {max(sizes):,} bytes: draw fewer frames."
        )
    if keep:
        for cell in notebook.cells:
            if "outputs" in cell:  # warnings contain paths of this machine
                cell.outputs = [
                    o for o in cell.outputs if o.get("name") != "stderr"
                ]
        # the metadata that the run adds contain the version of Python
        notebook.metadata = nbformat.from_dict(metadata)
        nbformat.write(notebook, path)
    largest = max(sizes, default=0)
    return f"{seconds:.0f} s, largest output {largest / 1e3:.0f} kB"


if __name__ == "__main__":
    typer.run(main)
