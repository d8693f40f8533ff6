"""Sending of lines to a GRBL board, with its faults watched and the operator's requests served.

No wait is without a bound. At any fault the motion is stopped (hold, wait for rest, reset) before
the fault is raised, and nothing is sent any more.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

from cnc.boards.grbl import faults
from cnc.boards.grbl.fault_monitor import FULL_OVERRIDE, FaultMonitor
from cnc.boards.grbl.link import ANSWER, GrblLink
from cnc.boards.grbl.messages import (
    ALONE,
    MOST_CHARACTERS,
    WAITING,
    Confirmed,
    Event,
    Feedback,
    Reported,
    Started,
    Status,
    bare,
    in_mm,
)
from cnc.boards.grbl.protocol import LineGroup, RealTime, UnansweredLines, WireTime
from cnc.boards.port import PortLost
from cnc.boards.protocols import OnReport, board_error
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.operator_control import MIN_FEED_OVERRIDE_OF_BOARD, Control

# The operator's requests as real-time commands of GRBL. No I/O.
#
# A byte may get lost (the board loses bytes while it writes to its EEPROM). So each request is
# compared with the status reports, and repeated. Where the machine itself holds (a program stop, a
# tool change, the safety door, a button), this becomes a hold of the operator, who resumes at the
# machine or here.
#
# A board that brakes ignores a resume. So it is sent when a report shows that the machine rests.

PATIENCE = 0.5
"""Seconds within which a real-time command must show in the status."""
MIN_OVERRIDE = round(MIN_FEED_OVERRIDE_OF_BOARD)
"""Per cent; GRBL's feed overrides go from 10 to 200."""
LARGE_STEP = 10
FEED, RAPID, SPINDLE = range(3)
"""Columns of the overrides in a status report."""
RAPIDS = {25: RealTime.RAPID_25, 50: RealTime.RAPID_50, 100: RealTime.RAPID_100}
STEPS = {
    FEED: (
        RealTime.FEED_UP_10,
        RealTime.FEED_UP_1,
        RealTime.FEED_DOWN_10,
        RealTime.FEED_DOWN_1,
    ),
    SPINDLE: (
        RealTime.SPINDLE_UP_10,
        RealTime.SPINDLE_UP_1,
        RealTime.SPINDLE_DOWN_10,
        RealTime.SPINDLE_DOWN_1,
    ),
}


class Stepped(NamedTuple):
    """The last step of an override: its time in s, and the reported value before it, per cent."""

    time: float
    present: int


class OperatorRequests:
    """Follows the requests of one operator control."""

    def __init__(self, control: Control) -> None:
        self.control = control
        self._held = self._held_by_machine = False
        self._requested_at = -PATIENCE
        self._seen: tuple[object, ...] = ()
        self._steps = {column: Stepped(-PATIENCE, -1) for column in (FEED, RAPID, SPINDLE)}

    @property
    def override(self) -> int:
        """The requested feed override, per cent."""
        return max(round(self.control.feed_override), MIN_OVERRIDE)

    def commands(self, status: Status, status_at: float, now: float) -> bytes:
        """Return the bytes to write now; mostly none.

        There are some only after a new report or a new request.

        Args:
            status: The last status report.
            status_at: Time of that report, s.
            now: Present time, s.
        """
        control = self.control
        seen = (status_at, control.requested)
        if seen == self._seen:
            return b""
        self._seen = seen
        return (
            self._hold(status, status_at, now)
            + self._step(status, now, FEED, self.override)
            + self._step(status, now, RAPID, self.control.rapid_override)
            + self._step(status, now, SPINDLE, round(self.control.spindle_override))
        )

    def _hold(self, status: Status, status_at: float, now: float) -> bytes:
        control = self.control
        if control.held != self._held:
            if self._held and self._braking(status, status_at):
                return b""
            self._held, self._held_by_machine, self._requested_at = control.held, False, now
            return RealTime.HOLD.value if self._held else RealTime.RESUME.value
        if now - self._requested_at <= PATIENCE or status_at <= self._requested_at:
            return b""
        if status.state in WAITING and not self._held:
            self._held = self._held_by_machine = True
            control.hold()
        elif status.state in ("Run", "Jog") and self._held:
            self._requested_at = now
            if not self._held_by_machine:
                return RealTime.HOLD.value
            # The operator has resumed at the machine.
            self._held = self._held_by_machine = False
            control.resume()
        return b""

    def _braking(self, status: Status, status_at: float) -> bool:
        """Return whether a hold is not complete, by a report that may be older than the hold."""
        if status.state not in WAITING:
            return status_at - self._requested_at <= PATIENCE
        return status_at <= self._requested_at or not status.at_rest

    def reached(self, status: Status) -> bool:
        """Return whether the board has all requested overrides."""
        return status.overrides == (
            self.override,
            self.control.rapid_override,
            round(self.control.spindle_override),
        )

    def _step(self, status: Status, now: float, column: int, wanted: int) -> bytes:
        """Return one step towards a requested override.

        Each step has to show in a report before the next, or GRBL may take two for one.
        """
        last = self._steps[column]
        if status.overrides is None:
            return b""
        present = status.overrides[column]
        if present == wanted or (present == last.present and now - last.time < PATIENCE):
            return b""
        self._steps[column] = Stepped(now, present)
        if column == RAPID:
            return RAPIDS[wanted].value
        up_large, up_small, down_large, down_small = STEPS[column]
        missing = wanted - present
        large, small = (up_large, up_small) if missing > 0 else (down_large, down_small)
        return (large if abs(missing) >= LARGE_STEP else small).value


