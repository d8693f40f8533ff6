"""The GRBL driver with damaged messages and silent boards: each run ends well or in a fault."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from cnc.boards.grbl.fault_monitor import STUCK, LivenessMonitor
from cnc.boards.grbl.messages import Kind, SentLine, Status
from cnc.boards.grbl.protocol import State
from cnc.model.blocks import Dwell
from cnc.model.diagnostics import BoardError
from cnc.simulators.grbl.firmware_profile import GRBL, GRBLHAL, FirmwareProfile
from cnc.simulators.grbl.grbl_simulator import Alarm, Drop, Error, Freeze, GrblSimulator, Unplug
from tests.support.boards.grbl_rig import LATEST, ROUTER
from tests.support.boards.grbl_wire import (
    PROGRAM,
    assert_at_rest,
    fault,
    life,
    started,
)
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed
from tests.support.boards.simulator_bench import material_below
from tests.support.soak import share

END = (4.5, 3.25, 0.0)


@pytest.mark.parametrize("wrong", ["drop", "flip", "double", "noise"])
def test_any_damage_to_messages_ends_in_success_or_a_fault(
    wrong: str,
) -> None:
    for seed in range(share(60, 3)):
        rng = random.Random(f"{wrong} {seed}")
        simulator = GrblSimulator()
        board, wire = started(simulator)
        begins = simulator.now + rng.uniform(0.0, 20.0)
        left = rng.randint(1, 12)

        def garble(
            data: bytes,
            rng: random.Random = rng,
            begins: float = begins,
            simulator: GrblSimulator = simulator,
        ) -> bytes:
            nonlocal left
            if not data or not left or simulator.now < begins:
                return data
            left -= 1
            at = rng.randrange(len(data))
            middle = {
                "drop": b"",
                "flip": bytes([data[at] ^ 4]),
                "double": data[at : at + 1] * 2,
                "noise": rng.randbytes(9),
            }[wrong]
            return data[:at] + middle + data[at + 1 :]

        wire.heard = garble
        error = fault(board, *PROGRAM)
        if error is None:
            assert simulator.position == pytest.approx(END, abs=0.01), seed
        else:
            assert error.exit_code == 3
            assert simulator.now - begins < 25.0
            assert assert_at_rest(simulator), seed


class Damage:
    """Damages the first line with the text ``text``."""

    def __init__(
        self, wrong: str, text: bytes, rng: random.Random, simulator: GrblSimulator
    ) -> None:
        self.wrong, self.text, self.rng, self.simulator = wrong, text, rng, simulator
        self.struck = 0.0

    def said(self, data: bytes) -> bytes:
        if data != self.text or self.struck:
            return data
        self.struck = self.simulator.now
        at, count = self.rng.randrange(len(data)), self.rng.randint(1, 8)
        if self.wrong == "drop":
            return data[:at] + data[at + count :]
        if self.wrong == "double":
            return data[: at + count] + data[at:]
        # a blank would become the "!" of a hold, which nobody can tell from a button of the
        # machine's
        bit = 0 if data[at] == ord(" ") else self.rng.choice((1, 2, 4, 8))
        return data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :]


@pytest.mark.parametrize("wrong", ["drop", "flip", "double"])
def test_a_damaged_line_is_reported_in_time_with_its_number(wrong: str) -> None:
    """Bytes of a line are lost, changed or doubled; moves of a new board take seconds."""
    for seed in range(share(40, 3)):
        rng = random.Random(f"{wrong} {seed}")
        simulator = GrblSimulator((GRBL, GRBLHAL)[seed % 2], settings=(None, ROUTER)[seed // 2 % 2])
        board, wire = started(simulator)
        places = [f"X{rng.uniform(0, 9):.3f} Y{rng.uniform(0, 9):.3f}" for _ in range(30)]
        lines = [
            PREAMBLE,
            *(f"G1 {place} F1500" if k % 3 == 0 else place for k, place in enumerate(places)),
        ]
        victim = rng.randint(3, 28)
        damage = Damage(wrong, lines[victim].encode() + b"\n", rng, simulator)
        wire.said = damage.said
        error = fault(board, *lines)
        if error is None:
            assert simulator.position == pytest.approx(
                (*(float(word[1:]) for word in places[-1].split()), 0.0), abs=0.01
            ), seed
            continue
        assert simulator.now - damage.struck <= LATEST, (seed, error)
        # where it leaves its way is told by five reports a second
        assert -4 <= error.diagnostic.line - (victim + 1) <= 2, (seed, error)
        assert assert_at_rest(simulator), seed


@pytest.mark.parametrize("make", [Unplug, Freeze])
@pytest.mark.parametrize("profile", [GRBL, GRBLHAL])
def test_a_board_lost_at_any_time_is_reported(
    make: Callable[[], Unplug | Freeze], profile: FirmwareProfile
) -> None:
    """During welcome, settings, offset writes, a dwell, a probe, a pause, a hold."""
    lines = [
        PREAMBLE,
        "G10 L2 P2 X1",
        "G1 X3 F400",
        "G4 P3",
        "G10 L2 P3 X2",
        "G38.3 Z-3 F100",
        "G0 Z0",
        "M3 S100",
        "M0",
        "G1 X0",
        "M5",
    ]
    for seed in range(share(60, 4)):
        rng = random.Random(seed)
        simulator = GrblSimulator(profile, environment=material_below(-2.0))
        struck = rng.uniform(0.0, 32.0)
        simulator.inject(make(), time=struck)
        error = life(simulator, lines)
        if error is None:
            assert simulator.now < struck
            continue
        assert error.diagnostic.code in (
            ("port-lost",) if make is Unplug else ("board-silent", "no-answer")
        ), seed
        # a board that has not greeted yet may take its time
        assert simulator.now - struck <= (
            1.0 if make is Unplug else 12.0 if struck < 3.0 else LATEST
        ), seed


def test_a_failed_protocol_never_waits() -> None:
    simulator = GrblSimulator()
    board, _ = started(simulator)
    feed(board, *PROGRAM[:3])
    board.link.protocol.state = State.FAILED
    assert fault(board, *PROGRAM[3:]) is not None
    assert assert_at_rest(simulator)


def test_an_alarm_without_a_message_is_found_in_the_reports() -> None:
    simulator = GrblSimulator()
    board, wire = started(simulator)
    feed(board, PREAMBLE, "G1 X5 F300")
    wire.heard = lambda data: data.replace(b"ALARM", b"ALRM")
    simulator.inject(Alarm(4), time=simulator.now + 0.5)
    struck = simulator.now
    with pytest.raises(BoardError) as caught:
        board.finish()
    assert caught.value.diagnostic.code == "board-alarm"
    assert simulator.now - struck <= LATEST


def test_an_alarm_during_a_stop_is_reported() -> None:
    simulator = GrblSimulator()
    board, _ = started(simulator)
    feed(board, PREAMBLE, "G1 X9 F400")
    board.stream.serve(0.5)
    simulator.inject(Alarm(1), time=simulator.now + 0.01)
    with pytest.raises(BoardError) as caught:
        board.stop()
    assert caught.value.diagnostic.code == "board-alarm"
    assert "ALARM:1" in caught.value.diagnostic.message
    assert assert_at_rest(simulator)


def test_an_alarm_after_an_error_is_reported_too() -> None:
    simulator = GrblSimulator()
    board, _ = started(simulator)
    feed(board, PREAMBLE, "G1 X9 F400", "G1 X8")
    simulator.inject(Error(20))
    real = board.link._rest

    def rest(patience: float) -> None:
        simulator.inject(Alarm(1))
        real(patience)

    board.link._rest = rest  # type: ignore[method-assign]
    error = fault(board, "G1 X7")
    assert error is not None
    assert error.diagnostic.code == "board-error"
    assert "error:20" in error.diagnostic.message
    assert "then: the board stopped with ALARM:1" in error.diagnostic.message


def test_a_frozen_board_during_a_stop_is_reported() -> None:
    simulator = GrblSimulator()
    board, _ = started(simulator)
    feed(board, PREAMBLE, "G1 X9 F400")
    board.stream.serve(0.5)
    simulator.inject(Freeze())
    asked = simulator.now
    with pytest.raises(BoardError) as caught:
        board.stop()
    assert caught.value.diagnostic.code == "board-silent"
    assert "emergency stop" in caught.value.diagnostic.hint
    assert simulator.now - asked < 10.0


def test_a_second_stop_request_stops_again() -> None:
    """Ctrl-C twice: the second may come during the first stop."""
    simulator = GrblSimulator()
    board, _ = started(simulator)
    feed(board, PREAMBLE, "G1 X9 F400", "G1 X0")
    board.stream.serve(0.5)
    real = board.link._rest
    impatient = [KeyboardInterrupt()]

    def rest(patience: float) -> None:
        if impatient:
            raise impatient.pop()
        real(patience)

    board.link._rest = rest  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        board.stop()
    board.abort()
    assert simulator.core.state == "Idle"
    assert assert_at_rest(simulator)


@pytest.mark.parametrize("inches", [0, 1])
@pytest.mark.parametrize("mask", share([0, 1, 2, 3, 255], [0, 3]))
@pytest.mark.parametrize("profile", [GRBL, GRBLHAL])
def test_reports_of_every_kind_are_tracked(
    profile: FirmwareProfile, mask: int, inches: int
) -> None:
    """``$10``: machine or work positions, with and without the buffer; ``$13``: inches."""
    simulator = GrblSimulator(profile, settings={10: mask, 13: inches})
    simulator.core.eeprom.systems["G54"] = (-3.0, 2.0, 1.0)
    board, _ = started(simulator)
    assert fault(board, *PROGRAM) is None
    assert board.position == pytest.approx(simulator.position, abs=0.003)
    assert board.work_offset == pytest.approx((-3.0, 2.0, 1.0), abs=0.003)
    board.start(ORIGIN)
    feed(board, PREAMBLE)
    board.execute(Dwell("p.nc", 1, 0.0), 0)
    # "G1 X8.5 F400": without its point it would go to 85
    simulator.inject(Drop(1), byte=simulator.core.receiver.received + len("G1 X8") + 1)
    simulator.inject(Drop(1), byte=simulator.core.receiver.received + len("?G1 X8") + 1)
    error = fault(board, "G1 X8.5 Y1 F400")
    assert error is not None
    assert error.diagnostic.code == "off-path"
    assert assert_at_rest(simulator)


def test_a_board_in_state_run_without_motion_is_stuck() -> None:
    liveness = LivenessMonitor()
    liveness.begin(0.0)
    for k in range(int(STUCK) + 3):
        liveness.reported(Status("Run", position=(1.0, 0.0, 0.0)), float(k))
    found = liveness.fault(None, 7, STUCK + 3.0)
    assert found is not None
    assert (found.diagnostic.code, found.diagnostic.line) == ("board-stuck", 7)


def test_dwells_and_spindle_starts_get_more_time() -> None:
    cases: tuple[tuple[Kind, float, float], ...] = (
        ("plain", 0.0, 2.0),
        ("dwell", 9.0, 11.0),
        ("spindle", 0.0, 22.0),
    )
    for kind, seconds, patience in cases:
        liveness = LivenessMonitor()
        liveness.begin(0.0)
        sent = SentLine("", 3, kind, seconds)
        for k in range(100):
            now = 0.25 * k
            liveness.reported(Status("Idle"), now)
            assert (liveness.fault(sent, 0, now) is not None) == (now > patience), (kind, now)
