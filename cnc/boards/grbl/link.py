"""The link to a GRBL board at a port: welcome, questions, status polling, stop, and its report.

No wait is without a bound. Each connection begins with a welcome.
"""

from __future__ import annotations

import contextlib
import logging
import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import NoReturn

import tomlkit
from tomlkit.items import Item, Table

from cnc.boards.grbl import faults
from cnc.boards.grbl.faults import loses_position
from cnc.boards.grbl.messages import (
    Alarmed,
    Confirmed,
    Event,
    Feedback,
    Firmware,
    Other,
    Rejected,
    Reported,
    Setting,
    Started,
    Status,
    UnexpectedReply,
    Welcome,
)
from cnc.boards.grbl.protocol import (
    USUAL_BAUD,
    GrblProtocol,
    LineGroup,
    RealTime,
    State,
    WireTime,
    single,
)
from cnc.boards.grbl.settings import (
    ACCELERATIONS,
    ARC_TOLERANCE,
    JUNCTION_DEVIATION,
    NAMES,
    RATES,
    STEPS,
    BoardInfo,
)
from cnc.boards.port import Clock, LoggedPort, Port
from cnc.boards.protocols import board_error
from cnc.model.blocks import AXIS_LETTERS, AxisLetter
from cnc.model.diagnostics import BoardError
from cnc.model.units import per_second

# The welcome of a GRBL board that is connected.
#
# Opening a port for the first time resets most boards, and a boot loader then takes up to two
# seconds before the firmware greets. A board that was not reset answers ``?``, and gets a soft
# reset once it is at rest. The first answers do not count: they may be for the process that had the
# port before. A board that sends nothing gets a line end, which firmware of another kind answers.
# Then it is reset, then gets DTR.

WELCOME_TIMEOUT = 6.0
"""Seconds for the welcome of a board that has just been connected: boot loaders take up to 2."""
LINE_END_AFTER = 2.05
"""Seconds without a byte after which the questions become a line, which Marlin refuses aloud."""
RESET_AFTER = 2.25
"""Seconds without a byte after which the board is reset: in a critical alarm GRBL hears nothing
else.
"""
RAISE_DTR_AFTER = 2.5
"""Seconds without a byte after which DTR is raised: some boards send only then. A board that this
resets still greets in time. Where DTR is up, nothing else can be tried.
"""
STALE_FOR = 0.3
"""Seconds in which a report does not count. The system, and the USB chip of the board, may hold
reports from before the port was opened.
"""
BUSY_AFTER = 0.8
"""Seconds after which a board that still moves is refused."""
FOREIGN = 2.0
"""Seconds from the first line or noise of another device until it counts as one: a boot loader may
send bytes before the welcome.
"""
FOREIGN_TEXT = 1.4
"""The same for a line of text, which few boot loaders send."""
FOREIGN_ANSWER = 0.3
"""The same after the line end: no boot loader runs any more."""
_OLD_REPORT = re.compile(r"<\w+,MPos:")
"""The begin of a status report of GRBL 0.9 and older."""


def wait_for_welcome(link: GrblLink) -> Welcome:
    """Return the welcome of a board at rest.

    Raises:
        BoardError: ``board-not-grbl``, ``board-too-old``, ``board-busy``, ``board-alarm``,
            ``no-answer``.
    """
    received: list[str] = []
    began, foreign_since = link.listened, math.inf
    ended = forced = reset = raised = False
    unready: Status | None = None
    if link.protocol.state is not State.UNKNOWN:
        link.write(link.protocol.reset())
        reset = True
    while (now := link.listened) - began < WELCOME_TIMEOUT:
        if unready is not None and now - began > BUSY_AFTER:
            _refuse(unready, link.name)
        if not ended and not received and now - began > LINE_END_AFTER:
            ended = True
            link.write(b"\n")
        if not forced and not received and now - began > RESET_AFTER:
            forced = reset = True
            link.write(link.protocol.reset())
        if not raised and not received and now - began > RAISE_DTR_AFTER:
            if not link.raise_lines():
                break
            raised, reset = True, False
        patience = FOREIGN_ANSWER if ended else FOREIGN_TEXT if _is_text(received) else FOREIGN
        if now - foreign_since > patience and not _boots_slowly(received):
            break
        for event in link.listen(0.1):
            if isinstance(event, Started):
                link.greeted_unasked |= not reset
                return event.welcome
            if isinstance(event, Reported) and (
                link.protocol.state is State.UNKNOWN or (raised and not reset)
            ):
                unready = None if _is_ready(event.status) else event.status
                if unready is None and link.listened - began > STALE_FOR:
                    link.write(link.protocol.reset())
                    reset = True
            elif isinstance(event, Other):
                received.append(_text_of(event, link.name))
        if received or link.protocol.messages.partial:
            foreign_since = min(foreign_since, link.listened)
    rest = link.protocol.messages.partial.decode("latin-1")
    raise faults.not_grbl(link.name, [*received, rest] if rest else received)


