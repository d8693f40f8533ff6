"""Sending of lines to a GRBL board, with its faults watched.

No wait is without a bound. At any fault the motion is stopped (hold, wait for rest, reset) before
the fault is raised, and nothing is sent any more.
"""

from __future__ import annotations

from collections.abc import Sequence

from cnc.boards.errors import board_error
from cnc.boards.grbl import faults
from cnc.boards.grbl.events import Confirmed, Event, Reported, Started
from cnc.boards.grbl.fault_monitor import FULL_OVERRIDE, FaultMonitor
from cnc.boards.grbl.line_kinds import Kind, bare
from cnc.boards.grbl.link import ANSWER, GrblLink
from cnc.boards.grbl.messages import Feedback
from cnc.boards.grbl.operator_requests import MIN_OVERRIDE, OperatorRequests
from cnc.boards.grbl.status import Status, in_mm
from cnc.boards.port import PortLost
from cnc.boards.protocols import OnReport
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.operator_control import Control
from cnc.model.streams import GcodeLine

WAIT = 0.05
"""Longest wait for the board, s, until the operator's requests are served."""
POLL_AT_REST = 0.05
"""Seconds between two ``?`` while the machine comes to rest."""
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
LONGEST_GATHERING = 0.02
"""Limit on that time, s."""
SHORTEST_GATHERING = 0.002
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
MARK_LINES = 20
MARK_TIME = 0.5
"""Lines and seconds from one mark to the next; whichever comes first."""
OVERRIDE_PATIENCE = 15.0
"""Seconds for the first override: each step of ten takes a report."""
UNCHANGED = Status("Idle", overrides=(FULL_OVERRIDE, FULL_OVERRIDE, FULL_OVERRIDE))
REST_STATES = ("Idle", "Alarm", "Check", "Sleep")


