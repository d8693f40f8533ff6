"""A GRBL board at a port: asked for its status while everything else goes on, never waited for
without a bound.

Opening a port for the first time resets most boards, and a boot loader then takes up to two seconds
before the firmware greets: such a greeting, which nobody asked for, is noted. A board that was not
reset answers ``?``. It gets a soft reset once it is known to stand still, which keeps its position,
so that every conversation begins with the welcome.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from cnc.boards.grbl import faults
from cnc.boards.grbl.messages import Feedback, Other, Setting, Welcome
from cnc.boards.grbl.protocol import (
    Alarmed,
    Confirmed,
    Event,
    GrblProtocol,
    RealTime,
    Rejected,
    Reported,
    SentLine,
    Started,
    State,
    UnexpectedReply,
)
from cnc.boards.grbl.settings import BoardInfo
from cnc.boards.grbl.status import Status
from cnc.boards.port import Clock, Port
from cnc.boards.protocols import board_error
from cnc.model.diagnostics import BoardError

POLL = 0.2
"""Seconds between two ``?``: GRBL's interface asks for no more than 5 Hz."""
POLL_FAST = 0.05
"""The same while a machine comes to rest."""
SILENCE = 2.0
"""Seconds without an answer to ``?`` after which the board has died."""
GREETING = 6.0
"""Seconds to wait for a board that has just been connected: boot loaders take up to 2."""
UNASKED = 2.6
"""Seconds after which a board that says nothing is reset: in a critical alarm GRBL answers nothing
else.
"""
UNHEARD = 3.4
"""Seconds after which DTR is raised for a board that may send only then; one that this resets still
greets in time.
"""
RESTART = 3.0
"""Seconds from a soft reset to the welcome."""
RESETS = 3
"""Times that a board which does not restart is told to."""
ANSWER = 3.0
"""Seconds for a question to a board at rest."""
WRITING = 0.5
"""Seconds in which a board has written a setting or an offset: some bytes of 3.4 ms each."""
GREETINGS = 3
"""Times that a conversation is begun anew."""
DROPPED = 20
"""Times that a board which does not answer is told to stop: what makes it silent may swallow bytes,
too.
"""
OLDEST = (1, 1)
"""The version that this protocol is of."""


class _AnewError(BoardError):
    """The conversation has to begin anew."""


