"""Hook of mkdocs: the code of a page draws its figures.

A page shows a figure that its own code saves: `![A guide](guide.svg)`, or
`<iframe src="../guide.html">`. The file is not kept; the code of the page
runs while the manual is built. Other pages may show it as well. The figures
of a page are drawn again if its code or the library has changed. To check
the links only, set the environment variable `FIGURES` to `empty`.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files


FOLDER = Path(__file__).parent
CACHE = FOLDER.parent / ".cache" / "figures"
EMPTY = b'<svg xmlns="http://www.w3.org/2000/svg"/>'


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the figures that the code of pages saves."""
    wanted = [
        (page, names)
        for page in files.documentation_pages()
        if (names := figures_of(page))
    ]
    with ThreadPoolExecutor(2) as pool:
        drawn = pool.map(lambda page: contents(*page), wanted)
        for (page, _), figures in zip(wanted, drawn, strict=True):
            for name, content in figures.items():
                path = Path(page.src_uri).with_name(name).as_posix()
                files.append(File.generated(config, path, content=content))
    return files


def contents(page: File, names: list[str]) -> dict[str, bytes]:
    """Return the contents of the figures of a page."""
    if os.environ.get("FIGURES") == "empty":
        return dict.fromkeys(names, EMPTY)
    folder = draw(page.content_string)
    for name in names:
        if not (folder / name).exists():
            raise FileNotFoundError(
                f"{page.src_uri} shows {name}, but its code does not save "
                "this figure."
            )
    return {name: (folder / name).read_bytes() for name in names}


def figures_of(page: File) -> list[str]:
    """Return the names of the figures that a page shows and saves."""
    if not page.src_uri.endswith(".md"):
        return []
    shown = re.findall(
        r"!\[[^]]*\]\(([\w-]+\.(?:svg|gif))\)"
        r'|<iframe src="../([\w-]+\.html)"',
        page.content_string,
    )
    shown = [figure or frame for figure, frame in shown]
    code = "\n".join(code_of(page.content_string))
    return [name for name in shown if f'"{name}"' in code]


def draw(text: str) -> Path:
    """Run the code of a page, unless it was run before.

    Returns the folder with its figures.
    """
    code = "\n".join(code_of(text))
    digest = hashlib.sha256(code.encode() + sources())
    folder = CACHE / digest.hexdigest()[:16]
    if folder.exists():
        return folder
    guide = code_of((FOLDER / "manual" / "start.md").read_text())[0]
    with tempfile.TemporaryDirectory() as work:
        (Path(work) / "guide.py").write_text(guide)
        settings = "import matplotlib\nmatplotlib.use('svg')\n"
        subprocess.run(
            [sys.executable, "-c", settings + code],
            cwd=work,
            check=True,
            stdout=subprocess.DEVNULL,
        )
        shutil.copytree(work, folder, dirs_exist_ok=True)
    return folder


@cache
def sources() -> bytes:
    """Return a digest of the sources of the library."""
    paths = sorted((FOLDER.parent / "twistorjax").rglob("*.py"))
    content = b"".join(path.read_bytes() for path in paths)
    return hashlib.sha256(content).digest()


def code_of(text: str) -> list[str]:
    """Return the Python code blocks of a page."""
    return re.findall(
        r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE
    )
