"""The last measurement of the console: under way, or its result until the next one."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from cnc.boards.registry import board_factory
from cnc.measure.limits import UNITS, Raised
from cnc.measure.machine_file import Change
from cnc.measure.procedures import Measured
from cnc.measure.ringing import of_record, record_of
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.operate.remote_session import SessionAccess

Kind = Literal["backlash", "pitch", "square", "limits", "ringing"]
Row = dict[str, Any]
SIMULATED = "the board is simulated, so the limits of the machine file stay"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What was measured.

    Attributes:
        title: What, and its value.
        remark: How.
        bars: The picture: ``name``, ``before``, ``after`` (mm), ``before_part``, ``after_part``.
        trials: Of the limits: ``name``, ``value``, ``unit``, ``error`` (mm; None where the axis ran
            into its switch), ``lost``.
        modes: Of a record: ``axis``, ``frequency`` (Hz), ``damping``, ``share``.
        steps: What the machine file would get.
        refusal: Why it cannot be written here; "" where it can.
        file: The machine file.
        written: Whether it is written.
    """

    title: str
    remark: str = ""
    bars: list[Row] = field(default_factory=list)
    trials: list[Row] = field(default_factory=list)
    modes: list[Row] = field(default_factory=list)
    steps: list[str] = field(default_factory=list)
    refusal: str = ""
    file: str = ""
    written: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """A measurement.

    Attributes:
        number: Its number; 0 before the first one.
        kind: What is measured.
        running: Whether it is under way.
        result: Its result; None where it has none (yet).
    """

    number: int = 0
    kind: Kind = "backlash"
    running: bool = False
    result: Result | None = None


class LastMeasurement:
    """The last measurement.

    Args:
        session: The session of the machine.
        publish: Tells the clients an event.

    Attributes:
        shown: The measurement, replaced as a whole.
    """

    def __init__(self, session: SessionAccess, publish: Callable[[dict[str, Any]], None]) -> None:
        self._session, self._publish = session, publish
        self._numbers = itertools.count(1)
        self._change: tuple[int, Change] | None = None
        self.shown = Measurement()

    def begun(self, kind: Kind, future: Future[Measured | None] | Future[Raised]) -> None:
        """Show a measurement that is under way, and its result at the end."""
        number, board = next(self._numbers), self._session.state.board
        self._show(Measurement(number=number, kind=kind, running=True))

        def ended(done: Future[Any]) -> None:
            result = None
            if not done.cancelled() and done.exception() is None and done.result() is not None:
                result = self._result(number, board, done.result())
            self._show(Measurement(number=number, kind=kind, result=result))

        future.add_done_callback(ended)

    def find_modes(self, text: str, name: str) -> None:
        """Show the modes of a record. UsageError ``record-form``, ``machine-busy``."""
        if self.shown.running:
            message, hint = "a measurement is under way", "wait for its end, or stop it"
            raise UsageError(Diagnostic("machine-busy", message, hint=hint))
        measured = of_record(record_of(text, name), name)
        number = next(self._numbers)
        result = self._result(number, self._session.state.board, measured)
        self._show(Measurement(number=number, kind="ringing", result=result))

    def write(self, number: int) -> None:
        """Write the result of a measurement into the machine file.

        Raises:
            UsageError: ``measurement-gone`` for another one than the last; ``can-not-write``,
                ``machine-file-form``.
            MachineFileError: The new text describes no machine.
        """
        change, shown = self._change, self.shown
        if change is None or change[0] != number or shown.number != number or not shown.result:
            message = "this result is no longer the last one, or it cannot be written"
            hint = "look at the result that is shown now"
            raise UsageError(Diagnostic("measurement-gone", message, hint=hint))
        change[1].write()
        self._show(replace(shown, result=replace(shown.result, written=True)))

    def discard(self) -> None:
        """Forget the result."""
        if not self.shown.running:
            self._show(Measurement(number=next(self._numbers), kind=self.shown.kind))

    def _result(self, number: int, board: str, found: Measured | Raised) -> Result:
        """Return a result, and keep its change of the machine file."""
        raised = found if isinstance(found, Raised) else None
        measured = found.measured if isinstance(found, Raised) else found
        change = Change.of(measured, self._session.machine)
        refusal = change.refusal
        if raised is not None and board_factory(board).traits.simulated:
            refusal = SIMULATED
        if not refusal:
            self._change = number, change
        return Result(
            title=measured.title,
            remark=measured.remark,
            bars=[bar._asdict() for bar in measured.bars],
            modes=[mode._asdict() for mode in measured.modes],
            trials=[] if raised is None else _trials(raised),
            steps=change.steps,
            refusal=refusal,
            file=str(change.file),
        )

    def _show(self, measurement: Measurement) -> None:
        self.shown = measurement
        self._publish({"event": "measurement", "time": time.time(), "number": measurement.number})


def _trials(raised: Raised) -> list[Row]:
    return [
        {
            "name": trial.name,
            "value": trial.value,
            "unit": UNITS[trial.name],
            "error": trial.error if math.isfinite(trial.error) else None,
            "lost": abs(trial.error) > raised.allowed,
        }
        for trial in raised.trials
    ]
