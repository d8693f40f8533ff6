"""Baseline of a check: the differences to the summary of an earlier check.

Two findings are the same if code and message agree, wherever the line has moved to. They are also
the same if code and line agree, whatever the message counts. A finding that is reported once for a
whole program is the same if the code agrees. Only the others are new, and only new findings decide
how a check ends.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from cnc.checks.selection import REPORTED_ONCE
from cnc.model.diagnostics import SEVERITIES, Diagnostic, UsageError, shown_name
from cnc.report.result import Changes

if TYPE_CHECKING:
    from cnc.report.result import Report

SAME = 1e-6
"""mm or s, or relative above 1. Numbers that differ by less have not changed."""


class Baseline:
    """The summaries of an earlier check, from the file that ``--json`` has written.

    Raises:
        UsageError: ``baseline-unreadable``.
    """

    def __init__(self, name: str) -> None:
        try:
            with open(name, encoding="utf-8") as file:
                kept = json.load(file)
            programs = kept if isinstance(kept, list) else [kept]
            self._programs = {_key(summary["program"]): _Earlier(summary) for summary in programs}
        except OSError as error:
            raise _unreadable(name, error.strerror or str(error)) from None
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise _unreadable(
                name, f"it is not the summary of a check ({type(error).__name__}: {error})"
            ) from None

    def changes(self, report: Report) -> Changes:
        """Return the differences between the earlier check of a program and ``report``."""
        then = self._programs.get(_key(report.program))
        if then is None:
            return Changes(False, list(report.findings), [], [], {}, {})
        new, kept, gone = _matched(report.findings, then.findings, report.program, then.program)
        figures: dict[str, tuple[float, float]] = {}
        box: dict[str, tuple[list[float] | None, list[float] | None]] = {}
        if then.ok and report.ok:
            now = {"duration_s": report.duration_s, "path_length_mm": report.path_length_mm}
            figures = {
                name: (then.figures[name], value)
                for name, value in now.items()
                if _differ([then.figures[name]], [value])
            }
            extent: dict[str, list[float]] = {
                axis: list(ends) for axis, ends in report.bounding_box.items()
            }
            for axis in dict.fromkeys([*then.box, *extent]):
                pair = then.box.get(axis), extent.get(axis)
                if _differ(*pair):
                    box[axis] = pair
        return Changes(True, new, kept, gone, figures, box)

    def missing(self, reports: Iterable[Report]) -> list[str]:
        """Return the programs of the baseline that ``reports`` lacks."""
        now = {_key(report.program) for report in reports}
        return [then.program for key, then in self._programs.items() if key not in now]


class _Earlier:
    """A program in an earlier summary. Raises an exception if the summary is malformed."""

    def __init__(self, summary: dict[str, Any]) -> None:
        self.program: str = summary["program"]
        self.ok = bool(summary["ok"])
        self.figures = {name: float(summary[name]) for name in ("duration_s", "path_length_mm")}
        self.box = {
            str(axis): [float(low), float(high)]
            for axis, (low, high) in summary["bounding_box"].items()
        }
        self.findings = [_finding(error) for error in summary["errors"]]


def _finding(kept: dict[str, Any]) -> Diagnostic:
    if kept["severity"] not in SEVERITIES:
        raise ValueError(f"unknown severity {kept['severity']!r}")
    code, message, file, hint = (
        str(kept.get(name, "")) for name in ("code", "message", "file", "hint")
    )
    return Diagnostic(
        code,
        message,
        file,
        int(kept["line"]),
        int(kept["column"]),
        hint=hint,
        severity=kept["severity"],
    )


def _unreadable(name: str, why: str) -> UsageError:
    hint = "name a file that `cncrun check --json FILE` has written"
    return UsageError(
        Diagnostic("baseline-unreadable", f"the baseline {name} cannot be read: {why}", hint=hint)
    )


def _key(program: str) -> str:
    return program if program.startswith("<") else os.path.abspath(program)


def _matched(
    now: Sequence[Diagnostic], then: Sequence[Diagnostic], program: str, before: str
) -> tuple[list[Diagnostic], list[Diagnostic], list[Diagnostic]]:
    """Match the findings of two checks.

    Args:
        now: findings of this check.
        then: findings of the earlier check.
        program: name of the program now, which a finding may have as its file.
        before: its name in the earlier check.

    Returns:
        Findings that are new, those that were there before, and earlier ones that are gone.
    """

    def file(finding: Diagnostic) -> str:
        return "" if finding.file in (program, before) else finding.file

    # From the strictest to the weakest criterion.
    keys: list[Callable[[Diagnostic], Hashable]] = [
        lambda finding: (
            finding.code,
            file(finding),
            finding.line,
            finding.column,
            finding.message,
        ),
        lambda finding: (finding.code, file(finding), finding.message),
        lambda finding: (finding.code, file(finding), finding.line),
        lambda finding: finding.code if finding.code in REPORTED_ONCE else id(finding),
    ]
    new, gone = list(now), list(then)
    for key in keys:
        left: dict[Hashable, list[Diagnostic]] = {}
        for unpaired in gone:
            left.setdefault(key(unpaired), []).append(unpaired)
        unmatched = []
        for unpaired in new:
            same = left.get(key(unpaired))
            if same:
                same.pop(0)
            else:
                unmatched.append(unpaired)
        new, gone = unmatched, [unpaired for same in left.values() for unpaired in same]
    new_ids = {id(unpaired) for unpaired in new}
    gone_ids = {id(unpaired) for unpaired in gone}
    return (
        new,
        [unpaired for unpaired in now if id(unpaired) not in new_ids],
        [unpaired for unpaired in then if id(unpaired) in gone_ids],
    )


def _differ(then: list[float] | None, now: list[float] | None) -> bool:
    if then is None or now is None:
        return then is not now
    return any(abs(a - b) > SAME * max(1.0, abs(a)) for a, b in zip(then, now, strict=True))


def change_lines(reports: Iterable[Report], missing: Iterable[str]) -> Iterator[str]:
    """Yield the changes of all programs as lines of text.

    Args:
        reports: results of this check, compared with the baseline.
        missing: programs of the baseline that were not checked this time.
    """
    unchanged = 0
    for report in reports:
        lines = [] if report.changes is None else report.changes.lines()
        unchanged += not lines
        if lines:
            yield f"{shown_name(report.program)}, since the baseline:"
            yield from (f"  {line}" for line in lines)
    for program in missing:
        yield f"{shown_name(program)}: in the baseline, but not checked now"
    if unchanged:
        yield f"{unchanged} program{'s' if unchanged > 1 else ''} unchanged since the baseline"