def _text_of(event: Other, name: str) -> str:
    """Return the text of a message of another kind; BoardError for the report of an old GRBL."""
    if old := _OLD_REPORT.match(event.text):
        raise faults.too_old(name, "0.9", old[0])
    return event.text


def _is_ready(status: Status) -> bool:
    """Return whether a board may be reset, and takes it."""
    return status.at_rest and not status.emergency


def _refuse(status: Status, name: str) -> NoReturn:
    """Raise BoardError for a board that is not ready."""
    if not status.at_rest:
        hint = "wait until it has come to rest, or stop it with its reset button"
        message = f"the board at {name} is moving already ({status.state})"
        raise board_error("board-busy", message, hint=hint)
    raise faults.emergency(name)


def _is_text(received: Sequence[str]) -> bool:
    """Return whether all lines can be read; there is one at least."""
    return bool(received) and all(text.isascii() and text.isprintable() for text in received)


def _boots_slowly(received: Sequence[str]) -> bool:
    """Return whether the lines are those of an ESP32 that boots; networks take it some seconds."""
    return any(text.startswith(("ets ", "rst:", "ESP-ROM:")) for text in received)


log = logging.getLogger(__name__)

POLL = 0.2
"""Seconds between two ``?``: GRBL's interface allows at most 5 Hz."""
POLL_FAST = 0.05
"""The same while the machine comes to rest."""
SILENCE = 2.0
"""Seconds without an answer to ``?`` after which the board counts as dead."""
RESTART = 3.0
"""Seconds from a soft reset to the welcome."""
RESETS = 3
"""Resets that are sent to a board that does not restart."""
ANSWER = 3.0
"""Seconds for the answer of a board at rest."""
WRITING = 0.5
"""Seconds for a write of a setting or an offset: some bytes of 3.4 ms each."""
CONNECT_ATTEMPTS = 3
"""Attempts to connect."""
PAUSE = 0.05
"""s. The sender listens again within this time, unless the computer does something else."""
INSTANT = 1e-6
"""Shortest wait, s: sums of times are rounded."""
MOST_PENDING = 2
"""Most unanswered ``?`` that are assumed: others were lost."""
DROP_ATTEMPTS = 20
"""Stops that are sent to a board that does not answer: bytes may get lost."""
ABOVE_ASCII = bytes.maketrans(b"?~!", b"\x80\x81\x82")
"""Second set of real-time commands of grblHAL. No line contains the first."""
OLDEST_VERSION = (1, 1)
"""The version of this protocol."""


class _ReconnectError(BoardError):
    """The connection has to begin again."""


