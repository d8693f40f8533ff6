"""The screen while a program runs, and the plain lines in its place."""

import dataclasses
import io
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from rich.console import Console

from cnc.boards.protocols import MachineReport
from cnc.cli import progress as progress_display
from cnc.cli import run_screen
from cnc.cli.keyboard import HELP
from cnc.cli.progress import ProgressDisplay
from cnc.machine.load import load_machine
from cnc.model.operator_control import Control
from cnc.session.context import Callbacks
from cnc.session.run_pulses import Progress
from cnc.session.session import Session
from cnc.simulators.grbl.board import GrblSimulatorBoard
from tests.support.paths import ROOT

pty = pytest.importorskip("pty")

SENT = Progress(
    10.0,
    line=12,
    rows=40,
    position=(1.0, -20.5, 300.25),
    buffered=7,
    left=75.0,
    at=10,
    axes=("x", "y", "z"),
    machine=MachineReport("Run", (11.0, -10.5, 299.25), 1180.0, 999.6, (90, 50, 110)),
    text="G1 X1 F1200",
    feed=1200.0,
    tool=3,
)
SHOWN = {
    "state": "Run",
    "line": "10 of 60  G1 X1 F1200",
    "work": "X    11.000  Y   -10.500  Z   299.250",
    "machine": "X     1.000  Y   -20.500  Z   300.250",
    "feed": "1200 mm/min, actual 1180 mm/min",
    "spindle": "1000 rev/min  tool 3",
    "overrides": "feed 90 %  traverses 50 %  spindle 110 %",
    "time": "1:15 left  7 lines in the buffer",
    "keys": HELP,
}


def test_all_that_the_board_reports_is_shown() -> None:
    assert dict(run_screen.rows(SENT, Control(), 60)) == SHOWN


@pytest.mark.parametrize(
    ("progress", "expected"),
    [
        (Progress(0.0, 3, 5), {"state": "Run", "line": "3"}),
        (Progress(0.0, 3, 5, held=True), {"state": "Hold, held", "line": "3"}),
        (
            Progress(0.0, 3, 5, held=True, hold_reason="tool 2", machine=MachineReport("Hold")),
            {"state": "Hold, held: tool 2", "line": "3"},
        ),
        (
            Progress(0.0, 3, 5, left=3700.0, ahead=0.5),
            {"time": "1:01:40 left  0.50 s in the buffer"},
        ),
    ],
)
def test_what_is_not_known_is_left_out(progress: Progress, expected: dict[str, str]) -> None:
    shown = dict(run_screen.rows(progress, Control(), None))
    assert expected.items() <= shown.items()
    assert not {"work", "machine", "feed", "spindle"} & shown.keys()
    assert shown["overrides"] == "feed 100 %  traverses 100 %  spindle 100 %"


def test_an_override_that_waits_is_shown_as_such() -> None:
    shown = dict(run_screen.rows(Progress(0.0, 3, 5, pending=0.62), Control(50.0), None))
    assert shown["overrides"] == "feed 50 % (in 0.6 s at most)  traverses 100 %  spindle 100 %"


def test_the_screen_is_drawn_on_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_screen, "DELAY", 0.0)
    console = Console(file=io.StringIO(), force_terminal=True, width=100, record=True)
    screen = run_screen.RunScreen(Control(), console)
    screen.update(SENT, 60)
    assert screen.shown
    screen.close()
    text = console.export_text()
    for label, shown in SHOWN.items():
        if label != "keys":
            assert re.search(rf"^{label} +{re.escape(shown)} *$", text, re.MULTILINE), text
    assert "space holds and resumes" in text


def test_a_short_run_has_no_screen() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, record=True)
    screen = run_screen.RunScreen(Control(), console)
    screen.update(SENT, 60)
    assert not screen.shown
    screen.close()
    assert console.export_text() == ""


