"""The report on a Klipper board: a machine file that loads, and that no board takes as it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.boards.discovery import FoundBoard, port_report
from cnc.boards.klipper.connection import Connection, read_info
from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.firmware import FIRMWARES
from cnc.machine.load import load_machine
from cnc.model.diagnostics import MachineFileError
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.boards.klipper_rig import MCUS, connected, machine


@pytest.mark.parametrize("mcu", MCUS)
def test_report_is_a_machine_file(mcu: str, tmp_path: Path) -> None:
    simulator = KlipperSimulator(FIRMWARES[mcu])
    port = KlipperSimulatorPort(simulator)
    info = read_info(Connection(port, port, "the port"), 1.0)
    found = FoundBoard("/dev/ttyACM0", "a board", klipper=info, baud=250_000)
    text = "\n".join(port_report(found))
    # The firmware makes its queue of the memory that its configuration leaves.
    assert info.slots == 0
    assert "move queue: size known after configuration" in text
    (tmp_path / "mill.toml").write_text(text)
    known = load_machine(tmp_path / "mill.toml")
    assert known.board.kind == "klipper"
    assert known.board.port == "/dev/ttyACM0"
    assert known.board.klipper is not None
    assert known.board.klipper.mcu == mcu
    assert tuple(known.axes) == ("x", "y", "z")
    with pytest.raises(MachineFileError) as caught:
        Klipper(port, known, "the port", clock=port)
    assert "has no pin STEP_X" in caught.value.diagnostic.message
    assert caught.value.diagnostic.line
    assert not simulator.motors


def test_report_on_a_configured_board_has_the_size_of_its_queue() -> None:
    known = machine("atmega328p")
    simulator = simulator_for(known)
    connected(known, simulator).close()
    port = KlipperSimulatorPort(simulator)
    info = read_info(Connection(port, port, "the port"), 1.0)
    text = "\n".join(port_report(FoundBoard("/dev/ttyUSB0", "a board", klipper=info, baud=250_000)))
    assert f"move queue: {FIRMWARES['atmega328p'].slots} entries" in text
