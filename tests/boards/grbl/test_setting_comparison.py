"""Warnings before a run where the settings of the board differ from the machine file."""

from pathlib import Path

import pytest

from cnc.api import run
from cnc.boards.grbl.driver import GrblBoard
from cnc.machine.load import load_machine
from cnc.session.program_reader import InlineProgram
from cnc.simulators.grbl.firmware_profile import settings_of
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import NAME, GrblSimulatorPort

MILL = load_machine(Path("config/grbl-uno.toml"))


def warnings(changed: dict[int, float]) -> list[str]:
    simulator = GrblSimulator(settings=settings_of(MILL) | changed)
    port = GrblSimulatorPort(simulator)
    board = GrblBoard(port, MILL, port.clock, NAME)
    board.connect()
    report = run(InlineProgram("test.nc", b"G21 G90 G0 X1\nM2\n"), MILL, board=board)
    assert report.ok
    return [w.message for w in report.warnings if w.code == "board-differs"]


def test_a_board_like_the_machine_file_is_not_mentioned():
    assert warnings({}) == []


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({110: 500.0}, "moves take longer than checked"),
        ({121: 10.0}, "moves take longer than checked"),
        ({112: 5000.0}, "moves are faster than the file allows"),
        ({102: 400.0}, "other steps/mm"),
    ],
)
def test_a_difference_is_said_with_both_numbers(changed, said):
    ((number, value),) = changed.items()
    (message,) = warnings(changed)
    assert said in message
    assert f"${number} " in message and f" {value:g} (file " in message
    assert f"(file {settings_of(MILL)[number]:.10g}" in message


def test_slower_and_faster_axes_are_told_apart():
    (message,) = warnings({110: 500.0, 120: 50.0, 111: 9000.0})
    slow, _, fast = message.partition("faster")
    assert "$110" in slow and "$120" in slow and "$111" not in slow
    assert "$111" in fast and "$110" not in fast


def test_the_travel_of_a_board_that_does_not_home_is_not_compared():
    assert warnings({130: 111.0}) == []
