"""The summary on the terminal: time, path length, extents and use of the limits."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Collection, Iterator, Sequence
from typing import Any, Literal, TextIO

from cnc.model.blocks import ROTARY_LETTERS
from cnc.model.diagnostics import printable, shown_json, shown_name
from cnc.report.result import (
    AXIS_LIMIT_NAMES,
    LIMIT_NAMES,
    UNITS,
    AssumedOffset,
    Extremes,
    Report,
    clock,
    number,
    position,
    spaced,
)
from cnc.report.targets import TextTarget

# Tables of text for a terminal or a file: aligned columns, and styles where they are shown.

GAP = "  "
"""Text between two columns."""
_CODES = {"bold": "1", "red": "31", "green": "32"}

Style = Literal["bold", "red", "green"]


def has_styles(stream: TextIO) -> bool:
    """Return whether a stream is a terminal that shows bold and coloured text.

    The console of Windows shows the codes of styles as text unless a program asks otherwise.
    """
    plain = os.environ.get("TERM") == "dumb" or bool(os.environ.get("NO_COLOR"))
    return stream.isatty() and sys.platform != "win32" and not plain


def styled(text: str, style: Style) -> str:
    """Return text with a style (SGR codes of ECMA-48, section 8.3.117)."""
    return f"\x1b[{_CODES[style]}m{text}\x1b[0m"


def aligned(rows: Sequence[Sequence[str]], *, right: Collection[int] = ()) -> list[list[str]]:
    """Return rows whose cells are as wide as their columns.

    Args:
        rows: cells of each row; all rows have as many.
        right: columns that are aligned at their right end.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        [
            cell.rjust(width) if index in right else cell.ljust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        for row in rows
    ]


def join(cells: Sequence[str]) -> str:
    """Return the cells of a row as a line."""
    return GAP.join(cells).rstrip()


TRAVEL_NOT_CHECKED = "not checked: the machine file gives none"
"""The statement on a machine without travel."""

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
    return f"{shown_name(report.program)}: {result}"


def print_summary(report: Report, stream: TextIO, *, verbose: bool = False) -> None:
    """Print a report as tables.

    Args:
        report: the result of a check or a run.
        stream: the terminal, or a file.
        verbose: also print the dynamics of each axis and the computing times.
    """
    terminal = has_styles(stream)
    lines = _fact_lines(report, terminal, verbose)
    for table in (_axes(report, verbose), _limits(report)):
        heading, *rows = table
        lines += [styled(heading, "bold") if terminal else heading, *rows]
    if verbose:
        timing = report.timing
        lines.append(
            f"computed in {timing.total_s:.3f} s: reading {timing.parse_s:.3f}, "
            f"planning {timing.plan_s:.3f}, interpolating {timing.interpolate_s:.3f}"
        )
    print(*lines, sep="\n", file=stream)


def _fact_lines(report: Report, terminal: bool, verbose: bool) -> list[str]:
    """Return a line for each fact; the names are bold, and the result is coloured."""
    facts = dict(_facts(report, verbose))
    width = max(map(len, facts))
    lines = []
    for name, text in facts.items():
        label, value = name.ljust(width), printable(text)
        if terminal:
            label = styled(label, "bold")
            if name == "result":
                value = styled(value, "green" if report.ok else "red")
        lines.append(join([label, value]))
    return lines


def _facts(report: Report, verbose: bool) -> Iterator[tuple[str, str]]:
    """Yield name and text of what the summary says about the whole program."""
    counts = f"{spaced(report.lines)} lines, {spaced(report.blocks)} blocks"
    yield "program", f"{report.program}  ({counts})"
    yield "machine", report.machine.name
    yield "dialect", _dialect(report, verbose)
    if report.assumed:
        yield "assumed", report.assumed
    yield "result", verdict(report)
    if not report.machine.has_travel:
        yield "travel", TRAVEL_NOT_CHECKED
    if report.offset is not None:
        yield "offset", _offset(report.offset)
    yield "time", _time(report)
    yield "path length", f"{number(report.path_length_mm)} mm"
    if report.pulse_error_blu is not None:
        yield (
            "grid",
            f"{spaced(report.pulse_rows)} grid moves, "
            f"at most {report.pulse_error_blu:.4f} BLU from the path",
        )
    if (warped := report.height_map) is not None:
        yield (
            "height map",
            f"{warped.file}: {warped.columns} x {warped.rows} points, "
            f"{position(warped.lowest_mm)} to {position(warped.highest_mm)} mm, "
            f"{warped.interpolation}; {spaced(warped.pieces)} pieces "
            f"within {number(warped.tolerance_mm)} mm",
        )
    if report.cut is not None:
        yield (
            "stock",
            f"{number(report.cut.removed_mm3 / 1000.0)} cm³ removed, "
            f"simulated in cells of {number(report.cut.resolution_mm)} mm",
        )
    exceeded = ", ".join(f"{name} {count}" for name, count in report.violations.items() if count)
    yield "violations", exceeded or "none"


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


