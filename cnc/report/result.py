"""Result of a check or a run: the values behind the summary and the JSON file."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from types import ModuleType
from typing import Any

from cnc.machine.models import Machine
from cnc.model.diagnostics import EXIT_REJECTED, CncError, Diagnostic
from cnc.model.units import decimal_text

# Numbers, times and coordinates as text for people.


def clock(seconds: float) -> str:
    """Return seconds as h:mm:ss; below a minute as seconds with milliseconds."""
    if seconds < 60.0 and round(seconds, 3) < 60.0:
        return f"{seconds:.3f} s"
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def number(value: float | None) -> str:
    """Return a number with about six digits, with spaces from 10 000 on; a dash for None."""
    if value is None:
        return "-"
    if abs(value) >= 1e4:
        return spaced(round(value))
    if value != 0 and abs(value) < 1e-3:
        return f"{value:.3g}"
    return f"{value:.6g}"


def spaced(count: int) -> str:
    """Return a whole number; from 10 000 on with spaces between the thousands."""
    return f"{count:,}".replace(",", " ") if abs(count) >= 10_000 else str(count)


def position(value: float) -> str:
    """Return a coordinate in mm to 0.1 micrometres."""
    return decimal_text(value, 4)


# Differences between a program's baseline and its present check.


@dataclass(frozen=True, slots=True)
class Changes:
    """Differences of one program.

    Attributes:
        known: whether the baseline has the program. If not, every finding is new.
        new: findings that the baseline lacks.
        kept: findings that the baseline has as well.
        gone: findings of the baseline that have disappeared.
        figures: (then, now) of ``duration_s`` and ``path_length_mm`` where they differ.
        box: (then, now) extent in mm of each axis with another one; None where it did not move.
    """

    known: bool
    new: list[Diagnostic]
    kept: list[Diagnostic]
    gone: list[Diagnostic]
    figures: dict[str, tuple[float, float]]
    box: dict[str, tuple[list[float] | None, list[float] | None]]

    def lines(self) -> list[str]:
        """Return the differences as lines of text; none if nothing changed."""
        if not self.known:
            return ["not in the baseline"]
        lines = []
        for name, (then, now) in self.figures.items():
            share = f" ({100.0 * (now - then) / then:+.1f} %)" if then else ""
            if name == "duration_s":
                lines.append(f"time: {clock(then)} -> {clock(now)}{share}")
            else:
                lines.append(f"path length: {number(then)} -> {number(now)} mm{share}")
        for axis, pair in self.box.items():
            ends = [" .. ".join(map(position, entry)) if entry else "none" for entry in pair]
            lines.append(f"{axis.upper()}: {ends[0]} -> {ends[1]}")
        for word, findings in ("new", self.new), ("gone", self.gone):
            lines += [
                f"{word}: {entry.severity} {entry.line or '-'}: {entry.code}: {entry.message}"
                for entry in findings
            ]
        return lines

    def as_model(self) -> Any:
        """Return the differences as a part of the summary."""
        models = _models()
        figures: dict[str, Any] = {name: list(pair) for name, pair in self.figures.items()}
        return models.Changes.model_construct(
            known=self.known,
            new=[models.finding_of(finding) for finding in self.new],
            gone=[models.finding_of(finding) for finding in self.gone],
            **figures,
            bounding_box={axis: list(pair) for axis, pair in self.box.items()},
        )


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
    """Largest values along the path, or the limits of them.

    None stands for a value that was not measured, or that nothing limits.

    Attributes:
        feed: mm/s.
        accel: tangential acceleration, mm/s^2.
        jerk: tangential jerk, mm/s^3.
        normal_accel: normal acceleration, mm/s^2.
        chord_error: mm.
        step_deviation: relative difference between a sampled step and the commanded step.
        axes: ``velocity`` mm/s, ``acceleration`` mm/s^2 and ``jerk`` mm/s^3 by axis.
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
        """Return the limits of a machine file."""
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
                for letter, axis in machine.joint_tables.items()
            },
        )


@dataclass(slots=True)
class Timing:
    """Computing time in seconds; the total includes checks and output."""

    parse_s: float = 0.0
    plan_s: float = 0.0
    interpolate_s: float = 0.0
    total_s: float = 0.0


@dataclass(frozen=True, slots=True)
class AssumedOffset:
    """The work offset with which a program for a GRBL board was checked.

    Attributes:
        kept: Whether it is that of the last run on the board; else it is an assumption.
        g54: G54 by axis, mm.
    """

    kept: bool
    g54: dict[str, float]


@dataclass(frozen=True, slots=True)
class Cut:
    """The simulated cut of a check.

    Attributes:
        resolution_mm: width of a cell of the stock, mm.
        removed_mm3: volume that the program removes from the stock, mm^3.
    """

    resolution_mm: float
    removed_mm3: float


@dataclass(frozen=True, slots=True)
class WarpedBy:
    """The height map that warps a program.

    Attributes:
        file: its file.
        columns: points along X.
        rows: points along Y.
        lowest_mm: lowest point, mm.
        highest_mm: highest point, mm.
        interpolation: bilinear or bicubic.
        tolerance_mm: largest distance of the pieces from the warped path, mm.
        pieces: straight pieces of the warped path.
    """

    file: str
    columns: int
    rows: int
    lowest_mm: float
    highest_mm: float
    interpolation: str
    tolerance_mm: float
    pieces: int