class GrblLink:
    """Port, clock and protocol.

    Attributes:
        now: Returns the present time, s.
        poll_at: Time of the next ``?``, s.
        listened: Time in which this computer listened to the board, s. A pause of the computer
            counts for less than PAUSE: answers that came meanwhile are read first. What the board
            fails to say is measured in this time.
        asked_at: Time of listening at the oldest unanswered ``?``, s, or at an answer to a line
            since; None without one.
        queued: Bytes to write with the next ones, or before the next :meth:`pump`.
        info: Firmware, settings and offsets of the board.
        status: The last status report.
        status_at: Time of that report, s.
        status_listened: The same as a time of listening, s.
        reports: Number of reports read.
        alarm: Code of the present alarm; None without one.
        position_lost: Whether the motors may have lost steps: an alarm stopped them in a move.
        greeted_unasked: Whether the board sent a welcome without a reset: it has just started, or a
            network connection was made.
    """

    def __init__(self, port: Port, clock: Clock, name: str, baud: int = USUAL_BAUD) -> None:
        """``name`` is the name of the port, for messages; ``baud`` its speed, bit/s."""
        self.clock, self.name, self.wire = clock, name, WireTime(baud)
        self.now = clock.now
        self.protocol = GrblProtocol()
        self.info = BoardInfo("", Firmware.GRBL)
        self.status: Status | None = None
        self.status_at = self.status_listened = -1.0
        self.listened, self._counted_at = 0.0, clock.now()
        self.reports = self._pending = 0
        self.alarm: int | None = None
        self.position_lost = self._moved = self.greeted_unasked = False
        self.queued = b""
        self._logged = LoggedPort(port, name, log, text=True)
        self._port: Port = self._logged if self._logged.logs else port
        self.poll_at = 0.0
        self.asked_at: float | None = None
        self._alarms: list[int] = []
        self._writer: LineGroup | None = None
        self._writing_until = 0.0

    def listen_to_lines(self, on_line: Callable[[str, str], None] | None) -> None:
        """Call a function with direction (``->``, ``<-``) and text of each line; None ends it."""
        self._logged.on_line = on_line
        self._port = self._logged if self._logged.logs else self._logged.port

    def write(self, data: bytes) -> None:
        """Write at once, behind what is queued; PortLost."""
        if data and self.info.commands_above_ascii:
            data = data.translate(ABOVE_ASCII)
        data, self.queued = self.queued + data, b""
        self.wire.written(len(data), self.now())
        self._port.write(data)

    def send_realtime(self, command: RealTime) -> None:
        """Send a real-time command, which overtakes all lines."""
        self.write(command.value)

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def pump(self, timeout: float, poll: float = POLL) -> list[Event]:
        """Receive for at most ``timeout`` s, and ask for the status meanwhile.

        Args:
            timeout: s.
            poll: Seconds between two ``?``.

        Returns:
            The events of the board.

        Raises:
            PortLost: The port is gone.
            BoardError: ``board-silent``.
        """
        now = self._count(PAUSE)
        if now >= self.poll_at and not self._writing(now):
            self.write(b"?")
            self.poll_at = now + poll
            self._pending += 1
            if self.asked_at is None:
                self.asked_at = self.listened
        elif self.queued:
            self.write(b"")
        data = self._port.read(timeout)
        self._count(timeout + PAUSE)
        events = self.protocol.receive(data) if data else []
        for event in events:
            if type(event) is not Confirmed:
                self._note(event)
            elif self.asked_at is not None:
                # The board is alive; it does not listen while it homes.
                self.asked_at = self.listened
        asked = self.asked_at
        # Noise does not count as an answer.
        if (
            asked is not None
            and self.listened - asked > self._patience()
            and all(isinstance(event, Other) for event in events)
        ):
            raise faults.silent(self.name)
        return events

    @property
    def last_old_report(self) -> int:
        """Number of the last report that may tell of a time before now."""
        return self.reports + min(self._pending, MOST_PENDING)

    def raise_lines(self) -> bool:
        """Raise DTR, which resets some boards; return whether it was down."""
        return self._port.raise_lines()

    def listen(self, timeout: float) -> list[Event]:
        """Receive as :meth:`pump` does. Silence is no fault here."""
        self.asked_at = None
        return self.pump(timeout)

    def poll_now(self) -> None:
        """Ask for the status with the next :meth:`pump`."""
        self.poll_at = 0.0

    def until(self, done: Callable[[Event], bool], timeout: float) -> bool:
        """Return whether an event for which ``done`` is true came within ``timeout`` s.

        Silence is no fault here.
        """
        deadline = self.listened + timeout
        while (left := deadline - self.listened) > INSTANT:
            self.asked_at = None
            for event in self.pump(min(left, POLL_FAST)):
                if done(event):
                    return True
        return False

    def ask(self, command: str, patience: float = ANSWER) -> list[Feedback | Setting]:
        """Return the answer to a command while the board is at rest.

        Args:
            command: The line.
            patience: Longest time of the whole answer, s.

        Raises:
            BoardError: ``board-error``, ``board-alarm``, ``no-answer``; ``board-busy`` at its
                safety door, where it reads no line.
        """
        answers: list[Feedback | Setting] = []
        failed: list[BoardError] = []
        old = self.last_old_report

        def done(event: Event) -> bool:
            if isinstance(event, Feedback | Setting):
                answers.append(event)
            elif isinstance(event, Rejected):
                failed.append(faults.refused(event.reply, command, 0, self.info.kind))
            elif isinstance(event, Alarmed):
                failed.append(faults.alarmed(event.code, 0, self.info.kind))
            elif isinstance(event, Reported) and event.status.door and self.reports > old:
                failed.append(faults.at_door(event.status))
            elif isinstance(event, Started | UnexpectedReply):
                failed.append(_ReconnectError(faults.restarted(0).diagnostic))
            return isinstance(event, Confirmed) or bool(failed)

        if self.protocol.state is not State.READY:
            raise _ReconnectError(faults.restarted(0).diagnostic)
        self.write(self.protocol.send(single(command, 0)))
        if not self.until(done, patience):
            hint = (
                "switch the board off and on; if that does not help, its firmware is not GRBL 1.1 "
                "or grblHAL"
            )
            raise board_error(
                "no-answer",
                f"the board at {self.name} does not answer {command or 'an empty line'}",
                hint=hint,
            )
        if failed:
            raise failed[0]
        return answers

    def connect(self) -> None:
        """Identify the board, until it waits for lines. Nothing moves.

        Raises:
            BoardError: ``no-answer``, ``board-not-grbl``, ``board-too-old``, ``board-busy``,
                ``port-lost``, and those of :meth:`ask`.
        """
        for _ in range(CONNECT_ATTEMPTS - 1):
            # Some boards greet twice, or still send an answer from before.
            with contextlib.suppress(_ReconnectError):
                return self._identify(wait_for_welcome(self))
        return self._identify(wait_for_welcome(self))

    def _identify(self, welcome: Welcome) -> None:
        digits = welcome.version.rstrip("abcdefghijklmnopqrstuvwxyz")
        version = tuple(int(part) for part in digits.split(".")[:2])
        if welcome.firmware is Firmware.GRBL and (
            version < OLDEST_VERSION or version[0] > OLDEST_VERSION[0]
        ):
            raise faults.too_old(self.name, welcome.version)
        self.info = BoardInfo(welcome.version, welcome.firmware)
        log.info("%s: %s", self.name, self.info.firmware)
        # An empty line ends an error that grblHAL repeats, and shows that the board answers.
        self.ask("")
        self.info.take(self.ask("$I"))
        if self.info.may_be_hal and not self.info.extensions:
            self.info.take(self._answers("$I+"))
        self.protocol.firmware = self.info.kind
        self.info.take(self._answers("$$") if self.info.fluid else self.ask("$$"))
        self.info.take(self.ask("$#"))
        reader = self.protocol.status_reader
        reader.unit, reader.rotary = self.info.unit, self.info.rotary
        reader.axes = len(self.info.places.get("G54", ()))
        self.protocol.rx_bytes = self.info.rx_bytes
        self.refresh()

    def _answers(self, command: str) -> list[Feedback | Setting]:
        """Return the answer to a command that the board may not have; nothing then.

        FluidNC keeps its settings in a file, and may have no ``$$``. Old builds of grblHAL have no
        ``$I+``.
        """
        try:
            return self.ask(command)
        except BoardError as error:
            if error.diagnostic.code == "board-error":
                # The answer was an error, so the lines before it do not count.
                self.protocol.state = State.READY
                return []
            raise

    def refresh(self) -> Status:
        """Return the present status with a position; BoardError ``no-answer``."""
        self.poll_now()
        if (
            not self.until(
                lambda event: isinstance(event, Reported) and event.status.position is not None,
                ANSWER,
            )
            or self.status is None
        ):
            hint = "set $10 to 1, so that the board reports machine positions"
            raise board_error(
                "no-answer", f"the board at {self.name} does not report its position", hint=hint
            )
        return self.status

    def halt(self) -> BoardError | None:
        """Hold, wait for rest and reset, so that the position is kept.

        It takes a bounded time and raises nothing.

        Returns:
            A fault that occurs meanwhile: an alarm, or no confirmation of the stop.
        """
        self._alarms.clear()
        self.queued = b""
        try:
            if self.alarm is None:
                self._rest(self.info.braking_s() * 2.0 + 0.5)
            # GRBL ignores a reset within half a second after an alarm of a limit switch.
            for _ in range(RESETS):
                self.write(self.protocol.reset())
                if self.until(lambda event: isinstance(event, Started), RESTART / RESETS):
                    break
            else:
                return faults.not_stopped(self.name)
            self.refresh()
        except BoardError as error:
            return error
        return faults.alarmed(self._alarms[0], 0, self.info.kind) if self._alarms else None

    def drop(self) -> None:
        """Send hold and reset to a board that no longer answers, until it greets or time is up."""
        self.queued = b""
        with contextlib.suppress(BoardError):
            for _ in range(DROP_ATTEMPTS):
                self.send_realtime(RealTime.HOLD)
                self.write(self.protocol.reset())
                if self.until(lambda event: isinstance(event, Started), POLL_FAST):
                    return

    def _note(self, event: Event) -> None:
        """Note what an event tells about the board."""
        if isinstance(event, Reported):
            # An alarm whose message was lost may be any.
            self.position_lost |= self._moved and event.status.locked
            self._moved = not event.status.at_rest
            self.status, self.status_at = event.status, self.now()
            self.status_listened = self.listened
            self.reports += 1
            self._pending = max(min(self._pending, MOST_PENDING) - 1, 0)
            self.asked_at = None
        elif isinstance(event, Alarmed):
            log.warning("%s: alarm %d", self.name, event.code)
            self.alarm, self._moved = event.code, False
            self.position_lost |= loses_position(event.code, self.info.kind)
            self._alarms.append(event.code)
        elif isinstance(event, Started):
            log.info("%s: the board has started", self.name)
            self.alarm = None
            self.asked_at = None
            self._pending = 0

    def _count(self, most: float) -> float:
        """Return the present time, s; the time since the last call is listening, at most this."""
        now = self.now()
        self.listened += min(now - self._counted_at, most)
        self._counted_at = now
        return now

    def _writing(self, now: float) -> bool:
        """Return whether the board may be writing to its EEPROM, when it loses bytes.

        A single line is unanswered then.
        """
        writer = self.protocol.writer
        if writer is None:
            return False
        if writer is not self._writer:
            self._writer, self._writing_until = writer, now + WRITING + writer.seconds
        return now < self._writing_until

    def _patience(self) -> float:
        oldest = self.protocol.oldest
        return (
            oldest.seconds
            if oldest is not None and oldest.kind == "system" and oldest.seconds
            else SILENCE
        )

    def _rest(self, patience: float) -> None:
        """Hold until the machine is at rest, for at most ``patience`` s."""
        deadline = self.clock.now() + patience
        idle = 0
        again = 0.0
        old = self.last_old_report
        while (now := self.clock.now()) < deadline:
            if now >= again:
                # A byte may be lost while the board writes to its EEPROM.
                self.send_realtime(RealTime.HOLD)
                again = now + 0.3
            self.asked_at = None
            for event in self.pump(POLL_FAST, POLL_FAST):
                if isinstance(event, Alarmed):
                    return
                if isinstance(event, Reported) and event.status.at_rest and self.reports > old:
                    # A report of Idle may be older than the hold.
                    idle += event.status.state == "Idle"
                    if event.status.state != "Idle" or idle > 2:
                        return