class GrblLink:
    """Port, clock and protocol together. ``name`` is the port's, for messages."""

    def __init__(self, port: Port, clock: Clock, name: str) -> None:
        self.clock = clock
        self.name = name
        self.protocol = GrblProtocol()
        self.info = BoardInfo("", hal=False)
        self.status: Status | None = None
        self.status_at = -1.0
        self.alarm: int | None = None
        self.greeted_unasked = False
        """Whether the board greeted without having been told to reset: it has just started, or a
        network link was made.
        """
        self._port = port
        self._next_poll = 0.0
        self._unanswered_since: float | None = None
        self._alarms: list[int] = []
        self._writer: SentLine | None = None
        self._deaf_until = 0.0

    def now(self) -> float:
        """Seconds."""
        return self.clock.now()

    def write(self, data: bytes) -> None:
        """At once. PortLost."""
        self._port.write(data)

    def tell(self, command: RealTime) -> None:
        """A real-time command: it overtakes everything."""
        self._port.write(command.value)

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()

    def pump(self, timeout: float, poll: float = POLL) -> list[Event]:
        """What the board says, after ``timeout`` s at most; asks for the status meanwhile.
        PortLost; BoardError ``board-silent``.
        """
        now = self.clock.now()
        if now >= self._next_poll and not self._deaf(now):
            self._port.write(b"?")
            self._next_poll = now + poll
            if self._unanswered_since is None:
                self._unanswered_since = now
        data = self._port.read(timeout)
        events = self._heard(data) if data else []
        asked = self._unanswered_since
        # Noise is no answer.
        if (
            asked is not None
            and self.clock.now() - asked > self._patience()
            and all(isinstance(event, Other) for event in events)
        ):
            raise faults.silent(self.name)
        return events

    def due(self) -> bool:
        """Whether it is time for the next ``?``."""
        return self.clock.now() >= self._next_poll

    def poll_now(self) -> None:
        """Ask for the status at the next chance."""
        self._next_poll = 0.0

    def until(self, done: Callable[[Event], bool], timeout: float) -> bool:
        """Whether an event for which ``done`` says so came within ``timeout`` s. As :meth:`pump`,
        but silence is no fault here.
        """
        deadline = self.clock.now() + timeout
        while (left := deadline - self.clock.now()) > 0:
            self._unanswered_since = None
            for event in self.pump(min(left, POLL_FAST)):
                if done(event):
                    return True
        return False

    def ask(self, command: str) -> list[Feedback | Setting]:
        """What the board tells in answer to a command, while it is at rest. BoardError
        ``board-error``, ``board-alarm``, ``no-answer``.
        """
        told: list[Feedback | Setting] = []
        failed: list[BoardError] = []

        def done(event: Event) -> bool:
            if isinstance(event, Feedback | Setting):
                told.append(event)
            elif isinstance(event, Rejected):
                failed.append(faults.refused(event.code, command, 0, hal=self.info.hal))
            elif isinstance(event, Alarmed):
                failed.append(faults.alarmed(event.code, 0, hal=self.info.hal))
            elif isinstance(event, Started | UnexpectedReply):
                failed.append(_AnewError(faults.restarted(0).diagnostic))
            return isinstance(event, Confirmed) or bool(failed)

        if self.protocol.state is not State.READY:
            raise _AnewError(faults.restarted(0).diagnostic)
        self.write(self.protocol.send(command, 0))
        if not self.until(done, ANSWER):
            hint = "switch the board off and on; if that does not help, its firmware is not GRBL 1.1 or grblHAL"
            raise board_error(
                "no-answer",
                f"the board at {self.name} does not answer {command or 'an empty line'}",
                hint=hint,
            )
        if failed:
            raise failed[0]
        return told

    def connect(self) -> None:
        """Find out what is there, until the board is known and waits for lines. Nothing moves.

        BoardError ``no-answer``, ``board-not-grbl``, ``board-too-old``, ``board-busy``,
        ``port-lost``, and as :meth:`ask`.
        """
        for _ in range(GREETINGS - 1):
            # Some boards greet twice, or have an answer left over from before.
            with contextlib.suppress(_AnewError):
                return self._introduce(self._greeted())
        return self._introduce(self._greeted())

    def _introduce(self, welcome: Welcome) -> None:
        version = tuple(
            int(part)
            for part in welcome.version.rstrip("abcdefghijklmnopqrstuvwxyz").split(".")[:2]
        )
        if not welcome.hal and (version < OLDEST or version[0] > OLDEST[0]):
            hint = "flash GRBL 1.1 or grblHAL"
            raise board_error(
                "board-too-old",
                f"the board at {self.name} runs Grbl {welcome.version}, which speaks another protocol",
                hint=hint,
            )
        self.info = BoardInfo(welcome.version, welcome.hal)
        # An empty line ends the error that grblHAL may be repeating, and shows that the board
        # answers.
        self.ask("")
        self.info.take([*self.ask("$I"), *self.ask("$$")])
        self.protocol.status_reader.unit = self.info.unit
        self.info.take(self.ask("$#"))
        self.protocol.status_reader.axes = len(self.info.places.get("G54", ()))
        self.protocol.rx_bytes = self.info.rx_bytes
        self.refresh()

    def refresh(self) -> Status:
        """The status as it is now, with a position. BoardError ``no-answer``."""
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
                "no-answer", f"the board at {self.name} does not tell its position", hint=hint
            )
        return self.status

    def halt(self) -> BoardError | None:
        """Stop what moves and forget what waits: hold, wait for rest, reset, so that the position
        survives.

        Bounded; never fails. What went wrong meanwhile, if anything: an alarm, no sign that it has
        stopped.
        """
        self._alarms.clear()
        try:
            if self.alarm is None:
                self._rest(self.info.braking_s() * 2.0 + 0.5)
            # GRBL forgets a reset that comes within half a second of a limit's alarm.
            for _ in range(RESETS):
                self.write(self.protocol.reset())
                if self.until(lambda event: isinstance(event, Started), RESTART / RESETS):
                    break
            else:
                return faults.not_stopped(self.name)
            self.refresh()
        except BoardError as error:
            return error
        return faults.alarmed(self._alarms[0], 0, hal=self.info.hal) if self._alarms else None

    def drop(self) -> None:
        """For a board that does not answer any more: hold and reset, until it greets or it is clear
        that it does not hear.
        """
        with contextlib.suppress(BoardError):
            for _ in range(DROPPED):
                self.tell(RealTime.HOLD)
                self.write(self.protocol.reset())
                if self.until(lambda event: isinstance(event, Started), POLL_FAST):
                    return

    def _heard(self, data: bytes) -> list[Event]:
        events = self.protocol.receive(data)
        for event in events:
            if isinstance(event, Reported):
                self.status, self.status_at = event.status, self.clock.now()
                self._unanswered_since = None
            elif isinstance(event, Confirmed) and self._unanswered_since is not None:
                # It lives; while it homed it did not listen.
                self._unanswered_since = self.clock.now()
            elif isinstance(event, Alarmed):
                self.alarm = event.code
                self._alarms.append(event.code)
            elif isinstance(event, Started):
                self.alarm = None
                self._unanswered_since = None
        return events

    def _deaf(self, now: float) -> bool:
        """Whether the board may be writing to its EEPROM: it hears nothing then, and has one line
        to answer.
        """
        oldest = self.protocol.oldest
        if oldest is None or oldest.kind != "writer":
            return False
        if oldest is not self._writer:
            self._writer, self._deaf_until = oldest, now + WRITING + oldest.seconds
        return now < self._deaf_until

    def _patience(self) -> float:
        oldest = self.protocol.oldest
        return (
            oldest.seconds
            if oldest is not None and oldest.kind == "system" and oldest.seconds
            else SILENCE
        )

    def _rest(self, patience: float) -> None:
        """Hold, until the machine is at rest or ``patience`` s are over."""
        deadline = self.clock.now() + patience
        idle = 0
        again = 0.0
        while (now := self.clock.now()) < deadline:
            if now >= again:
                # A byte may be lost while the board writes to its EEPROM.
                self.tell(RealTime.HOLD)
                again = now + 0.3
            self._unanswered_since = None
            for event in self.pump(POLL_FAST, POLL_FAST):
                if isinstance(event, Alarmed):
                    return
                if isinstance(event, Reported) and event.status.at_rest:
                    # A report of Idle may be older than the hold.
                    idle += event.status.state == "Idle"
                    if event.status.state != "Idle" or idle > 2:
                        return

    def _greeted(self) -> Welcome:
        """The welcome of a board at rest."""
        heard: list[str] = []
        began = self.clock.now()
        kicked = told = raised = False
        if self.protocol.state is not State.UNKNOWN:
            self.write(self.protocol.reset())
            told = True
        while (now := self.clock.now()) - began < GREETING:
            self._unanswered_since = None
            if not kicked and not heard and now - began > UNASKED:
                kicked = told = True
                self.write(self.protocol.reset())
            if not raised and not heard and now - began > UNHEARD:
                raised, told = True, False
                self._port.raise_lines()
            for event in self.pump(0.1):
                if isinstance(event, Started):
                    self.greeted_unasked |= not told
                    return event.welcome
                if isinstance(event, Reported) and (
                    self.protocol.state is State.UNKNOWN or (raised and not told)
                ):
                    if not event.status.at_rest:
                        hint = "wait until it has come to rest, or stop it with its reset button"
                        raise board_error(
                            "board-busy",
                            f"the board at {self.name} is under way already ({event.status.state})",
                            hint=hint,
                        )
                    self.write(self.protocol.reset())
                    told = True
                elif isinstance(event, Other):
                    heard.append(event.text)
        raise self._not_grbl(heard)

    def _not_grbl(self, heard: list[str]) -> BoardError:
        said = next((text for text in heard if text.isascii() and text.isprintable()), None)
        if said is not None:
            hint = "this program drives GRBL 1.1 and grblHAL; name the port of such a board, or flash it"
            return board_error(
                "board-not-grbl",
                f"the board at {self.name} is no GRBL board: it says {said[:60]!r}",
                hint=hint,
            )
        if heard or self.protocol.partial:
            hint = "set board.baud in the machine file: 115200 for GRBL 1.1"
            return board_error(
                "board-not-grbl",
                f"what the board at {self.name} says is not to be understood",
                hint=hint,
            )
        hint = "is it switched on, is it the right port (cncrun boards lists them), and is board.baud right?"
        return board_error("no-answer", f"nothing answers at {self.name}", hint=hint)
