"""Check before any motion whether a Klipper board can play a program.

Four things limit the density of a program: the wire, the entries of the move queue, the time that
the microcontroller needs for steps and messages, and its pulse. Steps come first, and messages get
the time that is left. Steps are encoded piece by piece as in the run.

      entries of the last LEAST_AHEAD_S      must fit into the queue
      bytes that wait for wire or processor  must leave within SLACK_S
      steps that wait for the processor      must be made within LATE_S
      time between two steps of an axis      at least two pulses: high and low

The first one keeps at least LEAST_AHEAD_S of motion on the board.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.firmware import FIRMWARES, Firmware
from cnc.boards.klipper.guards import REST_S
from cnc.boards.klipper.kernels.step_runs import Runs
from cnc.boards.klipper.layout import section
from cnc.boards.klipper.protocol import Dictionary
from cnc.boards.klipper.sender import PIECE_S, SPARE_SLOTS, StepEncoder
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, MotionLimitError, UsageError
from cnc.model.streams import PulseChunk

# Facts about a microcontroller that decide which programs it can play.

USB_BYTES_PER_S = 400_000.0
"""Bytes per second that a full-speed USB device takes for certain."""
CAREFUL_STEP_S = 10e-6
"""Time of a step on a microcontroller that is not known."""


@dataclass(frozen=True, slots=True)
class Profile:
    """A microcontroller.

    Attributes:
        frequency: Ticks of its clock per second.
        slots: Entries of its move queue.
        bytes_per_s: Bytes per second on the wire.
        step_s: Time that a step takes, s.
        pulse_s: Time for which a step pin stays high, and low after that, s.
        messages_per_s: Bytes per second that the processor can take when it makes as many steps
            as it can, and when it makes none.
    """

    frequency: float
    slots: int
    bytes_per_s: float
    step_s: float
    pulse_s: float = 0.0
    messages_per_s: tuple[float, float] = (math.inf, math.inf)


def firmware_of(machine: Machine) -> Firmware:
    """Return the microcontroller of the machine file.

    Raises:
        UsageError: ``klipper-mcu``, if it is not known.
    """
    name = machine.board.klipper.mcu if machine.board.klipper is not None else "rp2040"
    if name not in FIRMWARES:
        hint = f"board.klipper.mcu is one of {', '.join(FIRMWARES)}"
        message = f"there is no model of the microcontroller {name!r}"
        raise UsageError(Diagnostic("klipper-mcu", message, hint=hint))
    return FIRMWARES[name]


def profile_of(machine: Machine, dictionary: Dictionary | None = None, slots: int = 0) -> Profile:
    """Return the profile of a board, else of the microcontroller of the machine file."""
    pulse_s = machine.board.step_pulse
    if dictionary is None:
        known = firmware_of(machine)
        wire = known.baud / 10 if known.baud else USB_BYTES_PER_S
        step_s, messages = _step_s(machine, known), _messages_per_s(machine, known)
        return Profile(known.frequency, known.slots, wire, step_s, pulse_s, messages)
    frequency = dictionary.constant("CLOCK_FREQ")
    baud = dictionary.constant("SERIAL_BAUD", 0.0)
    wire = baud / 10 if baud else USB_BYTES_PER_S
    mcu = dictionary.constants.get("MCU")
    like = next((each for each in FIRMWARES.values() if each.mcu == mcu), None)
    if like is None:
        return Profile(frequency, slots, wire, CAREFUL_STEP_S, pulse_s)
    step_s, messages = _step_s(machine, like), _messages_per_s(machine, like)
    return Profile(frequency, slots, wire, step_s, pulse_s, messages)


def _samples(machine: Machine, firmware: Firmware) -> float:
    """Return the samples of the switches and of the e-stop in a tick."""
    known, inputs = machine.board.klipper, 0
    if known is not None:
        axes = [known.axis(letter) for letter in machine.axes]
        inputs = sum(len(axis.endstop or ()) for axis in axes if axis is not None)
        inputs += known.emergency_stop is not None
    return inputs / (REST_S * firmware.frequency)


def _step_s(machine: Machine, firmware: Firmware) -> float:
    """Return the time that a step takes with the pulse of the machine, s.

    The samples take a share of the processor's time.
    """
    pulse = round(machine.board.step_pulse * firmware.frequency)
    event = firmware.event_time(pulse, _samples(machine, firmware))
    return firmware.events(pulse) * event / firmware.frequency


def _messages_per_s(machine: Machine, firmware: Firmware) -> tuple[float, float]:
    """Return the bytes per second that the processor can take with all steps, and with none."""
    if not firmware.byte_ticks:
        return math.inf, math.inf
    samples, bytes_per_s = _samples(machine, firmware), firmware.frequency / firmware.byte_ticks
    least, most = (firmware.message_share(steps, samples) for steps in (1.0, 0.0))
    return least * bytes_per_s, most * bytes_per_s


LEAST_AHEAD_S = 0.06
"""Motion that must be on the board at any time."""
SLACK_S = 0.08
"""Longest delay of bytes, less than the horizon of the sender."""
LATE_S = 40e-6
"""Longest delay of a step by steps that were due before it; those due together come on top."""
COMMAND_BYTES = 9
"""Bytes of an entry: number, object, interval, count, add."""
TURN_BYTES = 3
"""Bytes of a change of direction."""
OVERHEAD = 1.1
"""Head and tail of blocks, and questions."""
ROUNDING_NS = 1
"""Deviation of the time between two steps by rounding."""
OUTPUT_SLOTS = 16
"""Entries that outputs may use."""


class KlipperFeasibility:
    """Check of a program for a board.

    Args:
        machine: The machine.
        profile: The board.

    Attributes:
        most_entries: Most entries within LEAST_AHEAD_S so far.
        most_waiting_s: Longest delay of bytes so far, s.
        most_late_s: Longest delay of a step so far, s.
        entries: Number of entries so far.
    """

    def __init__(self, machine: Machine, profile: Profile) -> None:
        known = machine.board.klipper
        tolerance_us = 5.0 if known is None else known.tolerance_us
        least = int(profile.frequency / machine.board.max_step_rate)
        self._profile = profile
        self._motors = []
        for letter in machine.axes:
            axis = None if known is None else section(machine).axis(letter)
            self._motors.append(1 if axis is None else len(axis.step))
        self._encoders = [
            StepEncoder(int(tolerance_us * 1e-6 * profile.frequency), -1000, least)
            for _ in machine.axes
        ]
        self._room = max(profile.slots - SPARE_SLOTS - min(OUTPUT_SLOTS, profile.slots // 8), 1)
        self._recent: deque[int] = deque()
        self._waiting = 0.0
        self._filled_at = 0.0
        self._free_at = 0.0
        self._stepped_ns = np.full(len(machine.axes), -(2**62), np.int64)
        self.most_entries = self.entries = 0
        self.most_waiting_s = self.most_late_s = 0.0

    def add(self, chunk: PulseChunk) -> None:
        """Add the next grid moves.

        Raises:
            MotionLimitError: ``board-step-rate``, ``board-too-dense``.
        """
        time_ns = chunk.time_ns
        if not len(time_ns):
            return
        self._check_pulses(chunk)
        self._count_steps(chunk)
        piece = round(PIECE_S * 1e9)
        cuts = np.searchsorted(
            time_ns, np.arange(int(time_ns[0]) + piece, int(time_ns[-1]) + 1, piece)
        )
        for rows in np.split(np.arange(len(time_ns)), cuts):
            if len(rows):
                self._add_piece(chunk, slice(int(rows[0]), int(rows[-1]) + 1))

    def _add_piece(self, chunk: PulseChunk, rows: slice) -> None:
        ticks = np.rint(chunk.time_ns[rows] * (1e-9 * self._profile.frequency)).astype(np.int64)
        step, line = chunk.step[rows], int(chunk.line[rows][0])
        ends: list[NDArray[np.int64]] = []
        size = 0.0
        for column, encoder in enumerate(self._encoders):
            moved = np.flatnonzero(step[:, column])
            if not len(moved):
                continue
            due = ticks[moved]
            if int(due[0]) - encoder.last >= 2**28:
                encoder.last = int(due[0]) - 1000
            runs = encoder.encode(due, step[moved, column])
            ends += [runs.end] * self._motors[column]
            size += self._motors[column] * _bytes(runs)
        self._queue(np.sort(np.concatenate(ends)), line)
        steps = sum(np.count_nonzero(step, axis=0) * self._motors)
        self._transfer(size, float(steps), int(chunk.time_ns[rows][-1]) * 1e-9, line)

    def _check_pulses(self, chunk: PulseChunk) -> None:
        """Check that the pulses of each axis have ended before its next step."""
        least = round(2e9 * self._profile.pulse_s) - ROUNDING_NS
        for column, last in enumerate(self._stepped_ns.tolist()):
            rows = np.flatnonzero(chunk.step[:, column])
            if not len(rows):
                continue
            gaps = np.diff(chunk.time_ns[rows], prepend=last)
            self._stepped_ns[column] = chunk.time_ns[rows[-1]]
            if gaps.min() < least:
                line = int(chunk.line[rows[int(np.argmax(gaps < least))]])
                pulse = self._profile.pulse_s * 1e6
                message = (
                    f"two steps of an axis are {gaps.min() * 1e-3:g} us apart here, but a pulse "
                    f"of {pulse:g} us and the pause after it take {2 * pulse:g} us"
                )
                hint = "lower board.step_pulse, the feed or max_velocity, or use fewer microsteps"
                raise MotionLimitError(Diagnostic("board-step-rate", message, line=line, hint=hint))

    def _count_steps(self, chunk: PulseChunk) -> None:
        """Delay of each grid move, when the processor makes one step after the other."""
        cost = np.zeros(len(chunk.time_ns))
        for column, motors in enumerate(self._motors):
            cost += motors * self._profile.step_s * (chunk.step[:, column] != 0)
        due = chunk.time_ns * 1e-9
        # done_k = max(due_k, done_(k-1)) + cost_k, for all moves at once.
        total = np.cumsum(cost)
        begin = np.maximum(np.maximum.accumulate(due - (total - cost)), self._free_at)
        late = begin + (total - cost) - due
        self._free_at = float(begin[-1] + total[-1])
        worst = float(late.max())
        self.most_late_s = max(self.most_late_s, worst)
        limit = LATE_S + sum(self._motors) * self._profile.step_s
        if worst > limit:
            line = int(chunk.line[int(np.argmax(late > limit))])
            rate = 1.0 / self._profile.step_s
            message = f"the steps here are faster than the {rate:.0f} per second of the board"
            hint = "lower the feed or max_velocity, or use fewer microsteps"
            raise MotionLimitError(Diagnostic("board-step-rate", message, line=line, hint=hint))

    def _queue(self, ends: NDArray[np.int64], line: int) -> None:
        """Count the entries that end within LEAST_AHEAD_S."""
        span = round(LEAST_AHEAD_S * self._profile.frequency)
        self.entries += len(ends)
        for end in ends.tolist():
            self._recent.append(end)
            while self._recent[0] < end - span:
                self._recent.popleft()
            self.most_entries = max(self.most_entries, len(self._recent))
        if self.most_entries > self._room:
            message = (
                f"the steps of this line are too dense for the queue of the board, which has "
                f"{self._profile.slots} entries"
            )
            hint = "lower the feed, raise board.klipper.tolerance_us, or use fewer microsteps"
            raise MotionLimitError(Diagnostic("board-too-dense", message, line=line, hint=hint))

    def _transfer(self, size: float, steps: float, until_s: float, line: int) -> None:
        """Count the bytes that wait for the wire, or for the time that steps leave."""
        rate, (least, most) = self._profile.bytes_per_s, self._profile.messages_per_s
        if math.isfinite(most):
            busy = min(steps * self._profile.step_s / max(until_s - self._filled_at, PIECE_S), 1.0)
            rate = min(rate, busy * least + (1.0 - busy) * most)
        self._waiting = max(0.0, self._waiting - (until_s - self._filled_at) * rate) + size
        self._filled_at = until_s
        self.most_waiting_s = max(self.most_waiting_s, self._waiting / rate - PIECE_S)
        if self.most_waiting_s > SLACK_S:
            message = (
                "the steps of this line are too dense for the serial line and the processor of "
                f"the board, which take about {rate:.0f} bytes/s"
            )
            hint = "lower the feed, raise board.klipper.tolerance_us, or use fewer microsteps"
            raise MotionLimitError(Diagnostic("board-too-dense", message, line=line, hint=hint))


def _bytes(runs: Runs) -> float:
    """Return the bytes of runs on the wire."""
    turns = int(np.count_nonzero(np.diff(runs.sign)))
    return OVERHEAD * (COMMAND_BYTES * len(runs.length) + TURN_BYTES * turns)