# The report on a GRBL board at a port: its settings, and the machine file that they give.
#
# GRBL reports its limits (``$$``) but has no limit of jerk. The machine file gets a jerk at which
# an axis reaches its acceleration in JERK_TIME, so that a plan stays close to the board's own
# ramps.

JERK_TIME = 0.025
"""Time in which an axis reaches its acceleration, s."""
STEP_RATE = 30_000
"""Step rate of GRBL on an Uno, steps/s; the file has more where the settings need more."""


def grbl_report(port: str, info: BoardInfo, status: Status, baud: int) -> Iterator[str]:
    """Yield the lines of the report: comments of TOML, then the machine file."""
    yield f"# {info.firmware}  {info.build}  {status.state}".rstrip()
    position = "  ".join(
        f"{letter.upper()} {value:.3f}"
        for letter, value in zip(AXIS_LETTERS, status.position or (), strict=False)
    )
    yield f"# machine position {position}"
    yield (
        f"# planner {info.blocks or 'unknown'} blocks, receive buffer {info.rx_bytes} bytes, "
        f"options {info.options or 'none'}"
    )
    if info.extensions:
        yield f"# extensions {', '.join(sorted(info.extensions))}"
    for line in info.about:
        yield f"# {line}"
    for number, value in sorted(info.settings.items()):
        yield f"# ${number} = {value}  {NAMES.get(number, '')}".rstrip()
    try:
        yield from machine_file(port, info, baud).splitlines()
    except BoardError as error:
        yield f"# no machine file: {error.diagnostic.message}; {error.diagnostic.hint}"


