"""What changed since an earlier check: time, extent and findings of each program, beside the
summary that was kept then.

A finding is the same as before if code and message are, wherever its line has moved to, or if code
and line are, whatever the message counts; of those that are told once for a whole program, if the
code is. Only the others are new, and only they decide how a check ends.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from cnc.checks.catalogue import TOLD_ONCE
from cnc.model.diagnostics import SEVERITIES, Diagnostic, UsageError
from cnc.report.changes import Changes

if TYPE_CHECKING:
    from cnc.report.result import Report

SAME = 1e-6
"""mm, s, and relative: numbers that differ by less have not changed."""


class Baseline:
    """The summaries of an earlier check, as ``--json`` or ``--format json`` wrote them. UsageError
    ``baseline-unreadable``.
    """

    def __init__(self, name: str) -> None:
        try:
            with open(name, encoding="utf-8") as file:
                kept = json.load(file)
            programs = kept if isinstance(kept, list) else [kept]
            self._programs = {_key(each["program"]): _Then(each) for each in programs}
        except OSError as error:
            raise _unreadable(name, error.strerror or str(error)) from None
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise _unreadable(
                name, f"it is no summary that a check wrote ({type(error).__name__}: {error})"
            ) from None

    def changes(self, report: Report) -> Changes:
        """What changed in a program since."""
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
        """Programs of then that were not checked now."""
        now = {_key(report.program) for report in reports}
        return [then.program for key, then in self._programs.items() if key not in now]


class _Then:
    """A program as its summary has it; whatever is not as it should be raises."""

    def __init__(self, summary: dict[str, Any]) -> None:
        self.program: str = summary["program"]
        self.ok = bool(summary["ok"])
        self.figures = {name: float(summary[name]) for name in ("duration_s", "path_length_mm")}
        self.box = {
            str(axis): [float(low), float(high)]
            for axis, (low, high) in summary["bounding_box"].items()
        }
        self.findings = [_finding(each) for each in summary["errors"]]


def _finding(kept: dict[str, Any]) -> Diagnostic:
    if kept["severity"] not in SEVERITIES:
        raise ValueError(f"no severity is called {kept['severity']!r}")
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
    hint = "name a file that `cncrun check --json FILE` wrote"
    return UsageError(
        Diagnostic("baseline-unreadable", f"the baseline {name} can't be read: {why}", hint=hint)
    )


def _key(program: str) -> str:
    return program if program.startswith("<") else os.path.abspath(program)


def _matched(
    now: Sequence[Diagnostic], then: Sequence[Diagnostic], program: str, before: str
) -> tuple[list[Diagnostic], list[Diagnostic], list[Diagnostic]]:
    """The findings of now that are new and those that are not, and those of then that are gone."""

    def file(found: Diagnostic) -> str:
        return "" if found.file in (program, before) else found.file

    ways: list[Callable[[Diagnostic], Hashable]] = [
        lambda found: (found.code, file(found), found.line, found.column, found.message),
        lambda found: (found.code, file(found), found.message),
        lambda found: (found.code, file(found), found.line),
        lambda found: found.code if found.code in TOLD_ONCE else id(found),
    ]
    new, gone = list(now), list(then)
    for way in ways:
        left: dict[Hashable, list[Diagnostic]] = {}
        for each in gone:
            left.setdefault(way(each), []).append(each)
        still = []
        for each in new:
            same = left.get(way(each))
            if same:
                same.pop(0)
            else:
                still.append(each)
        new, gone = still, [each for same in left.values() for each in same]
    fresh = {id(each) for each in new}
    gone_ids = {id(each) for each in gone}
    return (
        new,
        [each for each in now if id(each) not in fresh],
        [each for each in then if id(each) in gone_ids],
    )


def _differ(then: list[float] | None, now: list[float] | None) -> bool:
    if then is None or now is None:
        return then is not now
    return any(abs(a - b) > SAME * max(1.0, abs(a)) for a, b in zip(then, now, strict=True))


def told(reports: Iterable[Report], missing: Iterable[str]) -> Iterator[str]:
    """Lines for people: what changed in each program, and which programs were not checked this
    time.
    """
    unchanged = 0
    for report in reports:
        lines = [] if report.changes is None else report.changes.lines()
        unchanged += not lines
        if lines:
            yield f"{report.program}, since the baseline:"
            yield from (f"  {line}" for line in lines)
    for program in missing:
        yield f"{program}: in the baseline, not checked now"
    if unchanged:
        yield f"{unchanged} program{'s' if unchanged > 1 else ''} as in the baseline"