class LineStream:
    """The stream of lines of one board.

    Attributes:
        link: The link to the board.
        monitor: Finds faults in what the board reports.
        state: ``idle``, ``running`` or ``stopped``.
        probed: Contact position of the last probe in mm, and 1 or 0 for contact or none.
        rested_at: Time of the report that last showed the machine at rest, s.
        wait: Longest wait for the board, s, until the operator's requests are served.
    """

    def __init__(self, link: GrblLink) -> None:
        self.link = link
        self.monitor = FaultMonitor(link.protocol)
        self.state = "idle"
        self.probed: tuple[float, ...] | None = None
        self.rested_at = 0.0
        self._control = Control()
        self._requests: OperatorRequests | None = None
        self._on_report: OnReport | None = None
        self._marked_at = 0.0
        self._asked = False
        self._late = 0.0
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
        self.link.protocol.begin_program()
        self.monitor.begin(self.link.info, self.position, offset, self.link.now(), moves=moves)
        self._set_first_override()

    def send(self, line: GcodeLine, kind: Kind) -> bool:
        """Send a line as soon as there is space for it.

        Returns:
            Whether it was sent; not when the operator stops the run.

        Raises:
            BoardError: ``board-locked``, or any fault that is found meanwhile.
        """
        link, monitor, text = self.link, self.monitor, line.text
        protocol, liveness = link.protocol, monitor.liveness
        if kind in ("writer", "system"):
            self.rest()
        if self.stopping:
            return False
        if link.status is not None and link.status.state == "Alarm":
            self.refuse_if_locked(line, unless=bare(text)[:2] in ("$H", "$X"))
        while (
            protocol.waiting >= liveness.max_waiting
            or (monitor.moves and monitor.far_ahead(link.status))
            or not (data := protocol.offer(text, line.line, kind))
        ):
            self._await_answers()
            if self.stopping:
                return False
        if kind == "probe":
            self.probed = None
        now = link.now()
        monitor.sending(line, now)
        link.queue(data)
        if (
            protocol.unmarked >= MARK_LINES or now - self._marked_at > MARK_TIME
        ) and protocol.mark_fits():
            self._mark()
        if now >= link.poll_at:
            self.serve(0.0)
        return True

    def _await_answers(self) -> None:
        """Receive; where answers come fast, let some gather, which saves most of the CPU time.

        The board meanwhile reads the lines that wait in its buffer. A wire that brings lines more
        slowly than the board reads them is not left idle: no answers gather, and the first answer
        after a long move is served at once. A report makes answers late: behind it, more lines are
        answered than is known.
        """
        link, interval = self.link, self.monitor.liveness.interval
        protocol, wire = link.protocol, link.wire
        try:
            link.write_queued()
        except PortLost as error:
            raise self._port_lost(error) from error
        waiting, now = protocol.waiting, link.now()
        busy = wire.busy(now)
        on_one_line = wire.time_of(protocol.used) / max(waiting, 1)
        behind = self._asked
        self._asked = link.asked or protocol.marked
        behind = behind or self._asked
        # As long as the wire is busy, lines that are sent now would only wait for it.
        pause = busy - SPARE - self._late
        slow = interval > SLOWER_THAN_WIRE * on_one_line
        if slow and busy <= (waiting - FEW_ARRIVED) * on_one_line:
            part = BEHIND_REPORT * GATHERING if behind else GATHERING
            pause = max(pause, part * (waiting - 1) * interval)
        if behind and protocol.partial[:1] in (b"<", b"["):
            # No answer comes before the end of the message.
            pause = max(pause, wire.time_of(REPORT - len(protocol.partial)))
        if pause >= SHORTEST_GATHERING and interval < LONGEST_GATHERING:
            pause = min(pause, LONGEST_GATHERING)
            link.clock.sleep(pause)
            self._late += LATE_WEIGHT * (link.now() - now - pause - self._late)
        self.serve(self.wait)

    def refuse_if_locked(self, line: GcodeLine, *, unless: bool = False) -> None:
        """Raise BoardError ``board-locked`` while the board is in alarm."""
        if self.status.state == "Alarm" and not unless:
            raise self.stopped_by(faults.locked(line.line))

    def drain(self) -> None:
        """Wait until every line has been answered, or the operator stops the run."""
        while self.link.protocol.waiting and not self.stopping:
            self.serve(self.wait)

    def rest(self) -> None:
        """Wait until the machine rests with nothing to do, or the operator stops the run."""
        self.drain()
        link = self.link
        link.poll_now()
        began = link.now()
        reports = 0
        while not self.stopping:
            before = link.status_at
            self.serve(self.wait, poll=POLL_AT_REST)
            # A report may be older than the last answer, and between an answer and the motion GRBL
            # is Idle for a moment. So the second report counts.
            if link.status_at > before and link.status_at > began:
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
        now = link.now()
        confirmed = 0
        for event in events:
            # At the wire's full rate nearly all are answers, which cost least together.
            if type(event) is Confirmed:
                confirmed += event.count
                continue
            if confirmed:
                self.monitor.confirmed(confirmed, now)
                confirmed = 0
            self.receive(event, now)
        if confirmed:
            # A board that answers is alive.
            self.monitor.confirmed(confirmed, now)
        else:
            self._check_liveness(now)
        self._serve_operator()

    def receive(self, event: Event, now: float) -> None:
        """Take in an event of the board other than Confirmed; BoardError for a fault.

        Args:
            event: The event.
            now: Present time, s: the same for all events that were read together.
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
        found = error.diagnostic
        last = (
            f"; the last line that the board confirmed is {line}"
            if line
            else "; the board had confirmed no line yet"
        )
        return type(error)(Diagnostic(found.code, found.message + last, line=line, hint=found.hint))

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

    def _serve_operator(self) -> None:
        """Turn the operator's requests into real-time commands."""
        requests, link = self._requests, self.link
        if requests is not None and not self.stopping and self.state == "running":
            data = requests.commands(self.status, link.status_at, link.now())
            if data:
                self.write(data)

    def _set_first_override(self) -> None:
        """Set the operator's first overrides before anything moves; a board begins with 100."""
        requests, link = self._requests, self.link
        if requests is None or requests.reached(UNCHANGED):
            return
        deadline = link.now() + OVERRIDE_PATIENCE
        wanted = requests.control.feed_override
        while wanted >= MIN_OVERRIDE and link.now() < deadline and not self.stopping:
            self.serve(self.wait, poll=POLL_AT_REST)
            if requests.reached(self.status):
                return
            wanted = requests.control.feed_override
        if not self.stopping:
            message = f"the board does not accept a feed override of {wanted:g} %"
            hint = f"GRBL accepts {MIN_OVERRIDE} to 200 %; scale the feeds of the program instead"
            raise self.stopped_by(board_error("override-refused", message, hint=hint))

    def _mark(self) -> None:
        self._marked_at = self.link.now()
        self.monitor.liveness.marked(self._marked_at)
        self.link.queue(self.link.protocol.mark())

    def _contact(self, text: str) -> tuple[float, ...] | None:
        """Return position (mm) and contact (1 or 0) of a probe report ``1.000,2.000,-3.000:1``."""
        place, _, touched = text.partition(":")
        try:
            info, numbers = self.link.info, [float(value) for value in place.split(",")]
            return (*in_mm(numbers, info.unit, info.rotary), float(touched))
        except ValueError:
            return None