def machine_file(port: str, info: BoardInfo, baud: int) -> str:
    """Return the machine file (TOML) that the settings of a board give.

    Args:
        port: Name of the serial port.
        info: Firmware and settings of the board.
        baud: Speed of the port, bits/s.

    Raises:
        BoardError: ``board-settings``, where the board does not report the settings of its axes.
    """
    letters = AXIS_LETTERS[: info.axes]
    if not letters and info.fluid:
        message = "FluidNC keeps its settings in a file (config.yaml)"
        hint = "write a machine file with the steps_per_mm, rates and travel of that file"
        raise board_error("board-settings", message, hint=hint)
    if not letters:
        raise board_error(
            "board-settings",
            "the board does not report the settings of its axes",
            hint="is its firmware GRBL 1.1 or grblHAL?",
        )
    file = tomlkit.document()
    file.add(tomlkit.nl())
    header = tomlkit.table()
    header.add("name", info.firmware)
    if info.laser:
        header.add("kind", "laser")
    header.add(tomlkit.nl())
    file.add("machine", header)
    rates, step_rates = [], [float(STEP_RATE)]
    axes = tomlkit.table(is_super_table=True)
    for column, letter in enumerate(letters):
        steps, rate, acceleration = _axis_settings(info, column, letter)
        rates.append(rate)
        step_rates.append(rate * steps)
        axes.add(letter, _axis(info, column, (steps, rate, acceleration)))
    file.add("axes", axes)
    if not info.homes:
        file.add(tomlkit.comment("The board does not home ($22=0): machine zero is its position"))
        file.add(tomlkit.comment("at power-up, and the ends of the travel are not known."))
        file.add(tomlkit.nl())
    path = tomlkit.table()
    path.add("max_feed", _number(max(rates)))
    for key, setting in (("chord_error", ARC_TOLERANCE), ("tolerance", JUNCTION_DEVIATION)):
        value = info.number(setting)
        if value:
            path.add(key, _number(value, f"${setting}"))
    path.add(tomlkit.nl())
    file.add("path", path)
    step_rate = math.ceil(max(step_rates))
    file["board"] = {"kind": "grbl", "port": port, "baud": baud, "max_step_rate": step_rate}
    return tomlkit.dumps(file)


