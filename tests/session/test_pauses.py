"""A pause and a safety door tell the operator why the machine waits, where, and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import Callbacks, Control, load_machine
from cnc.boards.grbl.driver import GrblBoard
from cnc.model.diagnostics import Diagnostic
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.firmware_profile import GRBLHAL
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.session.runs import run_with

MACHINE = load_machine("grbl-uno")


def pauses_of(
    tmp_path: Path,
    text: str,
    tools: str = "",
    box: GrblSimulator | None = None,
    warnings: list[Diagnostic] | None = None,
    *,
    optional_stop: bool = True,
) -> list[tuple[int, str]]:
    """Return line and reason of each pause of a program on a simulated board."""
    program, table = tmp_path / "p.nc", tmp_path / "tools.tbl"
    program.write_text(text)
    table.write_text(tools)
    reading = MACHINE.program.model_copy(update={"tool_table": table})
    machine = MACHINE.model_copy(update={"program": reading})
    control, seen = Control(), []

    def go_on(progress: Progress) -> None:
        if progress.held and progress.at_rest:
            seen.append((progress.line, progress.hold_reason))
            control.resume()

    port = GrblSimulatorPort(box or GrblSimulator())
    board = GrblBoard(port, machine, port.clock, "the simulator")
    board.connect()
    report = run_with(
        program,
        machine,
        board=board,
        control=control,
        callbacks=Callbacks(on_sent=go_on),
        optional_stop=optional_stop,
    )
    board.close()
    assert report.ok, report.faults
    if warnings is not None:
        warnings += report.warnings
    return seen


@pytest.mark.parametrize(
    ("text", "tools", "expected"),
    [
        ("G1 X1 F600\nT3 M6\nG1 X2\n", "T3 P1 D6 ;6 mm end mill\n",
         (2, "put in tool 3: 6 mm end mill (tool table)")),
        ("G1 X1 F600\n(drill 5 mm)\nT4 M6\nG1 X2\n", "T4 P1\n", (3, "put in tool 4: drill 5 mm")),
        ("G1 X1 F600\nT4 M6 (drill 5 mm)\nG1 X2\n", "T4 P1\n", (2, "put in tool 4: drill 5 mm")),
        ("G1 X1 F600\n(MSG, turn the part)\nM0\nG1 X2\n", "",
         (3, "the program stops here: turn the part")),
        ("G1 X1 F600\nM0 ; turn it\nG1 X2\n", "", (2, "the program stops here: turn it")),
        ("(first)\nG1 X1 F600\nM0\nG1 X2\n", "", (3, "the program stops here")),
        ("G1 X1 F600 (not this)\nM60\nG1 X2\n", "", (2, "change the pallet")),
        ("G1 X1 F600\nM1 (look)\nG1 X2\n", "", (2, "the program stops here: look")),
    ],
)  # fmt: skip
def test_a_pause_has_its_line_and_text(
    text: str, tools: str, expected: tuple[int, str], tmp_path: Path
) -> None:
    assert pauses_of(tmp_path, "G21 G90\n" + text + "M2\n", tools) == [
        (expected[0] + 1, expected[1])
    ]


def test_without_the_optional_stop_m1_does_not_wait_and_one_note_reports_it(tmp_path: Path) -> None:
    notes: list[Diagnostic] = []
    text = "G21 G90\nG1 X1 F600\nM1\nG1 X2\nM1\nM2\n"
    assert pauses_of(tmp_path, text, warnings=notes, optional_stop=False) == []
    found = [note for note in notes if note.code == "optional-stop-off"]
    assert [(note.line, note.severity) for note in found] == [(3, "note")]


@pytest.mark.parametrize(
    ("mode", "event", "warned"),
    [(0, "tool", ""), (1, "pause", "touch off"), (2, "pause", "G59.3"), (3, "pause", "measure")]
    + [(4, "pause", "")],
)
def test_grblhal_changes_the_tool_by_m6_where_it_only_waits(
    mode: int, event: str, warned: str, tmp_path: Path
) -> None:
    """``$341``: 0 waits in state Tool; modes that measure or ignore M6 get a pause."""
    box = GrblSimulator(GRBLHAL, settings={341: float(mode)})
    text = "G21 G90\nM3 S500\nG1 X1 F600\nT3 M6\nM3 S800\nG1 X2\nM2\n"
    warnings: list[Diagnostic] = []
    assert pauses_of(tmp_path, text, "T3 P1\n", box, warnings) == [(4, "put in tool 3")]
    found = [each for each in warnings if each.code == "tool-change-mode"]
    assert [(each.line, warned in each.message) for each in found] == [(4, True)] * bool(warned)
    waited = [(each.kind, each.value) for each in box.events if each.kind in ("tool", "pause")]
    assert waited == [(event, "3" if mode == 0 else "")]
    # The spindle stands still while the tool is changed.
    order = [
        "M5" if each.kind == "spindle" and each.value.startswith("M5") else each.kind
        for each in box.events
    ]
    assert "M5" in order[: order.index(event)]
    assert box.position == pytest.approx((2.0, 0.0, 0.0), abs=0.01)


@pytest.mark.parametrize(("checks", "expected"), [(False, [2]), (True, [])])
def test_pauses_left_out_are_reported(checks: bool, expected: list[int], tmp_path: Path) -> None:
    """Without an operator a tool change is left out: the first one is named, with the others."""
    program, simulator = tmp_path / "p.nc", GrblSimulator()
    program.write_text("G21 G90\nT2 M6\nG1 X1 F600\nM0\nG1 X2\nM2\n")
    port = GrblSimulatorPort(simulator)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator")
    board.connect()
    board.check_only = checks
    report = run_with(
        program,
        MACHINE,
        board=board,
        pauses="skip",
        check_on_board=checks,
        dialect="linuxcnc",
    )
    board.close()
    assert report.ok
    found = [each for each in report.warnings if each.code == "pause-skipped"]
    assert [(each.line, each.severity) for each in found] == [(k, "warning") for k in expected]
    assert all(
        "put in tool 2" in each.message and "1 later pause" in each.message for each in found
    )


def test_an_open_door_is_called_a_door(tmp_path: Path) -> None:
    box = GrblSimulator()
    program = tmp_path / "p.nc"
    program.write_text("G21 G90\nG1 X20 F600\nM2\n")
    control, reasons = Control(), []

    def watch(progress: Progress) -> None:
        door = box.core.environment
        if progress.position is not None and progress.position[0] > 3.0 and not reasons:
            door.door_open = box.core.flags.door = True
        if progress.held and progress.hold_reason not in reasons:
            reasons.append(progress.hold_reason)
        if progress.at_rest:
            if door.door_open:
                door.door_open = False
            else:
                control.resume()

    port = GrblSimulatorPort(box)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator")
    board.connect()
    report = run_with(
        program, MACHINE, board=board, control=control, callbacks=Callbacks(on_sent=watch)
    )
    board.close()
    assert report.ok, report.faults
    assert reasons[:2] == [
        "the safety door is open: close it, then resume",
        "the safety door was opened; it is closed now: resume",
    ]


@pytest.mark.parametrize(("most", "expected"), [(1000.0, [(3, "speed-above-board")]), (2000.0, [])])
def test_a_speed_that_the_board_lowers_is_a_warning(
    most: float, expected: list[tuple[int, str]], tmp_path: Path
) -> None:
    box = GrblSimulator(settings={30: most})
    text = "G21 G90\nM3 S900\nS1500\nG1 X1 F600\nM2\n"
    warnings: list[Diagnostic] = []
    pauses_of(tmp_path, text, box=box, warnings=warnings)
    found = [(each.line, each.code) for each in warnings if each.code == "speed-above-board"]
    assert found == expected
