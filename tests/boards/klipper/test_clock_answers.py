"""Answers to questions for the clock that are read late, and entries that are freed late."""

from __future__ import annotations

import pytest

from cnc.boards.klipper.connection import CLOCK_PERIOD_S, MAX_DRIFT, Connection
from cnc.boards.klipper.sender import Slots
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.boards.klipper_rig import machine


def connected(mcu: str) -> tuple[Connection, KlipperSimulator]:
    simulator = simulator_for(machine(mcu))
    port = KlipperSimulatorPort(simulator)
    connection = Connection(port, port, "the simulator")
    connection.open()
    return connection, simulator


def error_s(connection: Connection, simulator: KlipperSimulator) -> float:
    clock = connection.board_clock
    return (clock.at(simulator.now) - simulator.clock) / clock.frequency


def test_answer_read_after_a_standstill_counts_as_uncertain() -> None:
    """This computer stands still before it reads an answer: that was given long ago."""
    connection, simulator = connected("rp2040")
    connection.wait(1.5, connection.pump)
    for _ in range(4):
        while connection._asked_clock is None:
            connection.pump(0.0)
            simulator.advance(simulator.now + 1e-4)
        simulator.advance(simulator.now + 2 * CLOCK_PERIOD_S)
        connection.pump(0.002)
        connection.wait(0.02, connection.pump)
        assert abs(error_s(connection, simulator)) < 1e-3
    assert connection.board_clock.wrong == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_bad_cable_does_not_spoil_the_clock(seed: int) -> None:
    """Lost questions, lost answers, and answers to questions that were sent again."""
    connection, simulator = connected("atmega328p")
    simulator.cable._random.seed(seed)
    simulator.cable.noise.damaged = simulator.cable.noise.dropped = 0.01
    for _ in range(40):
        connection.wait(0.25, connection.pump)
        # A step must be known to the board LATE_S before its time, which is 10 ms.
        assert abs(error_s(connection, simulator)) < 3e-3
    assert connection.board_clock.wrong == 0.0
    assert abs(connection.board_clock.drift) < MAX_DRIFT


def test_entry_counts_until_it_is_free_for_certain() -> None:
    slots = Slots(4)
    slots.slack = 16_000
    slots.add(100_000)
    assert slots.used(115_999) == 1
    assert slots.used(116_000) == 0
