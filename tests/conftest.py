"""The option `--part`, and fixtures that run the command line."""

import os
import subprocess
import sys
import zlib

import pytest


def pytest_addoption(parser):
    text = "one of n parts, k/n, of the tests, and all whose numbers the manual shows"
    parser.addoption("--part", metavar="K/N", help=text)


def pytest_collection_modifyitems(config, items):
    if (part := config.getoption("part")) is None:
        return
    chosen, count = map(int, part.split("/"))

    kept, others = [], []
    for item in items:
        is_shown = "validated" in getattr(item, "fixturenames", ())
        runs = is_shown or zlib.crc32(item.nodeid.encode()) % count == chosen - 1
        (kept if runs else others).append(item)
    config.hook.pytest_deselected(items=others)
    items[:] = kept


class CommandLine:
    """Calls of the command line in a folder.

    They use the compiled programs of all tests or, with an `own_cache`, a new folder.
    """

    def __init__(self, folder, own_cache=False):
        self.folder = folder
        self.environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
        if own_cache:
            del self.environment["JAX_COMPILATION_CACHE_DIR"]

    def __call__(self, *arguments):
        """Run `twistorjax` in a separate process."""
        return subprocess.run(
            [sys.executable, "-m", "twistorjax", *arguments],
            capture_output=True,
            text=True,
            env=self.environment,
            cwd=self.folder,
            check=False,
        )


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run `twistorjax` in a separate process."""
    return CommandLine(tmp_path_factory.mktemp("run"))


@pytest.fixture
def run_with_own_cache(tmp_path):
    """Run `twistorjax` in a separate process, with a new cache."""
    return CommandLine(tmp_path, own_cache=True)


class CommandLineHere:
    """Calls of the command line in this process, which is faster.

    Args:
        folder: Folder in which the commands run.
        monkeypatch: Fixture of pytest.
        capsys: Fixture of pytest.
    """

    def __init__(self, folder, monkeypatch, capsys):
        self.folder, self.monkeypatch, self.capsys = folder, monkeypatch, capsys

    def __call__(self, *arguments):
        """Run `twistorjax` in this process."""
        # Not before the plugin of jaxtyping has prepared the import of the package.
        from twistorjax.cli.app import main

        self.monkeypatch.setattr(sys, "argv", ["twistorjax", *arguments])
        with pytest.raises(SystemExit) as exit_info:
            main()
        out, err = self.capsys.readouterr()
        code = exit_info.value.code
        assert isinstance(code, int)
        return subprocess.CompletedProcess(arguments, code, out, err)


@pytest.fixture
def run_here(tmp_path, monkeypatch, capsys):
    """Run `twistorjax` in this process, in a folder of the test."""
    monkeypatch.chdir(tmp_path)
    return CommandLineHere(tmp_path, monkeypatch, capsys)
