"""Work that takes long is named in one line, which disappears."""

import io
import sys
import time
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import twistorjax as tj
from twistorjax._utils import progress


class Terminal(io.StringIO):
    """A terminal, which keeps all that was written to it."""

    def isatty(self) -> bool:
        return True

    def screen(self) -> str:
        """Return the text that is on the last line now."""
        line = ""
        for part in self.getvalue().split("\r"):
            line = part + line[len(part) :]
        return line.rstrip()


@pytest.fixture
def terminal(monkeypatch):
    written = Terminal()
    # pytest replaces `sys.stderr` when a test begins.
    streams = SimpleNamespace(stderr=written, modules=sys.modules)
    monkeypatch.setattr(progress, "sys", streams)
    monkeypatch.setattr(progress, "_DELAY", 0.05)
    monkeypatch.setattr(progress, "_PERIOD", 0.01)
    return written


class SlowlyTraced(tj.Quadratic):
    """An energy that is traced for longer than the delay of the line."""

    def stored_energy(self, displacement):
        time.sleep(0.2)
        return super().stored_energy(displacement)


def spring(energy=tj.Quadratic):
    hinge = tj.Hinge("spring", "wall", "block", energy(np.eye(3)), (0, 0, 0))
    return tj.Mechanism([tj.Body("wall"), tj.Body("block")], [hinge], fixed=["wall"])


def test_long_work_is_named_in_a_line_that_disappears(terminal):
    with progress.activity("path: 3 bodies"):
        time.sleep(0.2)
        assert terminal.screen() == "path: 3 bodies (0 s)"
        with progress.activity("a part of it"):
            time.sleep(0.1)
    assert terminal.screen() == ""
    assert "part" not in terminal.getvalue()


def test_an_error_erases_the_line(terminal):
    with pytest.raises(RuntimeError), progress.activity("work"):
        time.sleep(0.2)
        assert terminal.screen()
        raise RuntimeError
    assert terminal.screen() == ""


def test_short_work_shows_nothing(terminal):
    with progress.activity("work"):
        pass
    time.sleep(0.1)
    assert terminal.getvalue() == ""


@pytest.mark.parametrize("enabled", [False, None])
def test_nothing_is_shown_without_a_terminal_or_if_it_is_not_wanted(
    terminal, monkeypatch, enabled
):
    monkeypatch.setattr(progress._line, "enabled", enabled)
    if enabled is None:
        monkeypatch.setattr(terminal, "isatty", lambda: False)
    with progress.activity("work"):
        time.sleep(0.15)
    assert terminal.getvalue() == ""


def test_an_analysis_names_itself_and_the_size_of_its_mechanism(terminal):
    mechanism = spring(SlowlyTraced)
    tj.equilibrium(mechanism, loads=[tj.Load("block", moment=0.1)])
    assert "compiling equilibrium: 2 bodies, 1 hinges" in terminal.getvalue()
    assert terminal.screen() == ""


def test_nothing_is_shown_inside_of_functions_of_jax(terminal):
    mechanism = spring()

    @jax.jit
    def angle(moment):
        load = tj.Load("block", moment=moment)
        return tj.equilibrium(mechanism, loads=[load]).displacement("block")[0]

    assert float(angle(0.1)) == pytest.approx(0.1, rel=0.01)
    assert terminal.getvalue() == ""


def test_a_progress_bar_replaces_the_line(terminal):
    pytest.importorskip("xarray")
    with (
        progress.activity("sweep"),
        progress.progress_bar(10, "design", False, file=terminal, mininterval=0) as bar,
    ):
        time.sleep(0.15)
        assert terminal.screen() == "sweep (0 s)"
        bar.update(5)
        time.sleep(0.1)
        assert "5/10" in terminal.screen()
        assert not terminal.screen().startswith("sweep")
    assert terminal.screen() == ""
