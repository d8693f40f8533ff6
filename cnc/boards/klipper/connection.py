"""The connection to a Klipper board: exchange of blocks, questions, its clock, and its report."""

from __future__ import annotations

import json
import logging
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

from cnc.boards.klipper.firmware import FIRMWARES
from cnc.boards.klipper.layout import pin_ranges
from cnc.boards.klipper.protocol import (
    IDENTIFY_RESPONSE_ID,
    STANDSTILL_S,
    Dictionary,
    KlipperLink,
    LocalError,
    Message,
    ProtocolError,
    RemoteError,
    Value,
    WireError,
)
from cnc.boards.port import Clock, LoggedPort, Port
from cnc.boards.protocols import board_error
from cnc.model.diagnostics import BoardError

# The board's clock as seen by this computer.
#
# A question for the clock is answered at a time between sending and receiving. The shorter the
# round trip, the better the time is known. So the estimate is a line through the answers of the
# last seconds, each weighted by its round trip beyond the shortest one.
#
#       clock                         x   answers with a short round trip weigh most
#         │                    x x  /
#         │               x  / x
#         │          x / x
#         └──────────────────────────── time of this computer
#
# An answer lies between the times of its question and of its receipt. So two answers bound the
# rate, however long they took. A rate far beyond the nominal one is no drift: the firmware was
# built for another crystal than the board has. It shows in both halves of the time. A computer or a
# simulator that was held up shows in one half only, or catches up in the other.

WRAP = 2**32
SAMPLES = 120
"""Answers that the estimate uses."""
MAX_DRIFT = 0.1
"""Largest relative deviation of a clock that is followed: a resistor and a capacitor inside a
microcontroller keep this.
"""
USUAL_DRIFT = 0.01
"""A larger deviation is told: a crystal has 1e-4 at most, a ceramic resonator 0.005."""
JUMP_S = 0.25
"""Error of a time of this computer that makes no clock wrong during motion: virtual machines have
such jumps. A longer one ends the motion in any case.
"""
LEAST_SPAN_S = 2.0
"""Time between the first and the last answer from which the frequency is estimated."""