# How long the sender of lines sleeps while answers of a GRBL board gather. No I/O.
#
# A wake-up costs the computer more than a line. The board meanwhile reads the lines that wait in
# its buffer. A wire that brings lines more slowly than the board reads them is not left idle: no
# answers gather, and the first answer after a long move is served at once. A report makes answers
# late: behind it, more lines are answered than is known.

GATHERING = 0.5
"""Part of the time of the unanswered lines but one in which answers gather. The rest covers the way
of the answers to this computer, and its late wake-ups. One line may wait for space.
"""
SLOWER_THAN_WIRE = 1.3
"""Time between answers, in times of a line on the wire, above which the board takes longer for a
line than the wire. Answers gather only there.
"""
FEW_ARRIVED = 2.5
"""Unanswered lines that have arrived at such a board. Fewer are not enough to let answers gather.
"""
LONGEST = 0.02
"""Limit on that time, s."""
SHORTEST = 0.002
"""Time below which waiting is not worth its while, s."""
SPARE = 0.0015
"""Time before the wire is idle at which waiting ends, s; the mean lateness of wake-ups is added.
A single late wake-up, which a busy computer has now and then, says nothing about the next.
"""
LATE_WEIGHT = 0.3
"""Weight of the last wake-up in that mean."""
BEHIND_REPORT = 0.8
"""Share of the gathering while answers may wait behind a report or the answer to a mark."""
REPORT = 40
"""Fewest bytes of these."""


class AnswerGathering:
    """Follows the sleeps of one stream.

    Args:
        wire: The wire to the board.
    """

    def __init__(self, wire: WireTime) -> None:
        self._wire = wire
        self._asked = False
        self._late = 0.0

    def pause(
        self, lines: UnansweredLines, interval: float, partial: bytes, now: float, *, asked: bool
    ) -> float:
        """Return the time to sleep before the next look at the answers, s; 0 for none.

        Args:
            lines: The unanswered lines.
            interval: Average time between two answers, s.
            partial: Bytes of a message that has not ended yet.
            now: Present time, s.
            asked: Whether a report or the answer to a mark is expected.
        """
        behind, self._asked = asked or self._asked, asked
        if interval >= LONGEST:
            return 0.0
        wire, waiting = self._wire, lines.count
        busy = max(wire.idle_from - now, 0.0)
        # As long as the wire is busy, lines that are sent now would only wait for it.
        pause = busy - SPARE - self._late
        if waiting:
            on_one_line = wire.byte_time * lines.bytes / waiting
            slow = interval > SLOWER_THAN_WIRE * on_one_line
            if slow and busy <= (waiting - FEW_ARRIVED) * on_one_line:
                part = BEHIND_REPORT * GATHERING if behind else GATHERING
                pause = max(pause, part * (waiting - 1) * interval)
        if behind and partial[:1] in (b"<", b"["):
            # No answer comes before the end of the message.
            pause = max(pause, wire.byte_time * (REPORT - len(partial)))
        return min(pause, LONGEST) if pause >= SHORTEST else 0.0

    def woken(self, late: float) -> None:
        """Note by which time a sleep has ended late, s."""
        self._late += LATE_WEIGHT * (late - self._late)


