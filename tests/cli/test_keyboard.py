"""The operator's keys: at a terminal each does what it says, elsewhere there are none."""

from __future__ import annotations

import io
import os
import sys
import threading
import time

import pytest

from cnc.cli.keyboard import Keyboard
from cnc.model.diagnostics import UsageError
from cnc.model.operator_control import Control

pty = pytest.importorskip("pty")


@pytest.mark.parametrize(
    ("keys", "held", "override", "stopped"),
    [
        ("", False, 100, False),
        (" ", True, 100, False),
        ("  ", False, 100, False),
        ("++", False, 120, False),
        ("-", False, 90, False),
        ("-" * 20, False, 10, False),
        ("+" * 20, False, 200, False),
        ("q", False, 100, True),
        ("xyz\x1b[A", False, 100, False),
    ],
)
def test_keys_become_wishes(keys: str, held: bool, override: float, stopped: bool) -> None:
    control = Control()
    reader = Keyboard(control)
    for key in keys:
        reader.press(key)
    assert (control.held, control.feed_override, control.stopped) == (held, override, stopped)


def test_a_lower_override_than_the_keys_give_stays() -> None:
    control = Control(4.0)
    Keyboard(control).press("-")
    assert control.feed_override == 4.0


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch):
    import termios

    ours, theirs = pty.openpty()
    stream = os.fdopen(theirs, "r")
    monkeypatch.setattr(sys, "stdin", stream)
    before = termios.tcgetattr(theirs)
    yield ours
    assert termios.tcgetattr(theirs) == before
    stream.close()
    os.close(ours)


def until(control: Control, what: str) -> None:
    end = time.monotonic() + 5.0
    while not getattr(control, what) and time.monotonic() < end:
        time.sleep(0.005)
    assert getattr(control, what)


def test_keys_are_read_at_a_terminal_and_it_is_left_as_it_was(terminal: int) -> None:
    control = Control()
    with Keyboard(control) as keys:
        assert keys.available
        os.write(terminal, b" ")
        until(control, "held")
        os.write(terminal, b"q")
        until(control, "stopped")


@pytest.mark.parametrize(
    ("key", "agreed"), [(b"y", True), (b"Y", True), (b"n", False), (b"q", False), (b" ", False)]
)
def test_a_question_is_answered_by_a_key(
    terminal: int, capsys: pytest.CaptureFixture[str], key: bytes, agreed: bool
) -> None:
    control = Control()
    with Keyboard(control) as keys:
        later = threading.Timer(0.1, os.write, (terminal, key))
        later.start()
        assert keys.confirm(["from line 8:", "lift Z to 5"], yes=False) is agreed
        later.join()
    assert "lift Z to 5" in capsys.readouterr().err
    assert not control.stopped
    assert not control.held


def test_without_a_terminal_there_are_no_keys_and_nobody_to_ask(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("q"))
    control = Control()
    with Keyboard(control) as keys:
        assert not keys.available
        assert keys.confirm(["from line 8:"], yes=True)
        with pytest.raises(UsageError) as caught:
            keys.confirm(["from line 8:"], yes=False)
    assert caught.value.diagnostic.code == "needs-yes"
    assert not control.stopped