def _axes(report: Report, verbose: bool) -> list[str]:
    """Return a table with extent, end position and steps of each axis; a heading comes first."""
    columns = ["axis", "from", "to", "travel", "ends at", "steps"]
    if verbose:
        columns += [f"{limit} (limit)" for limit in AXIS_LIMIT_NAMES]
    table = [columns]
    for letter, axis in report.machine.axes.items():
        box = report.bounding_box.get(letter)
        row = [letter.upper()]
        row += [position(box[0]), position(box[1])] if box else ["-", "-"]
        row += [f"{number(axis.travel[0])} .. {number(axis.travel[1])}" if axis.travel else "-"]
        row += [position(report.end_position[letter]) if letter in report.end_position else "-"]
        row += [spaced(report.steps[letter]) if letter in report.steps else "-"]
        if verbose:
            largest = report.largest.axes.get(letter, {})
            limits = report.limits.axes.get(letter, {})
            row += [
                f"{number(largest.get(name))} ({number(limits.get(name))})"
                for name in AXIS_LIMIT_NAMES
            ]
        table.append(row)
    return [join(row) for row in aligned(table, right=range(1, len(columns)))]


def _limits(report: Report) -> list[str]:
    """Return a table of the largest values along the path and their limits; a heading comes first.

    Of velocity, acceleration and jerk it has the axis that used most of its limit.
    """
    # The board makes its own ramps, which our model of its planner follows.
    title = "along the path, as computed" if report.planned_by_board else "along the path"
    table = [[title, "largest", "limit", "", "used"]]
    for name in LIMIT_NAMES:
        largest, limit = getattr(report.largest, name), getattr(report.limits, name)
        if largest is not None:
            # The limit of feeds does not apply to traverses.
            faster = name == "feed" and limit and largest > limit and not report.violations[name]
            used = "traverse" if faster else _share(largest, limit)
            table.append([_TITLES[name], number(largest), number(limit), UNITS[name], used])
    for name in AXIS_LIMIT_NAMES:
        nearest = _nearest(report.largest, report.limits, name)
        if nearest is not None:
            letter, largest, limit = nearest
            unit = UNITS[name]
            if letter in ROTARY_LETTERS and letter in report.machine.axes:
                unit = unit.replace("mm", "°")
            title = f"{name} of {letter.upper()}"
            table.append([title, number(largest), number(limit), unit, _share(largest, limit)])
    return [join(row) for row in aligned(table, right=(1, 2, 4))]


def _share(largest: float, limit: float | None) -> str:
    return f"{100.0 * largest / limit:.0f} %" if limit else ""


def _nearest(largest: Extremes, limits: Extremes, name: str) -> tuple[str, float, float] | None:
    """Return axis, largest value and limit of the axis that used most of its limit."""
    shares = [
        (value / limit, letter, value, limit)
        for letter, values in largest.axes.items()
        if (value := values.get(name)) is not None
        and (limit := limits.axes.get(letter, {}).get(name))
    ]
    return max(shares)[1:] if shares else None


# Summaries as JSON.


def write_json(name: str, summary: Report | Sequence[Report]) -> None:
    """Write the summary of a program, or a list of the summaries of several."""
    write_object(
        name,
        summary.as_json()
        if isinstance(summary, Report)
        else [report.as_json() for report in summary],
    )


def write_object(name: str, value: Any) -> None:
    """Write ``value`` (numbers, texts, lists, tables) as JSON to the file ``name``.

    Raises:
        UsageError: ``can-not-write``.
    """
    target = TextTarget(name)
    try:
        target.write(shown_json(json.dumps(value, indent=2, allow_nan=False)) + "\n")
        target.close()
    finally:
        target.discard()