class BoardClock:
    """Estimate of a board's clock.

    Args:
        frequency: Nominal ticks per second.

    Attributes:
        frequency: Nominal ticks per second.
        rate: Estimated ticks per second of this computer.
        wrong: Rate of a clock that deviates by more than MAX_DRIFT for certain; 0 if none does.
        half_trip_s: Half of the shortest round trip.
    """

    def __init__(self, frequency: float) -> None:
        self.frequency = frequency
        self.rate = frequency
        self.wrong = 0.0
        self.half_trip_s = 0.0
        self._samples: deque[tuple[float, int, float]] = deque(maxlen=SAMPLES)
        self._time = 0.0
        self._clock = 0.0

    @property
    def known(self) -> bool:
        """Whether there is an answer."""
        return bool(self._samples)

    @property
    def drift(self) -> float:
        """Relative deviation of the board's frequency from its nominal one."""
        return self.rate / self.frequency - 1.0

    def set(self, clock: int, sent: float, received: float) -> None:
        """Start again from an answer with all 64 bits."""
        self._samples.clear()
        self.wrong = 0.0
        self._add(clock, sent, received)

    def restart(self) -> None:
        """Forget all answers but the last."""
        while len(self._samples) > 1:
            self._samples.popleft()
        self.wrong = 0.0

    def add(self, clock32: int, sent: float, received: float) -> None:
        """Add an answer to ``get_clock``: the lower 32 bits, and the times of the question, s."""
        self._add(self.extend(clock32, 0.5 * (sent + received)), sent, received)

    def extend(self, clock32: int, time: float) -> int:
        """Return the clock with these lower 32 bits that is next to the one at a time, s."""
        near = self.at(time)
        return near + (clock32 - near + WRAP // 2) % WRAP - WRAP // 2

    def at(self, time: float) -> int:
        """Return the clock at a time of this computer, s."""
        return round(self._clock + (time - self._time) * self.rate)

    def time_of(self, clock: int) -> float:
        """Return the time of a clock, s."""
        return self._time + (clock - self._clock) / self.rate

    def beyond(self, drift: float, jump: float = JUMP_S) -> float:
        """Return the rate of the board's clock if it deviates by more than ``drift`` for certain.

        Args:
            drift: relative.
            jump: error of a time that may have happened, s.

        Returns:
            Ticks per second; 0 if it may be nearer to the nominal rate, as far as is known.
        """
        first, last = self._samples[0], self._samples[-1]
        half = 0.5 * (first[0] + last[0])
        middle = min(self._samples, key=lambda sample: abs(sample[0] - half))
        signs = {self._sign(drift, jump, *pair) for pair in ((first, middle), (middle, last))}
        if len(signs) > 1 or 0 in signs:
            return 0.0
        return (last[1] - first[1]) / (last[0] - first[0])

    def _sign(
        self,
        drift: float,
        jump: float,
        first: tuple[float, int, float],
        last: tuple[float, int, float],
    ) -> int:
        """Return 1 if the clock was faster than ``drift`` for certain, -1 if it was slower."""
        passed = (last[1] - first[1]) / self.frequency
        time, margin = last[0] - first[0], 0.5 * (first[2] + last[2])
        if passed > (1.0 + drift) * (time + margin) + jump:
            return 1
        return -1 if passed < (1.0 - drift) * (time - margin) - jump else 0

    def _add(self, clock: int, sent: float, received: float) -> None:
        trip = max(received - sent, 1e-9)
        self._samples.append((0.5 * (sent + received), clock, trip))
        self.wrong = self.wrong or self.beyond(MAX_DRIFT)
        least = min(sample[2] for sample in self._samples)
        self.half_trip_s = 0.5 * least
        # The error of an answer is at most half of its round trip beyond the shortest.
        scale = 0.1 * least + 1e-6
        first, base = self._samples[0][0], self._samples[0][1]
        weights = [1.0 / (scale + sample[2] - least) ** 2 for sample in self._samples]
        total = sum(weights)
        times = [sample[0] - first for sample in self._samples]
        clocks = [float(sample[1] - base) for sample in self._samples]
        time = sum(w * t for w, t in zip(weights, times, strict=True)) / total
        ticks = sum(w * c for w, c in zip(weights, clocks, strict=True)) / total
        if times[-1] - times[0] >= LEAST_SPAN_S:
            spread = sum(w * (t - time) ** 2 for w, t in zip(weights, times, strict=True))
            product = sum(
                w * (t - time) * (c - ticks) for w, t, c in zip(weights, times, clocks, strict=True)
            )
            if spread > 0.0:
                rate = product / spread
                bound = MAX_DRIFT * self.frequency
                self.rate = min(max(rate, self.frequency - bound), self.frequency + bound)
        self._time, self._clock = first + time, base + ticks


log = logging.getLogger(__name__)

BAUD = 250_000
"""Speed of the firmware's serial lines unless the machine file has another one, bits/s."""
BITS_A_BYTE = 10
POLL_S = 0.002
"""Longest wait for bytes before blocks may have to be sent again."""
CHUNK = 40
"""Bytes of the dictionary in one answer."""
MOST_DICTIONARY = 1 << 20
"""Bytes after which a dictionary without end is refused."""
IDENTIFY_S = 3.0
"""Timeout of each part of the dictionary: the opening of the port may have reset the board, and a
long answer is seldom whole after a bad cable.
"""
ANSWER_S = 0.1
"""Time after which a question is asked again, because answers are not repeated."""
ANSWER_TIMEOUT_S = 1.0
"""Time without an answer after which the board counts as lost."""
CLOCK_PERIOD_S = 0.25
"""Time between two questions for the clock."""
FIRST_CLOCKS = 8
"""Questions for the clock when the connection is opened."""
FIRST_SPAN_S = 0.25
"""Time before each of the last two of them, so that a clock with a wrong rate is found before any
motion.
"""
LONGER_S, LONGER_JUMP_S = 2.2, 0.02
"""Time in which a clock is observed that may have a wrong rate, and the error of a time that counts
then. This computer, or a simulator, may have been held up. From this time the rate is known, too.
"""
RESET_S, RESTART_S = 0.05, 0.5
"""Time in which the command to reset reaches the board, and least time of a restart."""
RESTART_TIMEOUT_S = 10.0
"""Time after a reset in which the board must be back: a boot loader may come first."""

Pump = Callable[[float], object]
"""A function that sends and receives, and waits at most so many seconds for bytes."""
Reopen = Callable[[], Port]
"""A function that opens the port once more."""


class Connection:
    """A port, the protocol, and the board's clock.

    Args:
        port: The port.
        clock: Clock of this computer.
        name: Name of the port, for messages.
        reopen: Opens the port again after a reset: a USB device vanishes and comes back. None if
            the port outlives a reset.

    Attributes:
        port: The port.
        clock: Clock of this computer.
        name: Name of the port, for messages.
        link: State of the protocol.
        dictionary: The board's commands and responses.
        board_clock: Estimate of the board's clock.
        heard_at: Time of this computer at which the board was last heard, before a restart, s.
        on_samples: Called with each block of samples of a sensor, whoever pumps.
    """

    def __init__(self, port: Port, clock: Clock, name: str, reopen: Reopen | None = None) -> None:
        self.clock = clock
        self.name = name
        self._reopen = reopen
        self.on_samples: Callable[[Message], object] = lambda _: None
        self._begin(port)

    def _begin(self, port: Port) -> None:
        """Begin at a port, with a board of which nothing is known."""
        self.port = LoggedPort(port, self.name, log, text=False)
        self.link = KlipperLink()
        self.dictionary = Dictionary()
        self.board_clock = BoardClock(1.0)
        self._asked_clock: tuple[int, float] | None = None
        self._asked_at = self.heard_at = self.clock.now()

    def send(self, command: str, **values: Value) -> None:
        """Append a command."""
        try:
            self.link.send(self.dictionary.encode(command, **values))
        except LocalError as error:
            hint = "update the firmware of the board"
            raise board_error("klipper-command", str(error), hint=hint) from error

    def pump(self, seconds: float) -> list[Message]:
        """Send what waits and receive.

        Args:
            seconds: Longest wait for bytes.

        Returns:
            Messages received.

        Raises:
            PortLost: The connection is lost.
            BoardError: ``board-silent`` or ``klipper-message``.
        """
        now = self.clock.now()
        if self.board_clock.known and now - self._asked_at >= CLOCK_PERIOD_S:
            self._ask_clock()
        try:
            out = self.link.outgoing(now)
        except WireError as error:
            raise self.silent() from error
        if out:
            self.port.write(out)
        data = self.port.read(seconds)
        now = self.clock.now()
        received: list[Message] = []
        acknowledged = self.link.acknowledged
        for block in self.link.receive(data, now):
            try:
                messages = [
                    replace(message, acknowledged=block.acknowledged)
                    for message in self.dictionary.decode_responses(block.contents)
                ]
            except RemoteError as error:
                if self.board_clock.known:
                    raise self._foreign(str(error)) from error
                log.debug("%s: %s", self.name, error)
                continue
            received += messages
            for message in messages:
                if message.name == "clock":
                    self._take_clock(message["clock"], block.acknowledged, now)
                elif message.name == "sensor_bulk_data":
                    self.on_samples(message)
        # A board that restarts begins with another number, which may seem to acknowledge blocks.
        restarts = any(message.name == "starting" for message in received)
        if not restarts and (received or self.link.acknowledged > acknowledged):
            self.heard_at = now
        return received

    def _ask_clock(self) -> None:
        """Ask for the clock, unless the board has not taken the last such question yet."""
        if self._asked_clock is not None and self.link.acknowledged < self._asked_clock[0]:
            return
        self._asked_at = self.clock.now()
        self.send("get_clock")
        self._asked_clock = self.link.appended, self._asked_at

    def _take_clock(self, clock32: int, acknowledged: int, now: float) -> None:
        """Take an answer to the last question; one to an earlier question is too old."""
        if self._asked_clock is not None and acknowledged >= self._asked_clock[0]:
            self.board_clock.add(clock32, self._asked_clock[1], now)
            self._asked_clock = None

    def ask(
        self, command: str, response: str, pump: Callable[[float], list[Message]], **values: Value
    ) -> Message:
        """Return the answer to a question; it is repeated while none comes.

        Time in which this process stood still does not count: the answer may wait to be read.

        Args:
            command: The question.
            response: Name of its answer. An ``oid`` in the answer must be that of the question.
            pump: Exchanges bytes and returns the messages.
            values: Parameters of the question.

        Raises:
            BoardError: ``board-silent``, or any fault that ``pump`` raises.
        """
        began = asked = self.clock.now()
        self.send(command, **values)
        now = began
        while True:
            for message in pump(POLL_S):
                if message.name == response and (
                    "oid" not in values or message.values.get("oid") == values["oid"]
                ):
                    return message
            before, now = now, self.clock.now()
            if now - before > STANDSTILL_S:
                began += now - before
            if now - began > ANSWER_TIMEOUT_S:
                raise self.silent()
            if now - asked > ANSWER_S and self.link.idle:
                asked = now
                self.send(command, **values)

    def flush(self, pump: Pump) -> None:
        """Return when the board has carried out all commands so far; more may be appended."""
        link, end = self.link, self.link.appended
        while link.acknowledged < end and not link.idle:
            pump(POLL_S)

    def wait(self, seconds: float, pump: Pump) -> None:
        """Exchange bytes for some time."""
        began = self.clock.now()
        while self.clock.now() - began < seconds:
            pump(POLL_S)

    def open(self, timeout: float = IDENTIFY_S) -> None:
        """Read the dictionary and the clock.

        Raises:
            BoardError: ``board-silent``, ``board-not-klipper``, ``board-clock``.
        """
        while self.port.read(0.0):
            pass  # Bytes from an earlier connection.
        self.dictionary = self._identify(timeout)
        self.link.settled = True
        window = int(self.dictionary.constant("RECEIVE_WINDOW", 0.0))
        if window:
            self.link.window = window
        baud = self.dictionary.constant("SERIAL_BAUD", 0.0)
        self.link.byte_s = BITS_A_BYTE / baud if baud else 0.0
        log.info("%s: %s", self.name, self.dictionary.constants)
        self._read_clock()

    def reset(self) -> None:
        """Reset the microcontroller, and connect again; its configuration is gone.

        Raises:
            BoardError: It does not come back.
        """
        with suppress(BoardError):
            self.send("reset")
            began = self.clock.now()
            while self.clock.now() - began < RESET_S and not self.link.idle:
                self.pump(POLL_S)
        self.reconnect()

    def reconnect(self) -> None:
        """Connect again to a board that restarts.

        Raises:
            BoardError: It does not come back.
        """
        if self._reopen is not None:
            self.port.close()
        self.clock.sleep(RESTART_S)
        began = self.clock.now()
        while True:
            try:
                self._begin(self.port.port if self._reopen is None else self._reopen())
                self.open()
                return
            except BoardError:
                if self.clock.now() - began > RESTART_TIMEOUT_S:
                    raise
                if self._reopen is not None:
                    self.port.close()
                self.clock.sleep(RESET_S)

    def _identify(self, timeout: float) -> Dictionary:
        data = bytearray()
        heard = self.clock.now()
        first = Dictionary()
        asked = -1.0
        while True:
            now = self.clock.now()
            if now - heard > timeout:
                raise self._not_identified(len(data))
            if self.link.idle and now - asked > ANSWER_S:
                asked = now
                self.link.send(first.encode("identify", offset=len(data), count=CHUNK))
            try:
                out = self.link.outgoing(now)
            except WireError:
                raise self._not_identified(len(data)) from None
            if out:
                self.port.write(out)
            received = self.port.read(POLL_S)
            for block in self.link.receive(received, self.clock.now()):
                part = _identify_part(first, block.contents)
                if part is None or part[0] != len(data):
                    continue
                heard, asked = self.clock.now(), -1.0
                data += part[1]
                if len(part[1]) < CHUNK:
                    try:
                        return Dictionary.of(bytes(data))
                    except ProtocolError as error:
                        raise self._foreign(str(error)) from error
                if len(data) > MOST_DICTIONARY:
                    raise self._foreign("the dictionary has no end")

    def _read_clock(self) -> None:
        """Read all 64 bits of the clock, then estimate it by several questions."""
        frequency = self.dictionary.constant("CLOCK_FREQ")
        self.board_clock = BoardClock(frequency)
        self.link.drop_waiting()
        sent = self.clock.now()
        uptime = self.ask("get_uptime", "uptime", self.pump)
        clock = uptime["high"] << 32 | uptime["clock"]
        self.board_clock.set(clock, sent, self.clock.now())
        for k in range(FIRST_CLOCKS):
            if k >= FIRST_CLOCKS - 2:
                self.wait(FIRST_SPAN_S, self.pump)
            self._asked_clock = self.link.appended + 1, self.clock.now()
            self.ask("get_clock", "clock", self.pump)
        self._asked_at = self.clock.now()
        if self.board_clock.beyond(USUAL_DRIFT, 0.0):
            self.board_clock.restart()
            self.wait(LONGER_S, self.pump)
            drift = 100.0 * self.board_clock.drift
            log.info("%s: its clock deviates by %.1f %%", self.name, drift)
            self.board_clock.wrong = self.board_clock.beyond(MAX_DRIFT, LONGER_JUMP_S)
        if self.board_clock.wrong:
            code, message, hint = self.wrong_clock()
            raise board_error(code, message, hint=hint)

    def wrong_clock(self) -> tuple[str, str, str]:
        """Return code, message and hint for a clock with another rate than the firmware says."""
        clock = self.board_clock
        message = (
            f"the clock of the board on {self.name} runs at about {clock.wrong * 1e-6:.1f} MHz, "
            f"but its firmware was built for {clock.frequency * 1e-6:g} MHz"
        )
        hint = "build the firmware for the crystal of the board; home the machine before a run"
        return "board-clock", message, hint

    def silent(self) -> BoardError:
        """Return the fault of a board that does not answer."""
        hint = (
            "check cable and supply. The motors have stopped without a ramp: "
            "home the machine before the next run"
        )
        return board_error(
            "board-silent", f"the board on {self.name} does not answer any more", hint=hint
        )

    def _not_identified(self, received: int) -> BoardError:
        """Return the fault of a device without a dictionary, of which some bytes were received."""
        if received:
            message = f"the board on {self.name} does not answer any more"
            return board_error("board-silent", message, hint="check the cable and its shield")
        if self.link.damaged:
            hint = f"check port and board.baud ({BAUD} unless the firmware was built otherwise)"
            message = f"the device on {self.name} is not a Klipper board"
            return board_error("board-not-klipper", message, hint=hint)
        hint = "check the port, the board's supply, and that the board has Klipper's firmware"
        return board_error("board-silent", f"no device answers on {self.name}", hint=hint)

    def _foreign(self, reason: str) -> BoardError:
        hint = "reset the board; if this remains, install its firmware again"
        message = f"the board on {self.name} sends a message that is not readable: {reason}"
        return board_error("klipper-message", message, hint=hint)


def _identify_part(first: Dictionary, contents: bytes) -> tuple[int, bytes] | None:
    """Return offset and data of an answer to ``identify``, None for another message."""
    if not contents or contents[0] != IDENTIFY_RESPONSE_ID:
        return None
    try:
        message = next(iter(first.decode_responses(contents)))
    except RemoteError:
        return None
    return message["offset"], message.data("data")


# The report on a Klipper board at a port, with a skeleton of its machine file.

AXES = "xyz"
EXAMPLE = {"steps_per_mm": 80, "max_velocity": 50, "max_acceleration": 500, "max_jerk": 10_000}
"""Keys of an axis, with examples of their values."""


@dataclass(frozen=True, slots=True)
class KlipperInfo:
    """A board: its dictionary, its state, and the entries of its move queue.

    A board that is not configured has no queue yet: 0 entries.
    """

    dictionary: Dictionary
    slots: int
    configured: bool
    shut_down: bool


def read_info(connection: Connection, timeout: float) -> KlipperInfo:
    """Identify the board on a connection. Nothing moves, and nothing is configured.

    Raises:
        BoardError: No Klipper board answers.
    """
    connection.open(timeout)
    config = connection.ask("get_config", "config", connection.pump)
    return KlipperInfo(
        connection.dictionary,
        config["move_count"],
        bool(config["is_config"]),
        bool(config["is_shutdown"]),
    )


def klipper_report(port: str, board: KlipperInfo, baud: int) -> Iterator[str]:
    """Yield the lines of the report: comments of TOML, then the tables of a machine file.

    Args:
        port: Name of the serial port.
        board: The board.
        baud: Speed of the port, bits/s.
    """
    dictionary = board.dictionary
    frequency = dictionary.constant("CLOCK_FREQ", 0.0) / 1e6
    state = "shut down" if board.shut_down else "configured" if board.configured else "ready"
    yield f"# Klipper firmware {dictionary.version}  {dictionary.constants.get('MCU', '')}  {state}"
    queue = f"{board.slots} entries" if board.slots else "size known after configuration"
    yield f"# clock {frequency:g} MHz, move queue: {queue}"
    yield f"# pins: {pin_ranges(dictionary.enumerations.get('pin', {}))}"
    buses = dictionary.enumerations.get("spi_bus", {})
    if buses:
        yield f"# SPI buses: {', '.join(buses)}"
    yield "# A machine file for it. Replace every STEP_X, DIR_X and so on by a pin of your board,"
    yield "# and every number by that of your machine; until then nothing can move."
    yield "[board]"
    yield f'kind = "klipper"\nport = {json.dumps(port)}\nbaud = {baud}'
    if model := _model(dictionary):
        yield f'\n[board.klipper]\nmcu = "{model}"'
    for letter in AXES:
        upper = letter.upper()
        yield f"\n[board.klipper.{letter}]"
        yield f'step = "STEP_{upper}"\ndirection = "DIR_{upper}"'
        yield f'enable = "!ENABLE_{upper}"\nendstop = "^ENDSTOP_{upper}"'
    for letter in AXES:
        yield f"\n[axes.{letter}]"
        yield from (f"{key} = {value}" for key, value in EXAMPLE.items())


def _model(dictionary: Dictionary) -> str:
    """Return the name of the model of a microcontroller, "" if there is none."""
    mcu = dictionary.constants.get("MCU")
    return next((name for name, firmware in FIRMWARES.items() if firmware.mcu == mcu), "")
