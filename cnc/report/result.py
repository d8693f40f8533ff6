"""What is known of a program after it was checked or run: the numbers behind the summary and the
JSON file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from cnc.machine.models import Machine
from cnc.model.diagnostics import EXIT_REJECTED, CncError, Diagnostic
from cnc.report.changes import Changes

LIMIT_NAMES = ("feed", "accel", "jerk", "normal_accel", "chord_error", "step_deviation")
AXIS_LIMIT_NAMES = ("velocity", "acceleration", "jerk")

UNITS = {
    "feed": "mm/s",
    "accel": "mm/s²",
    "jerk": "mm/s³",
    "normal_accel": "mm/s²",
    "chord_error": "mm",
    "step_deviation": "",
    "velocity": "mm/s",
    "acceleration": "mm/s²",
}


@dataclass(slots=True)
class Extremes:
    """Largest values along the path, or the limits of them; None where nothing was measured, or
    nothing limits.

    feed mm/s, accel (tangential) and normal_accel mm/s^2, jerk (tangential) mm/s^3, chord_error mm,
    step_deviation relative; ``axes``: velocity mm/s, acceleration mm/s^2, jerk mm/s^3 of each axis
    by its name.
    """

    feed: float | None = None
    accel: float | None = None
    jerk: float | None = None
    normal_accel: float | None = None
    chord_error: float | None = None
    step_deviation: float | None = None
    axes: dict[str, dict[str, float | None]] = field(default_factory=dict)

    @classmethod
    def limits(cls, machine: Machine) -> Extremes:
        """What a machine file allows."""
        path = machine.path
        return cls(
            feed=path.max_feed,
            accel=path.max_tangential_acceleration,
            jerk=path.max_jerk,
            normal_accel=path.max_normal_acceleration,
            chord_error=path.chord_error,
            step_deviation=path.step_deviation,
            axes={
                letter: {
                    "velocity": axis.max_velocity,
                    "acceleration": axis.max_acceleration,
                    "jerk": axis.max_jerk,
                }
                for letter, axis in machine.axes.items()
            },
        )

    def as_json(self) -> dict[str, Any]:
        """The path's values by name, and under ``axes`` the same for each axis."""
        return {name: getattr(self, name) for name in LIMIT_NAMES} | {"axes": self.axes}


@dataclass(slots=True)
class Timing:
    """Seconds of computing: reading the program (once), planning, interpolating, and all in all
    (with checking and writing).
    """

    parse_s: float = 0.0
    plan_s: float = 0.0
    interpolate_s: float = 0.0
    total_s: float = 0.0


@dataclass(slots=True)
class Report:
    """A program, checked or run.

    ``faults`` are the errors that ended it, in order; ``warnings`` did not; ``hidden_`` ones are
    counted only. lines: of the program as read. blocks: canonical blocks, each move of a run of
    lines counted. duration_s: machine time, dwells included. bounding_box: mm by axis, of the whole
    path. end_position: mm by axis. steps: by axis, both directions together. pulse_error_blu:
    largest distance of a grid point from the path, in BLU. stopped_at_line: where the operator
    stopped the run, None if nobody did. resume_line: where to go on with a run that did not come to
    its end, None where that is not known. changes: since an earlier check, None where there is
    nothing to compare with.
    """

    program: str
    machine: Machine
    faults: list[CncError] = field(default_factory=list)
    warnings: list[Diagnostic] = field(default_factory=list)
    hidden_faults: int = 0
    hidden_warnings: int = 0
    board: str | None = None
    lines: int = 0
    blocks: int = 0
    duration_s: float = 0.0
    path_length_mm: float = 0.0
    bounding_box: dict[str, tuple[float, float]] = field(default_factory=dict)
    end_position: dict[str, float] = field(default_factory=dict)
    largest: Extremes = field(default_factory=Extremes)
    limits: Extremes = field(default_factory=Extremes)
    violations: dict[str, int] = field(default_factory=dict)
    steps: dict[str, int] = field(default_factory=dict)
    pulse_rows: int = 0
    pulse_error_blu: float | None = None
    timing: Timing = field(default_factory=Timing)
    stopped_at_line: int | None = None
    resume_line: int | None = None
    changes: Changes | None = None

    def __post_init__(self) -> None:
        """Every limit has a count of violations from the start."""
        names = [
            *LIMIT_NAMES,
            *(f"{name}_{axis}" for axis in self.machine.axes for name in AXIS_LIMIT_NAMES),
        ]
        self.violations = dict.fromkeys(names, 0) | self.violations

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong with the program, the machine or the board."""
        return not self.faults

    @property
    def exit_code(self) -> int:
        """What a command line ends with for this report: beside an earlier check, new faults alone
        count.
        """
        codes = [fault.exit_code for fault in self.counting_faults]
        return (
            next((code for code in codes if code != EXIT_REJECTED), EXIT_REJECTED) if codes else 0
        )

    @property
    def findings(self) -> list[Diagnostic]:
        """The faults, then the warnings."""
        return [*(fault.diagnostic for fault in self.faults), *self.warnings]

    @property
    def counting(self) -> list[Diagnostic]:
        """The findings that decide how a check ends: beside an earlier check the new ones."""
        return self.findings if self.changes is None else self.changes.new

    @property
    def counting_faults(self) -> list[CncError]:
        """Those of the faults."""
        if self.changes is None:
            return self.faults
        new = {id(found) for found in self.changes.new}
        return [fault for fault in self.faults if id(fault.diagnostic) in new]

    def raise_if_faulty(self) -> None:
        """Raise the first fault, for callers who would rather not ask."""
        if self.faults:
            raise self.faults[0]

    def as_json(self) -> dict[str, Any]:
        """The summary in the shape of the public JSON file; numbers that don't exist are null."""
        timing, total = self.timing, self.timing.total_s
        return {
            "program": self.program,
            "machine": self.machine.name,
            "ok": self.ok,
            "lines": self.lines,
            "blocks": self.blocks,
            "errors": [_finding(each) for each in self.findings],
            "duration_s": self.duration_s,
            "path_length_mm": self.path_length_mm,
            "bounding_box": {axis: list(box) for axis, box in self.bounding_box.items()},
            "end_position": self.end_position,
            "max": self.largest.as_json(),
            "limits": self.limits.as_json(),
            "violations": self.violations,
            "steps": self.steps,
            "pulse_error_blu": self.pulse_error_blu,
            "stopped_at_line": self.stopped_at_line,
            "timing": {
                "parse_s": timing.parse_s,
                "plan_s": timing.plan_s,
                "interpolate_s": timing.interpolate_s,
                "total_s": total,
            },
            "lines_per_s": self.lines / total if total else 0.0,
            "steps_per_s": sum(self.steps.values()) / total if total else 0.0,
            **({} if self.changes is None else {"changes": self.changes.as_json()}),
        }


def _finding(diagnostic: Diagnostic) -> dict[str, Any]:
    return {
        "code": diagnostic.code,
        "message": diagnostic.message,
        "file": diagnostic.file,
        "line": diagnostic.line,
        "column": diagnostic.column,
        "severity": diagnostic.severity,
        "hint": diagnostic.hint,
    }
