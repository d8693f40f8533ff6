"""The summary on the terminal: time, path length, extents and use of the limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cnc.model.blocks import ROTARY_LETTERS
from cnc.report.number_format import clock, number, position, spaced
from cnc.report.result import (
    AXIS_LIMIT_NAMES,
    LIMIT_NAMES,
    UNITS,
    AssumedOffset,
    Extremes,
    Report,
)

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

_TITLES = {
    "feed": "feed",
    "accel": "acceleration",
    "jerk": "jerk",
    "normal_accel": "normal acceleration",
    "chord_error": "chord error",
    "step_deviation": "step deviation",
}


def verdict(report: Report) -> str:
    """Return the result in one line."""
    if report.stopped_at_line is not None:
        return f"stopped by the operator at line {report.stopped_at_line}"
    if not report.ok:
        count = len(report.faults) + report.hidden_faults
        return f"{count} error{'s' if count > 1 else ''}"
    if report.board is None:
        return "ok, checked, nothing moved"
    if report.check_only:
        return f"ok, read by the board '{report.board}', nothing moved"
    return f"ok, run on the board '{report.board}'"


def one_line(report: Report) -> str:
    """Return program and result in one line, for a list of many programs."""
    result = (
        f"ok, {clock(report.duration_s)}, {number(report.path_length_mm)} mm"
        if report.ok
        else verdict(report)
    )
    return f"{report.program}: {result}"


def print_summary(report: Report, console: Console, *, verbose: bool = False) -> None:
    """Print a report as tables.

    Args:
        report: the result of a check or a run.
        console: the terminal.
        verbose: also print the dynamics of each axis and the computing times.
    """
    from rich.markup import escape
    from rich.table import Table

    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="bold", no_wrap=True)
    facts.add_column(overflow="fold")
    facts.add_row(
        "program",
        f"{escape(report.program)}  ({spaced(report.lines)} lines, {spaced(report.blocks)} blocks)",
    )
    facts.add_row("machine", escape(report.machine.name))
    facts.add_row("dialect", escape(_dialect(report, verbose)))
    if report.assumed:
        facts.add_row("assumed", escape(report.assumed))
    facts.add_row("result", ("[green]" if report.ok else "[red]") + escape(verdict(report)))
    if report.offset is not None:
        facts.add_row("offset", _offset(report.offset))
    facts.add_row("time", _time(report))
    facts.add_row("path length", f"{number(report.path_length_mm)} mm")
    if report.pulse_error_blu is not None:
        facts.add_row(
            "grid",
            f"{spaced(report.pulse_rows)} grid moves, "
            f"at most {report.pulse_error_blu:.4f} BLU from the path",
        )
    if (warped := report.height_map) is not None:
        facts.add_row(
            "height map",
            f"{escape(warped.file)}: {warped.columns} x {warped.rows} points, "
            f"{position(warped.lowest_mm)} to {position(warped.highest_mm)} mm, "
            f"{warped.interpolation}; {spaced(warped.pieces)} pieces "
            f"within {number(warped.tolerance_mm)} mm",
        )
    if report.cut is not None:
        facts.add_row(
            "stock",
            f"{number(report.cut.removed_mm3 / 1000.0)} cm³ removed, "
            f"simulated in cells of {number(report.cut.resolution_mm)} mm",
        )
    exceeded = ", ".join(f"{name} {count}" for name, count in report.violations.items() if count)
    facts.add_row("violations", exceeded or "none")
    console.print(facts)
    console.print(_axes(report, verbose))
    console.print(_limits(report))
    if verbose:
        timing = report.timing
        console.print(
            f"computed in {timing.total_s:.3f} s: reading {timing.parse_s:.3f}, "
            f"planning {timing.plan_s:.3f}, interpolating {timing.interpolate_s:.3f}"
        )


def _time(report: Report) -> str:
    """Return the measured time of a run with the computed one, else the computed one."""
    computed = clock(report.duration_s)
    return (
        computed if report.played_s is None else f"{clock(report.played_s)} (computed {computed})"
    )


def _offset(offset: AssumedOffset) -> str:
    """Return the work offset of a check, and where it comes from."""
    place = " ".join(f"{axis.upper()}{position(value)}" for axis, value in offset.g54.items())
    source = (
        "of the board, at the end of its last run"
        if offset.kept
        else "assumed; that of the board is not known"
    )
    return f"G54 {place} ({source})"


def _dialect(report: Report, verbose: bool) -> str:
    """Return the dialect, and how it was found."""
    if not report.recognition:
        return report.dialect
    if verbose:
        return report.recognition
    return report.dialect if report.dialect == "auto" else f"{report.dialect} (recognised)"


def _axes(report: Report, verbose: bool) -> RenderableType:
    """Return a table with extent, end position and steps of each axis."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    columns = ["axis", "from", "to", "travel", "ends at", "steps"]
    for name in columns + ([f"{each} (limit)" for each in AXIS_LIMIT_NAMES] if verbose else []):
        table.add_column(name, justify="left" if name == "axis" else "right", no_wrap=True)
    for letter, axis in report.machine.axes.items():
        box = report.bounding_box.get(letter)
        row = [letter.upper()]
        row += [position(box[0]), position(box[1])] if box else ["-", "-"]
        row += [f"{number(axis.travel[0])} .. {number(axis.travel[1])}" if axis.travel else "-"]
        row += [position(report.end_position[letter]) if letter in report.end_position else "-"]
        row += [spaced(report.steps[letter]) if letter in report.steps else "-"]
        if verbose:
            largest, limits = (
                report.largest.axes.get(letter, {}),
                report.limits.axes.get(letter, {}),
            )
            row += [
                f"{number(largest.get(name))} ({number(limits.get(name))})"
                for name in AXIS_LIMIT_NAMES
            ]
        table.add_row(*row)
    return table


def _limits(report: Report) -> RenderableType:
    """Return a table of the largest values along the path and their limits.

    Of velocity, acceleration and jerk it has the axis that used most of its limit.
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    # The board makes its own ramps, which our model of its planner follows.
    title = "along the path, as computed" if report.planned_by_board else "along the path"
    for name in (title, "largest", "limit", "", "used"):
        table.add_column(name, justify="left" if name in (title, "") else "right", no_wrap=True)
    for name in LIMIT_NAMES:
        largest, limit = getattr(report.largest, name), getattr(report.limits, name)
        if largest is not None:
            # The limit of feeds does not apply to traverses.
            faster = name == "feed" and limit and largest > limit and not report.violations[name]
            used = "traverse" if faster else _share(largest, limit)
            table.add_row(_TITLES[name], number(largest), number(limit), UNITS[name], used)
    for name in AXIS_LIMIT_NAMES:
        nearest = _nearest(report.largest, report.limits, name)
        if nearest is not None:
            letter, largest, limit = nearest
            unit = UNITS[name]
            if letter in ROTARY_LETTERS and letter in report.machine.axes:
                unit = unit.replace("mm", "°")
            table.add_row(
                f"{name} of {letter.upper()}",
                number(largest),
                number(limit),
                unit,
                _share(largest, limit),
            )
    return table


def _share(largest: float, limit: float | None) -> str:
    return f"{100.0 * largest / limit:.0f} %" if limit else ""


def _nearest(largest: Extremes, limits: Extremes, name: str) -> tuple[str, float, float] | None:
    """Return axis, largest value and limit of the axis that used most of its limit."""
    found = [
        (value / limit, letter, value, limit)
        for letter, values in largest.axes.items()
        if (value := values.get(name)) is not None
        and (limit := limits.axes.get(letter, {}).get(name))
    ]
    return max(found)[1:] if found else None