def _axis_settings(info: BoardInfo, column: int, letter: AxisLetter) -> tuple[float, float, float]:
    """Return steps/mm, velocity in mm/s and acceleration in mm/s^2 of an axis."""
    steps, rate, acceleration = (
        info.axis(first, column) for first in (STEPS, RATES, ACCELERATIONS)
    )
    if steps is None or rate is None or acceleration is None:
        numbers = f"${STEPS + column}, ${RATES + column} or ${ACCELERATIONS + column}"
        message = f"the board does not report {numbers} of its axis {letter.upper()}"
        raise board_error("board-settings", message, hint="set them on the board")
    return steps, per_second(rate), acceleration


def _axis(info: BoardInfo, column: int, settings: tuple[float, float, float]) -> Table:
    """Return the table of an axis."""
    steps, rate, acceleration = settings
    minute_rate = info.axis(RATES, column)
    table = tomlkit.table()
    table.add("steps_per_mm", _number(steps, f"${STEPS + column}"))
    table.add("max_velocity", _number(rate, f"${RATES + column} = {minute_rate:g} mm/min"))
    table.add("max_acceleration", _number(acceleration, f"${ACCELERATIONS + column}"))
    jerk = f"GRBL has none; {JERK_TIME:g} s to the full acceleration"
    table.add("max_jerk", _number(acceleration / JERK_TIME, jerk))
    travel = info.travel(column) if info.homes else None
    if travel is not None:
        table.add("travel", tomlkit.value(f"[{travel[0]:.10g}, {travel[1]:.10g}]"))
    table.add(tomlkit.nl())
    return table


def _number(value: float, comment: str = "") -> Item:
    """Return a number with ten digits, and a comment."""
    item = tomlkit.value(f"{value:.10g}")
    if comment:
        item.comment(comment)
        item.trivia.comment_ws = "  "
    return item
