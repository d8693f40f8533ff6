"""Events of an operator session, and their distribution to any number of listeners.

Every event is a frozen record. :func:`as_object` gives its JSON form: the fields, ``event`` (the
kind) and ``time`` (seconds since 1970). Positions are in mm (degrees), feeds in mm/min, speeds of
the spindle in rev/min.

A listener is called in the thread that makes the event, so it must return at once.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, ClassVar, Literal

from cnc.boards.protocols import Condition
from cnc.model.diagnostics import Diagnostic, Severity

Activity = Literal[
    "none",
    "connect",
    "home",
    "jog",
    "mdi",
    "measure",
    "program",
    "probe",
    "settings",
    "unlock",
    "zero",
]
"""What occupies the machine."""
MachineState = Literal["disconnected", Condition]
Outcome = Literal["done", "stopped", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Overrides:
    """Overrides, per cent."""

    feed: float = 100.0
    rapid: float = 100.0
    spindle: float = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """State of the machine, ten times a second.

    Attributes:
        board: Name of the board; "" while none is connected.
        state: State of the machine.
        activity: What occupies it.
        machine: Machine position by axis, mm.
        work: Work position by axis, mm, in the coordinate system ``system``.
        system: Coordinate system of ``work``, such as G54.
        zero: Machine position of its zero by axis, mm.
        rotation: Degrees by which its X and Y are turned.
        homed: Whether the position of each axis is known; empty for a machine without homing.
        feed: Reported feed, mm/min; None if the board does not report it.
        spindle: Reported or commanded speed, rev/min; None if it is not known.
        tool: Number of the tool in the spindle; None if it is not known.
        program: Name of the program that runs, else "".
        line: Source line of the motion, 0 without one.
        text: Text of that line.
        run_time: Machine time of the motion since the program's start, s.
        left: Time until the end of the program, s; None if it is not known.
        buffered: Lines, or milliseconds of motion, that the board still holds; None if not known.
        overrides: The overrides that the board reports; else those requested.
        pending: Time until the requested feed override takes effect at the latest, s; 0 if it has.
        inputs: Inputs of the board and whether each is active: limits, probe, door.
        held: Why the machine holds; "" if it does not.
        modes: Modes that the next entered line begins with; "" for the defaults of a program.
    """

    event: ClassVar[str] = "state"
    board: str = ""
    state: MachineState = "disconnected"
    activity: Activity = "none"
    machine: dict[str, float] = field(default_factory=dict)
    work: dict[str, float] = field(default_factory=dict)
    system: str = "G54"
    zero: dict[str, float] = field(default_factory=dict)
    rotation: float = 0.0
    homed: dict[str, bool] = field(default_factory=dict)
    feed: float | None = None
    spindle: float | None = None
    tool: int | None = None
    program: str = ""
    line: int = 0
    text: str = ""
    run_time: float = 0.0
    left: float | None = None
    buffered: int | None = None
    overrides: Overrides = Overrides()
    pending: float = 0.0
    inputs: dict[str, bool] = field(default_factory=dict)
    held: str = ""
    modes: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialog:
    """A question to the operator; the machine waits for the answer.

    Attributes:
        id: Number of the question, for the answer.
        kind: tool: put in a tool (M6). stop: the program stops here (M0). restart: begin in the
            middle of a program. door: the safety door. reading: a number of a measurement, mm.
            todo: the operator does something for a measurement.
        text: The question; the last line of a reading says what is read.
        doubts: Warnings, for ``restart``; the text begins with their messages.
        steps: The steps to the start line, for ``restart``.
        approach: The places of these steps, mm: a number for each axis in the machine's order.
    """

    event: ClassVar[str] = "dialog"
    id: int
    kind: Literal["tool", "stop", "restart", "door", "reading", "todo"]
    text: str
    doubts: tuple[Finding, ...] = ()
    steps: tuple[str, ...] = ()
    approach: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class DialogClosed:
    """A question is answered, or no longer asked."""

    event: ClassVar[str] = "dialog-closed"
    id: int


@dataclass(frozen=True, slots=True, kw_only=True)
class JobProgress:
    """Progress of a check or a run.

    Attributes:
        program: Name of the program.
        stage: checking or running.
        line: Lines done in the check, or the line of the motion.
        lines: Last line with an effect; None while it is not known.
    """

    event: ClassVar[str] = "job-progress"
    program: str
    stage: Literal["checking", "running"]
    line: int
    lines: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class JobEnded:
    """End of a program, an MDI line or a macro.

    Attributes:
        program: Name of the program.
        outcome: done, stopped by the operator, or failed.
        seconds: Machine time, s.
        stopped_at_line: Line at which it was stopped; None otherwise.
        resume_line: Line at which it can continue; None if that is unknown.
        findings: Errors and warnings.
        exit_code: That of ``cncrun`` for such a run: 1 for the program, 3 for the board.
    """

    event: ClassVar[str] = "job-ended"
    program: str
    outcome: Outcome
    seconds: float = 0.0
    stopped_at_line: int | None = None
    resume_line: int | None = None
    findings: tuple[Finding, ...] = ()
    exit_code: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """A message with its place in the program; lines and columns from 1, 0 for none."""

    code: str
    message: str
    file: str = ""
    line: int = 0
    column: int = 0
    length: int = 1
    text: str = ""
    hint: str = ""
    severity: Severity = "error"

    @classmethod
    def of(cls, diagnostic: Diagnostic) -> Finding:
        """Return the finding of a diagnostic."""
        return cls(**{field.name: getattr(diagnostic, field.name) for field in fields(cls)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """A fault of the board, the link or a command, or an alarm of the machine."""

    event: ClassVar[str] = "alarm"
    finding: Finding


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """A note for the operator: a message of the program, a warning, the end of an activity."""

    event: ClassVar[str] = "notice"
    finding: Finding


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsoleLine:
    """A line on the link to the board."""

    event: ClassVar[str] = "console"
    direction: Literal["sent", "received"]
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetsChanged:
    """Offsets by name (G54 to G59.3, G92) and axis, mm, and rotations of systems, degrees."""

    event: ClassVar[str] = "offsets"
    offsets: dict[str, dict[str, float]]
    rotations: dict[str, float] = field(default_factory=dict)


Event = (
    State
    | Dialog
    | DialogClosed
    | JobProgress
    | JobEnded
    | Alarm
    | Notice
    | ConsoleLine
    | OffsetsChanged
)
Listener = Callable[[Event], None]


def as_object(event: Event, now: float | None = None) -> dict[str, Any]:
    """Return an event in its JSON form; ``now``: seconds since 1970, None for the present."""
    common = {"event": event.event, "time": round(time.time() if now is None else now, 3)}
    return common | {field.name: _plain(getattr(event, field.name)) for field in fields(event)}


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {part.name: _plain(getattr(value, part.name)) for part in fields(value)}
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    return value


class EventStream:
    """The events of a session, passed on to every listener in the order in which they occur."""

    def __init__(self) -> None:
        self._listeners: list[Listener] = []
        self._lock = threading.RLock()

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call ``listener`` with each event from now on.

        Returns:
            A function that ends this.
        """
        with self._lock:
            self._listeners = [*self._listeners, listener]

        def end() -> None:
            with self._lock:
                self._listeners = [each for each in self._listeners if each is not listener]

        return end

    def emit(self, event: Event) -> None:
        """Pass an event on to all listeners."""
        with self._lock:
            for listener in self._listeners:
                listener(event)

    def emit_present(self, present: Callable[[], Event]) -> None:
        """Pass on what is so now: no thread passes on an older state after it."""
        with self._lock:
            self.emit(present())
