"""Progress of long commands: on a terminal only, never in the output that programs read."""

from __future__ import annotations

import io
import sys
import time

import pytest

from softmap_edge.commands.progress import Elapsed


class Terminal(io.StringIO):
    """A stream that counts as a terminal."""

    def isatty(self):
        return True


def drawn(terminal):
    return [line for line in terminal.getvalue().replace("\n", "\r").split("\r") if line.strip()]


@pytest.mark.parametrize("what", ["searching", "adapting the model", "x"])
def test_the_line_states_what_runs_and_the_seconds_and_is_cleared(monkeypatch, what):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    seconds = iter([100.0, *map(float, range(107, 10_000))])
    with Elapsed(what, clock=lambda: next(seconds), pace=0.001):
        until = time.monotonic() + 10.0
        while not drawn(terminal) and time.monotonic() < until:
            time.sleep(0.001)
    assert drawn(terminal)[0] == f"{what} … 7 s"
    assert terminal.getvalue().endswith(" \r")


@pytest.mark.parametrize("lines", [[], ["1: memory, backlash"], ["1: load, payload", "2: time"]])
def test_reported_lines_stay(monkeypatch, lines):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with Elapsed("searching", pace=60.0) as say:
        for line in lines:
            say(line)
    assert terminal.getvalue() == "".join(f"{line}\n" for line in lines)


@pytest.mark.parametrize(("stream", "silent"), [(io.StringIO, False), (Terminal, True)])
def test_nothing_is_written_without_a_terminal_or_when_silent(monkeypatch, stream, silent):
    target = stream()
    monkeypatch.setattr(sys, "stderr", target)
    with Elapsed("searching", silent=silent, pace=0.001) as say:
        say("1: memory, backlash")
        time.sleep(0.01)
    assert target.getvalue() == ""


def test_the_line_is_cleared_when_the_work_fails(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with pytest.raises(KeyboardInterrupt), Elapsed("searching", pace=0.001):
        until = time.monotonic() + 10.0
        while not drawn(terminal) and time.monotonic() < until:
            time.sleep(0.001)
        raise KeyboardInterrupt
    assert terminal.getvalue().endswith(" \r")
