"""Configuration of a board that has one already: the real firmware has few ways to forget it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.firmware import FIRMWARES
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError
from cnc.simulators.klipper.klipper_simulator import BOOT_S, KlipperSimulator
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.boards.klipper_rig import connected, machine, pins, place
from tests.support.session.runs import run_with


def simulated(known: Machine, **changes: str) -> KlipperSimulator:
    """Return a board whose firmware differs."""
    simulator = simulator_for(known)
    simulator.firmware = replace(simulator.firmware, **changes)  # type: ignore[arg-type]
    return simulator


def swapped(known: Machine) -> Machine:
    """Return the machine with an axis whose direction is turned."""
    axis = pins(known).x
    assert axis is not None
    turned = axis.model_copy(update={"direction": (f"!{axis.direction[0].strip('!')}",)})
    klipper = pins(known).model_copy(update={"x": turned})
    return known.model_copy(update={"board": known.board.model_copy(update={"klipper": klipper})})


@pytest.mark.parametrize(
    ("mcu", "by", "resets"),
    [("atmega328p", "reset", 1), ("rp2040", "reset", 1), ("atmega328p", "config_reset", 0)],
)
def test_another_configuration_is_replaced(mcu: str, by: str, resets: int, tmp_path: Path) -> None:
    known = machine(mcu)
    simulator = simulated(known, forgets_by=by)
    connected(known, simulator).close()
    assert (simulator.finalized, simulator.resets) == (True, 0)
    number = simulator.crc
    driver = connected(swapped(known), simulator)
    assert (simulator.finalized, simulator.resets) == (True, resets)
    assert simulator.crc != number
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X1 Y1 F300\nM2\n")
    assert run_with(tmp_path / "p.ngc", swapped(known), board=driver).ok
    driver.close()
    assert place(swapped(known), simulator) == [400, 400, 0]


def test_board_that_cannot_forget_its_configuration() -> None:
    known = machine()
    simulator = simulated(known, forgets_by="")
    connected(known, simulator).close()
    with pytest.raises(BoardError) as caught:
        connected(swapped(known), simulator)
    assert caught.value.diagnostic.code == "klipper-configuration"
    assert "switch it off and on" in caught.value.diagnostic.hint


def test_board_that_does_not_come_back_after_its_reset() -> None:
    known = machine()
    simulator = simulator_for(known)
    connected(known, simulator).close()
    reset = simulator.reset

    def last() -> None:
        reset()
        simulator.boots_until = float("inf")

    simulator.reset = last  # type: ignore[method-assign]
    with pytest.raises(BoardError) as caught:
        connected(swapped(known), simulator)
    assert caught.value.diagnostic.code == "port-lost"
    assert BOOT_S < simulator.now < 20.0


@pytest.mark.parametrize("mcu", ["atmega328p", "rp2040"])
@pytest.mark.parametrize("shares", [0.0, 0.3, 0.9])
def test_configuration_that_ended_half_way(mcu: str, shares: float) -> None:
    """A program was killed while it configured the board, which cannot take it from the start."""
    known = machine(mcu)
    simulator = simulator_for(known)
    port = KlipperSimulatorPort(simulator)
    connection = Connection(port, port, "the simulator")
    connection.open()
    driver_layout = Klipper(
        KlipperSimulatorPort(other := simulator_for(known)),
        known,
        clock=KlipperSimulatorPort(other),
    )._supervisor.layout
    connection.send("allocate_oids", count=driver_layout.objects)
    for command in driver_layout.config[: round(shares * len(driver_layout.config))]:
        connection.link.send(command)
    connection.flush(connection.pump)
    again = connected(known, simulator)
    assert simulator.finalized
    assert len(again._supervisor.read_positions()) == 3


@pytest.mark.parametrize("mcu", ["atmega328p", "rp2040"])
def test_refused_pin_can_be_corrected(mcu: str) -> None:
    """The board shuts down with a part of the configuration; the next one must not meet it."""
    known = machine(mcu)
    simulator = simulator_for(known)
    flood = simulator.pin(str(pins(known).flood))
    commands = simulator._commands
    takes = commands._output_pin

    def refusing(pin: int) -> int:
        return takes(-1 if pin == flood else pin)

    commands._output_pin = refusing  # type: ignore[method-assign]
    with pytest.raises(BoardError) as caught:
        connected(known, simulator)
    assert caught.value.diagnostic.code == "klipper-configuration"
    assert "Not an output pin" in caught.value.diagnostic.message
    klipper = pins(known).model_copy(update={"flood": None})
    corrected = known.model_copy(
        update={"board": known.board.model_copy(update={"klipper": klipper})}
    )
    connected(corrected, simulator).close()
    assert simulator.finalized


def test_restart_in_place_of_a_reset_of_the_configuration() -> None:
    """The firmware of some computers starts itself anew by config_reset, and its port is lost."""
    known = machine()
    simulator = simulated(known, forgets_by="config_reset")
    simulator._commands._config_reset = lambda message: simulator.reset()  # type: ignore[method-assign]
    connected(known, simulator).close()
    connected(swapped(known), simulator).close()
    assert (simulator.finalized, simulator.resets) == (True, 1)


def test_profiles_have_the_commands_of_real_firmware() -> None:
    for firmware in FIRMWARES.values():
        names = firmware.dictionary.command_names
        assert "reset" in names
        assert "config_reset" not in names
        other = replace(firmware, forgets_by="config_reset").dictionary.command_names
        assert "config_reset" in other
        assert "reset" not in other


@pytest.mark.parametrize(
    ("lost", "by", "resets"),
    [
        ("all", "reset", 1),
        ("all", "config_reset", 0),
        ("trigger", "reset", 1),
        ("motor", "reset", 1),
        ("input", "reset", 1),
    ],
)
def test_board_that_lost_its_objects_is_configured_anew(
    lost: str, by: str, resets: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Damaged memory: its checksum is the same, but each command shuts the board down."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    known = machine("atmega328p")
    simulator = simulated(known, forgets_by=by)
    driver = connected(known, simulator, identity="the bench")
    layout = driver._supervisor.layout
    driver.prepare_next_start(watched=[True] * 3, known=[True] * 3)
    driver.start(np.zeros(3, np.int64))
    driver.finish()
    assert driver.known_steps == (0, 0, 0)
    driver.close()
    oids = {"trigger": layout.trigger, "motor": layout.motors[1].oid, "input": layout.inputs[2].oid}
    if lost == "all":
        simulator.objects.clear()
    else:
        del simulator.objects[oids[lost]]
    again = connected(known, simulator, identity="the bench")
    assert (simulator.finalized, simulator.resets, simulator.reason) == (True, resets, "")
    assert again.known_steps == (None, None, None)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X1 Y1 F300\nM2\n")
    assert run_with(tmp_path / "p.ngc", known, board=again).ok
    again.close()
    assert place(known, simulator) == [400, 400, 0]


def test_board_that_lost_an_output_is_configured_anew() -> None:
    """Only the command to the output shows it: the board has shut down by its own reason."""
    known = machine("atmega328p")
    simulator = simulator_for(known)
    connected(known, simulator).close()
    simulator.shut_down("Invalid oid type")
    connected(known, simulator).close()
    assert (simulator.finalized, simulator.resets, simulator.reason) == (True, 1, "")
    simulator.shut_down("Command request")
    connected(known, simulator).close()
    assert (simulator.finalized, simulator.resets, simulator.reason) == (True, 1, "")


@pytest.mark.parametrize(("seconds", "connects"), [(1.5, True), (5.0, False)])
def test_parts_of_the_dictionary_that_arrive_late(seconds: float, connects: bool) -> None:
    """On a bad cable the long answers are damaged, while acknowledgements pass."""
    known = machine()
    simulator = simulator_for(known)
    up, parts = simulator.cable.up, []

    def damaged(data: bytes, now: float) -> None:
        if len(data) > 40:
            parts.append(now)
            if parts[10:] and now < parts[10] + seconds:
                return
        up(data, now)

    simulator.cable.up = damaged  # type: ignore[method-assign]
    if connects:
        connected(known, simulator).close()
        return
    with pytest.raises(BoardError) as caught:
        connected(known, simulator)
    assert caught.value.diagnostic.code == "board-silent"
    assert "cable" in caught.value.diagnostic.hint
