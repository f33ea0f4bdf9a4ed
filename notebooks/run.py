"""Runs every notebook from top to bottom: `python notebooks/run.py --help`."""

import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Annotated

import nbformat
import typer
from nbclient import NotebookClient


LONGEST = 150  # a notebook takes less than a minute on a machine of its own; s
LARGEST = 3e5  # of one output: what is kept is read on slow lines; bytes


def main(
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep their outputs in the files.")
    ] = False,
    names: Annotated[
        list[str] | None, typer.Argument(help="Of notebooks, by default all.")
    ] = None,
) -> None:
    """Runs notebooks, two at a time; ends with 1 where one fails, or keeps too much."""
    folder = Path(__file__).parent
    paths = [Path(name) for name in names or []] or sorted(folder.glob("*.ipynb"))
    failed = False
    with ProcessPoolExecutor(2) as pool:
        for path, work in [(path, pool.submit(run, path, keep)) for path in paths]:
            error = work.exception()
            failed |= error is not None
            print(f"{path.name}: {error or work.result()}", flush=True)
    raise typer.Exit(int(failed))


def run(path: Path, keep: bool) -> str:
    """Runs one, and tells how long it took."""
    notebook = nbformat.read(path, as_version=4)
    metadata = dict(notebook.metadata)
    begun = time.perf_counter()
    NotebookClient(notebook, timeout=LONGEST, record_timing=False).execute()
    taken = time.perf_counter() - begun
    sizes = [len(str(o)) for c in notebook.cells for o in c.get("outputs", [])]
    if max(sizes, default=0) > LARGEST:
        raise ValueError(f"an output of {max(sizes):,} bytes: draw less.")
    if keep:
        for cell in notebook.cells:  # warnings name paths of this machine
            if "outputs" in cell:
                cell.outputs = [o for o in cell.outputs if o.get("name") != "stderr"]
        notebook.metadata = nbformat.from_dict(metadata)  # not this machine's Python
        nbformat.write(notebook, path)
    return f"{taken:.0f} s, largest output {max(sizes, default=0) / 1e3:.0f} kB"


if __name__ == "__main__":
    typer.run(main)