def test_plain_lines_come_at_intervals(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [100.0]
    monkeypatch.setattr(run_screen, "monotonic", lambda: now[0])
    lines = run_screen.PlainLines(Control())
    for now[0] in (101.0, 109.9, 110.1, 115.0, 120.2):
        lines.update(SENT, 60)
    expected = "Run; line 10 of 60; X 1.000 Y -20.500 Z 300.250; 1:15 left 7 lines in the buffer\n"
    assert capsys.readouterr().err == 2 * expected
    now[0] = 140.0
    lines.update(dataclasses.replace(SENT, line=0, at=0), None)
    assert capsys.readouterr().err.startswith("Run; X 1.000"), "homing has no lines"


@pytest.mark.parametrize(
    ("plain", "output", "live"),
    [(False, True, True), (True, True, False), (False, False, False)],
)
def test_the_screen_needs_a_terminal_as_standard_output(
    monkeypatch: pytest.MonkeyPatch, plain: bool, output: bool, live: bool
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: output)
    with progress_display.ProgressDisplay(Control(), quiet=False, plain=plain) as display:
        on_sent = display.callbacks().on_sent
        assert on_sent is not None
        on_sent(SENT)
        assert isinstance(display._screen, run_screen.RunScreen) is live


def test_a_run_reports_line_text_feed_and_tool(tmp_path: Path) -> None:
    program = ["G21 G90", "M3 S500", "G0 X5", "G1 X30 F600 (cut)", "T4 M6", "G1 X60 F1200", "M2"]
    (tmp_path / "p.nc").write_text("\n".join(program) + "\n")
    machine = load_machine("grbl-uno")
    board = GrblSimulatorBoard.from_machine(machine)
    control = Control()
    seen: dict[int, Progress] = {}

    def on_sent(progress: Progress) -> None:
        if progress.machine is not None and progress.machine.state == "Run":
            seen[progress.at or progress.line] = progress
        if progress.held:
            control.resume()

    report = Session(
        str(tmp_path / "p.nc"), machine, callbacks=Callbacks(on_sent=on_sent), control=control
    ).run(board, "grbl-sim")
    assert report.ok, report.faults
    before, after = seen[4], seen[6]
    assert (before.text, before.feed, before.tool) == ("G1 X30 F600 (cut)", 600.0, None)
    assert (after.text, after.feed, after.tool) == ("G1 X60 F1200", 1200.0, 4)
    assert before.machine is not None
    assert before.machine.spindle == 500.0
    assert before.axes == ("x", "y", "z")


def read_until(terminal: int, found: Callable[[bytes], bool]) -> bytes:
    """Return what a terminal shows until something is found, or the program has ended."""
    shown = b""
    while not found(shown):
        try:
            data = os.read(terminal, 65536)
        except OSError:
            break
        shown += data
    return shown


def test_a_terminal_shows_the_running_machine(tmp_path: Path) -> None:
    """The program waits at M0, so that nothing depends on the speed of this computer."""
    (tmp_path / "p.nc").write_text("G21 G90\nG1 X20 F600\nM0 (turn the part)\nX30\nM2\n")
    terminal, theirs = pty.openpty()
    run = subprocess.Popen(
        [sys.executable, "-m", "cnc.cli", str(tmp_path / "p.nc")]
        + ["--machine", "grbl-uno", "--board", "grbl-sim"],
        cwd=ROOT,
        env=os.environ | {"XDG_STATE_HOME": str(tmp_path), "TERM": "xterm", "COLUMNS": "120"},
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    )
    os.close(theirs)
    watchdog = threading.Timer(300.0, run.kill)
    watchdog.start()
    try:
        held = read_until(terminal, lambda shown: b"turn the part" in shown and b"work" in shown)
        assert b"X    20.000" in held
        assert b"space holds and resumes" in held
        os.write(terminal, b" ")
        rest = read_until(terminal, lambda _: False)
        assert run.wait() == 0, (held + rest).decode()
    finally:
        watchdog.cancel()
        run.kill()
        run.wait()
        with suppress(OSError):
            os.close(terminal)


def test_without_a_terminal_no_keys_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    for has_keys in (True, False):
        with ProgressDisplay(Control(), quiet=False) as display:
            if not has_keys:
                display.without_keys()
            on_sent = display.callbacks().on_sent
            assert on_sent is not None
            on_sent(Progress(0.0, 3, 5, held=True))
        assert ("space holds" in capsys.readouterr().err) == has_keys
