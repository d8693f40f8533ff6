"""Keys of the operator: each request at a terminal, and no keys without one."""

from __future__ import annotations

import io
import os
import sys
import threading
from types import SimpleNamespace

import pytest

from cnc.cli.keyboard import Keyboard
from cnc.model.diagnostics import UsageError
from cnc.model.operator_control import Control
from tests.support.waiting import wait_until

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
def test_each_key_makes_its_request(keys: str, held: bool, override: float, stopped: bool) -> None:
    control = Control()
    reader = Keyboard(control)
    for key in keys:
        reader.press(key)
    assert (control.held, control.feed_override, control.stopped) == (held, override, stopped)


@pytest.mark.parametrize(
    ("key", "name"), [("r", "traverses"), ("[", "the spindle"), ("]", "the spindle")]
)
def test_a_request_that_the_board_does_not_know_is_told(
    capsys: pytest.CaptureFixture[str], key: str, name: str
) -> None:
    control = Control()
    control.take_board(overrides=False)
    Keyboard(control).press(key)
    assert capsys.readouterr().err == f"this board has no override of {name}\n"
    assert (control.rapid_override, control.spindle_override) == (100, 100)


def test_minus_does_not_raise_a_low_override() -> None:
    control = Control(4.0)
    Keyboard(control).press("-")
    assert control.feed_override == 4.0


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch):
    import termios

    master, slave = pty.openpty()
    stream = os.fdopen(slave, "r")
    monkeypatch.setattr(sys, "stdin", stream)
    before = termios.tcgetattr(slave)
    yield master
    assert termios.tcgetattr(slave) == before
    stream.close()
    os.close(master)


def wait_for(control: Control, request: str) -> None:
    wait_until(lambda: getattr(control, request))


def test_keys_are_read_and_the_terminal_mode_is_restored(terminal: int) -> None:
    control = Control()
    with Keyboard(control) as keys:
        assert keys.available
        os.write(terminal, b" ")
        wait_for(control, "held")
        os.write(terminal, b"q")
        wait_for(control, "stopped")


@pytest.mark.parametrize(
    ("key", "confirmed"), [(b"y", True), (b"Y", True), (b"n", False), (b"q", False), (b" ", False)]
)
def test_a_key_answers_the_question(
    terminal: int, capsys: pytest.CaptureFixture[str], key: bytes, confirmed: bool
) -> None:
    control = Control()
    with Keyboard(control) as keys:

        def answer() -> None:
            wait_until(lambda: keys._answers is not None)
            os.write(terminal, key)

        later = threading.Thread(target=answer)
        later.start()
        assert keys.confirm(["from line 8:", "lift Z to 5"], yes=False) is confirmed
        later.join()
    assert "lift Z to 5" in capsys.readouterr().err
    assert not control.stopped
    assert not control.held


def test_without_a_terminal_there_are_no_keys(
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


def test_a_terminal_that_is_gone_ends_the_reading(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    master, slave = pty.openpty()
    control = Control()
    with os.fdopen(slave, "r") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        with Keyboard(control) as keys:
            assert keys.available
            os.close(master)
            wait_until(lambda: "the terminal is gone" in caplog.text)
    assert not control.stopped


@pytest.mark.parametrize(
    "sequence",
    [b"\x1b[A", b"\x1b[B", b"\x1b[3~", b"\x1bOP", b"\x1b[15~", b"\x1b", b"\xc3\xa9", b"\x1b[Z"],
)
def test_a_key_of_several_bytes_makes_no_request(terminal: int, sequence: bytes) -> None:
    control = Control()
    with Keyboard(control):
        os.write(terminal, sequence)
        os.write(terminal, b"+")
        wait_until(lambda: control.feed_override == 110.0)
    overrides = (control.feed_override, control.rapid_override, control.spindle_override)
    assert overrides == (110.0, 100, 100.0)
    assert not control.held
    assert not control.stopped


class Console:
    """A console of Windows: keys wait in a queue, and nothing else of a terminal is there."""

    def __init__(self, keys: str) -> None:
        self._keys = list(keys)

    def read_keys(self) -> list[SimpleNamespace]:
        return [SimpleNamespace(key=self._keys.pop(0))] if self._keys else []

    def flush_keys(self) -> list[SimpleNamespace]:
        return []


def test_keys_of_a_windows_console_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    console = Console("+q")
    monkeypatch.setattr("prompt_toolkit.input.create_input", lambda _: console)
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    control = Control()
    with Keyboard(control) as keys:
        assert keys.available
        wait_for(control, "stopped")
    assert control.feed_override == 110.0


@pytest.mark.parametrize("closed", [True, False])
def test_without_standard_input_there_are_no_keys(
    monkeypatch: pytest.MonkeyPatch, closed: bool
) -> None:
    stream = io.StringIO() if closed else None
    if stream is not None:
        stream.close()
    monkeypatch.setattr(sys, "stdin", stream)
    with Keyboard(Control()) as keys:
        assert not keys.available


@pytest.mark.parametrize(
    ("keys", "rapid", "spindle"),
    [
        ("r", 50, 100),
        ("rr", 25, 100),
        ("rrr", 100, 100),
        ("]]", 100, 120),
        ("[", 100, 90),
        ("[" * 20, 100, 10),
        ("]" * 20, 100, 200),
    ],
)
def test_keys_override_traverses_and_spindle(keys: str, rapid: int, spindle: float) -> None:
    control = Control()
    reader = Keyboard(control)
    for key in keys:
        reader.press(key)
    assert (control.rapid_override, control.spindle_override) == (rapid, spindle)