log = logging.getLogger(__name__)

WAIT = 0.05
"""Longest wait for the board, s, until the operator's requests are served."""
POLL_AT_REST = 0.05
"""Seconds between two ``?`` while the machine comes to rest."""
MARK_LINES = 20
MARK_TIME = 0.5
"""Lines and seconds from one mark to the next; whichever comes first."""
OVERRIDE_PATIENCE = 15.0
"""Seconds for the first override: each step of ten takes a report."""
OVERRIDE_ANSWER = 0.5
RESTORED = 3
"""Seconds until the end of the overrides shows in a report, and attempts: a byte may be lost."""
WITHOUT_OVERRIDES = RealTime.FEED_100.value + RealTime.RAPID_100.value + RealTime.SPINDLE_100.value
UNCHANGED = Status("Idle", overrides=(FULL_OVERRIDE, FULL_OVERRIDE, FULL_OVERRIDE))
REST_STATES = ("Idle", "Alarm", "Check", "Sleep")


class LineStream:
    """The stream of lines of one board.

    Attributes:
        link: The link to the board.
        monitor: Finds faults in what the board reports.
        state: ``idle``, ``running`` or ``stopped``.
        sent: Lines sent since :meth:`begin`.
        began: Time of the first of them that does more than change modes, s; None without one.
        probed: Contact position of the last probe in mm, and 1 or 0 for contact or none.
        rested_at: Time of the report that last showed the machine at rest, s.
        wait: Longest wait for the board, s, until the operator's requests are served.
    """

    def __init__(self, link: GrblLink) -> None:
        self.link = link
        self.monitor = FaultMonitor(link.protocol)
        self.state = "idle"
        self.sent = 0
        self.began: float | None = None
        self.probed: tuple[float, ...] | None = None
        self.rested_at = 0.0
        self._control = Control()
        self._requests: OperatorRequests | None = None
        self._on_report: OnReport | None = None
        self._marked_at = 0.0
        self._gathering = AnswerGathering(link.wire)
        self.wait = WAIT

    @property
    def status(self) -> Status:
        """The last status report."""
        assert self.link.status is not None
        return self.link.status

    @property
    def position(self) -> tuple[float, ...]:
        """The last reported machine position, mm; empty before the first report."""
        status = self.link.status
        return () if status is None or status.position is None else status.position

    @property
    def stopping(self) -> bool:
        """Whether the operator has asked to stop the run."""
        return self._control.stopped

    @property
    def held(self) -> bool:
        """Whether the operator holds the run."""
        return self._control.held

    def connect_operator(self, control: Control, on_report: OnReport) -> None:
        """Serve the operator's requests, and call ``on_report`` after each status report."""
        self._control, self._requests = control, OperatorRequests(control)
        self._on_report = on_report

    def begin(self, offset: Sequence[float], *, moves: bool) -> None:
        """Begin a run.

        Args:
            offset: Work offset that the board adds to the numbers of a line, mm.
            moves: Whether lines move the machine.
        """
        self.sent, self.began = 0, None
        self.link.protocol.begin_program()
        self.monitor.begin(self.link.info, self.position, offset, self.link.listened, moves=moves)
        self._set_first_override()

    def send(self, group: LineGroup) -> bool:
        """Send the lines of a group, each as soon as there is space for it.

        Returns:
            Whether all were sent; not when the operator stops the run.

        Raises:
            BoardError: ``line-too-long``, ``board-locked``, or any fault that is found meanwhile.
        """
        if len(group) == 1 and len(group.text) > MOST_CHARACTERS + 1:
            length = len(group.text) - 1
            message = f"a line has {length} characters; the board accepts {MOST_CHARACTERS}"
            raise self.stopped_by(board_error("line-too-long", message, line=group.lines[0]))
        if group.kind in ALONE:
            self.rest()
        if self.stopping:
            return False
        status = self.link.status
        if status is not None and status.state == "Alarm":
            unlocks = bare(group.text)[:2] in ("$H", "$X")
            self.refuse_if_locked(group.lines[0], unless=unlocks)
        if group.kind == "probe":
            self.probed = None
        return self._send_as_space_comes(group)

    def _send_as_space_comes(self, group: LineGroup) -> bool:
        """Send the lines of a group; return whether all were sent."""
        link, monitor, protocol = self.link, self.monitor, self.link.protocol
        monitor.prepare(group)
        done, count, control = 0, len(group), self._control
        while True:
            most = protocol.room(group, done, monitor.liveness.max_waiting)
            if most and monitor.moves:
                most = monitor.near(most, link.status)
            if most:
                now = link.now()
                if not protocol.unanswered.count:
                    monitor.liveness.begin(link.listened)
                if self.began is None and group.acts:
                    self.began = now
                link.queued += protocol.send(group, done, done + most)
                if monitor.moves:
                    monitor.tracker.send(most)
                self.sent += most
                done += most
                if (
                    protocol.unmarked >= MARK_LINES or now - self._marked_at > MARK_TIME
                ) and protocol.mark_fits():
                    self._mark()
                if now >= link.poll_at:
                    self.serve(0.0)
                if done == count:
                    return True
            self._await_answers()
            if control.stopped:
                return False

    def _await_answers(self) -> None:
        """Receive; where answers come fast, let some gather, which saves most of the CPU time."""
        link, protocol = self.link, self.link.protocol
        try:
            if link.queued:
                link.write(b"")
        except PortLost as error:
            raise self._port_lost(error) from error
        now = link.now()
        pause = self._gathering.pause(
            protocol.unanswered,
            self.monitor.liveness.interval,
            protocol.messages.partial,
            now,
            asked=link.asked_at is not None or protocol.marked,
        )
        if pause:
            link.clock.sleep(pause)
            self._gathering.woken(link.now() - now - pause)
        self.serve(self.wait)

    def refuse_if_locked(self, line: int, *, unless: bool = False) -> None:
        """Raise BoardError ``board-locked`` while the board is in alarm."""
        if self.status.state == "Alarm" and not unless:
            raise self.stopped_by(faults.locked(line))

    def drain(self) -> None:
        """Wait until every line has been answered, or the operator stops the run."""
        while self.link.protocol.waiting and not self.stopping:
            self.serve(self.wait)

    def rest(self) -> None:
        """Wait until the machine rests with nothing to do, or the operator stops the run."""
        self.drain()
        link = self.link
        link.poll_now()
        last = link.last_old_report
        reports = 0
        while not self.stopping:
            self.serve(self.wait, poll=POLL_AT_REST)
            # A report may be older than the last answer, and between an answer and the motion GRBL
            # is Idle for a moment. So the second report counts.
            if link.reports > last:
                last = link.reports
                reports = reports + 1 if self.status.state in REST_STATES else 0
                if reports == 1:
                    self.rested_at = link.status_at
                if reports == 2:
                    return

    def settle(self) -> None:
        """Wait until the machine rests at the end of its lines.

        Raises:
            BoardError: ``position-differs`` where it rests elsewhere.
        """
        self.rest()
        if self.stopping:
            return
        tracker = self.monitor.tracker
        if tracker.arrived(self.position):
            # A single report may be wrong.
            self.link.refresh()
            off = tracker.arrived(self.position)
            if off:
                line = self.link.protocol.confirmed_line
                raise self.stopped_by(faults.elsewhere(self.position, off, line))
        tracker.begin(self.position)

    def serve(self, timeout: float, *, poll: float | None = None) -> None:
        """Receive for at most ``timeout`` s, and serve the operator's requests.

        Args:
            timeout: s.
            poll: Seconds between two ``?``; None for the usual interval.

        Raises:
            BoardError: Every fault that is found.
        """
        link = self.link
        try:
            events = link.pump(timeout) if poll is None else link.pump(timeout, poll)
        except PortLost as error:
            raise self._port_lost(error) from error
        except BoardError as error:
            link.drop()
            self.state = "stopped"
            raise self.at_confirmed(error) from error
        now = link.listened
        confirmed = 0
        for event in events:
            if type(event) is Confirmed:
                confirmed += event.count
                self.monitor.liveness.answered(now, event.count)
            else:
                self.receive(event, now)
        # A board that answers is alive.
        if not confirmed:
            self._check_liveness(now)
        requests = self._requests
        if requests is not None and not self._control.stopped and self.state == "running":
            data = requests.commands(self.status, link.status_listened, now)
            if data:
                self.write(data)

    def receive(self, event: Event, now: float) -> None:
        """Take in an event of the board other than Confirmed; BoardError for a fault.

        Args:
            event: The event.
            now: Time of listening, s: the same for all events that were read together.
        """
        if isinstance(event, Feedback) and event.kind == "PRB":
            self.probed = self._contact(event.text)
        fault = self.monitor.fault_in(event, now)
        if fault is not None:
            raise self.stopped_by(fault)
        if isinstance(event, Reported):
            if self.monitor.doubtful:
                self.link.poll_now()
            if self._on_report is not None:
                self._on_report()

    def write(self, data: bytes) -> None:
        """Write bytes at once; BoardError ``port-lost``."""
        try:
            self.link.write(data)
        except PortLost as error:
            raise self._port_lost(error) from error

    def end_check_mode(self) -> None:
        """Leave the check mode of the board by a reset."""
        self.write(self.link.protocol.reset())
        self.link.until(lambda event: isinstance(event, Started), ANSWER)

    def stopped_by(self, fault: BoardError) -> BoardError:
        """Stop the machine, and return the fault to raise."""
        if self.state != "running":
            return fault
        second = self.link.halt()
        self.state = "stopped"
        return fault if second is None else faults.followed_by(fault, second)

    def at_confirmed(self, error: BoardError) -> BoardError:
        """Return a fault of the link with the last line that the board has confirmed."""
        line = self.link.protocol.confirmed_line
        finding = error.diagnostic
        last = (
            f"; the last line that the board confirmed is {line}"
            if line
            else "; the board had confirmed no line yet"
        )
        return type(error)(
            Diagnostic(finding.code, finding.message + last, line=line, hint=finding.hint)
        )

    def _port_lost(self, error: PortLost) -> BoardError:
        """Return the fault of a lost connection, which ends the run."""
        self.state = "stopped"
        return self.at_confirmed(error)

    def _check_liveness(self, now: float) -> None:
        protocol = self.link.protocol
        if protocol.waiting and self.monitor.liveness.answer_due(now) and protocol.mark_fits():
            self._mark()
        fault = self.monitor.missing_answer(now)
        if fault is not None:
            raise self.stopped_by(fault)

    def _set_first_override(self) -> None:
        """Set the operator's first overrides before anything moves; a board begins with 100."""
        requests, link = self._requests, self.link
        if requests is None or requests.reached(UNCHANGED):
            return
        deadline = link.listened + OVERRIDE_PATIENCE
        wanted = requests.control.feed_override
        while wanted >= MIN_OVERRIDE and link.listened < deadline and not self.stopping:
            self.serve(self.wait, poll=POLL_AT_REST)
            if requests.reached(self.status):
                return
            wanted = requests.control.feed_override
        if not self.stopping:
            message = f"the board does not accept a feed override of {wanted:g} %"
            hint = f"GRBL accepts {MIN_OVERRIDE} to 200 %; scale the feeds of the program instead"
            raise self.stopped_by(board_error("override-refused", message, hint=hint))

    def end_overrides(self) -> None:
        """Set the overrides of this run back, for what comes next at the board."""
        link = self.link
        if self.status.overrides in (None, UNCHANGED.overrides):
            return
        for _ in range(RESTORED):
            self.write(WITHOUT_OVERRIDES)
            link.poll_now()
            if link.until(
                lambda event: (
                    isinstance(event, Reported) and event.status.overrides == UNCHANGED.overrides
                ),
                OVERRIDE_ANSWER,
            ):
                return
        log.warning("%s: the overrides stay at %s", link.name, self.status.overrides)

    def _mark(self) -> None:
        self._marked_at = self.link.now()
        self.monitor.liveness.marked(self.link.listened)
        self.link.queued += self.link.protocol.mark()

    def _contact(self, text: str) -> tuple[float, ...] | None:
        """Return position (mm) and contact (1 or 0) of a probe report ``1.000,2.000,-3.000:1``."""
        place, _, touched = text.partition(":")
        try:
            info, numbers = self.link.info, [float(value) for value in place.split(",")]
            return (*in_mm(numbers, info.unit, info.rotary), float(touched))
        except ValueError:
            return None