@dataclass(slots=True)
class Report:
    """The result for one program.

    Attributes:
        program: name of the program.
        machine: the machine that it was checked for or run on.
        faults: errors that ended it, in order.
        warnings: warnings and notes.
        hidden_faults: faults that are only counted.
        hidden_warnings: warnings and notes that are only counted.
        board: name of the board; None after a check.
        dialect: dialect that the program was read in.
        recognition: the dialect with the evidence for it; empty if the user chose it.
        assumed: what the reading of the program assumes; empty for nothing.
        lines: source lines that were read.
        blocks: canonical blocks; each move of a run of lines counts.
        check_only: whether the board has only read the program.
        planned_by_board: whether the board plans its motion, so that the values along the path are
            those of a model of its planner.
        offset: the work offset of a check for a GRBL board; None otherwise.
        cut: the simulated cut; None without a stock.
        height_map: the height map that warps the program; None without one.
        duration_s: machine time with dwells, as computed.
        played_s: measured time of a run on a board that plans its motion; None without one.
        path_length_mm: length of the path.
        bounding_box: (smallest, largest) position of the whole path by axis, mm.
        end_position: last position by axis, mm.
        largest: largest values that occurred.
        limits: limits of the machine.
        violations: number of samples beyond each limit.
        steps: steps by axis, both directions together.
        pulse_rows: number of grid moves.
        pulse_error_blu: largest distance of a grid point from the path in steps (BLU).
        timing: computing time.
        stopped_at_line: line at which the operator stopped the run; None otherwise.
        resume_line: line at which an unfinished run can continue; None if unknown.
        changes: differences to the baseline; None without one.
    """

    program: str
    machine: Machine
    faults: list[CncError] = field(default_factory=list)
    warnings: list[Diagnostic] = field(default_factory=list)
    hidden_faults: int = 0
    hidden_warnings: int = 0
    board: str | None = None
    dialect: str = ""
    recognition: str = ""
    assumed: str = ""
    lines: int = 0
    blocks: int = 0
    check_only: bool = False
    planned_by_board: bool = False
    offset: AssumedOffset | None = None
    cut: Cut | None = None
    height_map: WarpedBy | None = None
    duration_s: float = 0.0
    played_s: float | None = None
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
        """Give each limit a count of violations."""
        names = [
            *LIMIT_NAMES,
            *(
                f"{name}_{joint}"
                for joint in self.machine.joint_tables
                for name in AXIS_LIMIT_NAMES
            ),
        ]
        self.violations = dict.fromkeys(names, 0) | self.violations

    @property
    def ok(self) -> bool:
        """Whether there is no fault of the program, the machine file or the board."""
        return not self.faults

    @property
    def exit_code(self) -> int:
        """Exit code of the command line. With a baseline only new faults count."""
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
        """The findings that decide how a check ends: with a baseline only the new ones."""
        return self.findings if self.changes is None else self.changes.new

    @property
    def counting_faults(self) -> list[CncError]:
        """The faults that decide how a check ends."""
        if self.changes is None:
            return self.faults
        new = {id(finding) for finding in self.changes.new}
        return [fault for fault in self.faults if id(fault.diagnostic) in new]

    def raise_if_faulty(self) -> None:
        """Raise the first fault, if there is one."""
        if self.faults:
            raise self.faults[0]

    def as_json(self) -> dict[str, Any]:
        """Return the summary in the form of the public JSON file."""
        models = _models()
        optional: dict[str, Any] = {}
        if self.assumed:
            optional["assumed"] = self.assumed
        if self.played_s is not None:
            optional["played_s"] = self.played_s
        if self.cut is not None:
            optional["stock"] = models.Stock.model_construct(**asdict(self.cut))
        if self.height_map is not None:
            optional["height_map"] = models.WarpedBy.model_construct(**asdict(self.height_map))
        if self.changes is not None:
            optional["changes"] = self.changes.as_model()
        total = self.timing.total_s
        summary = models.Summary.model_construct(
            program=self.program,
            machine=self.machine.name,
            dialect=self.dialect,
            ok=self.ok,
            lines=self.lines,
            blocks=self.blocks,
            errors=[
                models.finding_of(
                    entry, column=entry.column, hint=entry.hint, **models.fix_of(entry)
                )
                for entry in self.findings
            ],
            duration_s=self.duration_s,
            path_length_mm=self.path_length_mm,
            travel_checked=self.machine.has_travel,
            bounding_box={axis: list(box) for axis, box in self.bounding_box.items()},
            end_position=self.end_position,
            max=models.PathDynamics.model_construct(**asdict(self.largest)),
            limits=models.PathDynamics.model_construct(**asdict(self.limits)),
            violations=self.violations,
            steps=self.steps,
            pulse_error_blu=self.pulse_error_blu,
            stopped_at_line=self.stopped_at_line,
            timing=models.Timing.model_construct(**asdict(self.timing)),
            lines_per_s=self.lines / total if total else 0.0,
            steps_per_s=sum(self.steps.values()) / total if total else 0.0,
            **optional,
        )
        keys: dict[str, Any] = summary.as_json()
        return keys


def _models() -> ModuleType:
    from cnc.report import models  # most runs write no JSON, and the models take a while to build

    return models
