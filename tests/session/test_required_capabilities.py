"""Capabilities that a program requires, checked before anything moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cnc.api import Callbacks, Control, Report, check, run
from cnc.boards.loopback import Loopback
from cnc.boards.protocols import Capabilities
from cnc.boards.stepper.outputs import actions
from cnc.cli import exit_code
from cnc.machine.load import load_machine
from cnc.machine.models import Axis
from tests.support.session.runs import run_with

MACHINE = load_machine("stepper-uno")


class Moving(Loopback):
    """A loopback board with the capabilities of a stepper board: it moves and reads probes."""

    wired = 3

    @property
    def capabilities(self) -> Capabilities:
        return replace(
            super().capabilities,
            senses=False,
            probes=True,
            slice_s=0.01,
            actions=actions(self.wired),
        )


class MovingFour(Moving):
    wired = 4


def ran(
    folder: Path, text: str, board: type[Moving] = Moving, **more: object
) -> tuple[Report, Loopback]:
    (folder / "p.ngc").write_text(f"G21 G90\n{text}\nG1 X1 F600\nM2\n")
    made = board(3)
    return run_with(folder / "p.ngc", MACHINE, board=made, **more), made


@pytest.mark.parametrize(
    ("words", "three", "four"),
    [
        ("M3 S500", "", ""),
        ("M4 S500", "", "not-on-board"),
        ("M8", "", ""),
        ("M7", "", "not-on-board"),
        ("M5 M9", "", ""),
        ("G96 S100 D500 M3", "not-on-board", "not-on-board"),
        ("M19 R0", "not-on-board", "not-on-board"),
        ("M62 P1", "not-on-board", "not-on-board"),
        ("M63 P1", "not-on-board", "not-on-board"),
        ("M64 P0", "not-on-board", "not-on-board"),
        ("M65 P0", "not-on-board", "not-on-board"),
        ("M67 E0 Q5", "not-on-board", "not-on-board"),
        ("M68 E0 Q5", "not-on-board", "not-on-board"),
        ("M66 P0 L0", "board-senseless", "board-senseless"),
        ("M3 S100 G33 Z-1 K1", "board-senseless", "board-senseless"),
        ("M1", "", ""),
        ("G4 P0.1", "", ""),
        ("M48", "", ""),
    ],
)
def test_words_that_the_board_cannot_carry_out_are_refused(
    tmp_path: Path, words: str, three: str, four: str
) -> None:
    for board, code in ((Moving, three), (MovingFour, four)):
        report, made = ran(tmp_path, words, board, pauses="refuse")
        assert [fault.diagnostic.code for fault in report.faults] == [code] * bool(code)
        assert report.exit_code == (1 if code else 0)
        if code:
            assert report.faults[0].diagnostic.line == 2
            assert report.faults[0].diagnostic.hint
            assert made.rows == 0 and not made.commands
    looked_at = check(tmp_path / "p.ngc", MACHINE)
    assert [fault.diagnostic.code for fault in looked_at.faults] == [three] * bool(three), (
        "a check for such a machine tells the same"
    )
    assert run(tmp_path / "p.ngc", MACHINE, board="loopback").ok, (
        "the GRBL simulator carries out everything"
    )


def test_a_rotary_axis_must_be_the_fourth(tmp_path: Path) -> None:
    report, _ = ran(tmp_path, "G1 A5 F600")
    assert report.exit_code == 1
    axes = {
        **MACHINE.axes,
        "a": Axis(steps_per_mm=10, max_velocity=40, max_acceleration=400, max_jerk=15_000),
    }
    assert check(tmp_path / "p.ngc", MACHINE.model_copy(update={"axes": axes})).ok


PAUSES = [
    ("M0", "the program stops here"),
    ("M1", "the program stops here"),
    ("M60", "change the pallet"),
    ("T2 M6", "put in tool 2"),
]


@pytest.mark.parametrize(("words", "why"), PAUSES)
def test_a_pause_waits_or_is_refused_or_skipped(tmp_path: Path, words: str, why: str) -> None:
    refused, made = ran(tmp_path, words, pauses="refuse", control=Control(), optional_stop=True)
    assert [fault.diagnostic.code for fault in refused.faults] == ["needs-operator"]
    assert refused.faults[0].diagnostic.line == 2
    assert made.rows == 0 and not made.commands
    control, reported = Control(), []

    def on_sent(sent) -> None:
        if sent.held:
            reported.append((sent.line, sent.hold_reason))
            control.resume()

    callbacks = Callbacks(on_sent=on_sent)
    assert ran(tmp_path, words, control=control, callbacks=callbacks, optional_stop=True)[0].ok
    assert reported == [(2, why)]
    assert ran(tmp_path, words, pauses="skip", control=Control(), optional_stop=True)[0].ok


@pytest.mark.parametrize("words", [words for words, _ in PAUSES])
def test_a_pause_needs_a_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    boards: list[Moving] = []

    def opened(*_: object, **__: object) -> Moving:
        boards.append(Moving(3))
        return boards[-1]

    monkeypatch.setattr("cnc.api.open_board", opened)
    (tmp_path / "p.ngc").write_text(f"G21 G90\n{words}\nG1 X1 F600\nM2\n")
    arguments = [str(tmp_path / "p.ngc"), "--machine", "stepper-uno", "--quiet", "--optional-stop"]
    assert exit_code(arguments) == 1
    assert boards[-1].rows == 0
    assert exit_code([*arguments, "--yes"]) == 0
    assert boards[-1].rows > 0
