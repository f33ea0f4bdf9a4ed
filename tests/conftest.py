"""Fixtures that run the command line."""

import os
import subprocess
import sys

import pytest


class CommandLine:
    """Calls of the command line in a folder, with a separate cache."""

    def __init__(self, folder):
        self.folder = folder
        self.environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
        self.environment.pop("JAX_COMPILATION_CACHE_DIR", None)

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
    """Run `twistorjax` in a separate process, with a separate cache."""
    return CommandLine(tmp_path_factory.mktemp("run"))


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
        code = exit_info.value.code
        assert isinstance(code, int)
        return subprocess.CompletedProcess(arguments, code, out, err)

    return run_here
