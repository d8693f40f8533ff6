"""The link to a GRBL board at a port: connection, questions, status polling, and stop.

No wait is without a bound. Each connection begins with a welcome; see the module of that name.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable

from cnc.boards.errors import board_error
from cnc.boards.grbl import faults
from cnc.boards.grbl.codes import loses_position
from cnc.boards.grbl.events import (
    Alarmed,
    Confirmed,
    Event,
    Rejected,
    Reported,
    Started,
    UnexpectedReply,
)
from cnc.boards.grbl.line_groups import LineGroup, single
from cnc.boards.grbl.messages import Feedback, Firmware, Other, Setting, Welcome
from cnc.boards.grbl.protocol import GrblProtocol, RealTime, State
from cnc.boards.grbl.settings import BoardInfo
from cnc.boards.grbl.status import Status
from cnc.boards.grbl.welcome import wait_for_welcome
from cnc.boards.grbl.wire_time import USUAL_BAUD, WireTime
from cnc.boards.port import Clock, Port
from cnc.boards.port_log import LoggedPort
from cnc.model.diagnostics import BoardError

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
