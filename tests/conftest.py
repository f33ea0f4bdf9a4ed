"""Fixtures that run the command line."""

import os
import subprocess
import sys

import pytest


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run `twistorjax` in a process of its own, with a cache of its own."""
    folder = tmp_path_factory.mktemp("run")
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}

    def run(*arguments):
        return subprocess.run(
            [sys.executable, "-m", "twistorjax", *arguments],
            capture_output=True,
            text=True,
            env=environment,
            cwd=folder,
            check=False,
        )

    run.folder = folder
    return run


@pytest.fixture
def run_here(monkeypatch, capsys):
    """Run `twistorjax` in this process, which is faster."""

    # Not before the plugin of jaxtyping has prepared the import of the package.
    from twistorjax.cli.app import main

    def run_here(*arguments):
        monkeypatch.setattr(sys, "argv", ["twistorjax", *arguments])
        with pytest.raises(SystemExit) as exit_info:
            main()
        out, err = capsys.readouterr()
        return subprocess.CompletedProcess(arguments, exit_info.value.code, out, err)

    return run_here
