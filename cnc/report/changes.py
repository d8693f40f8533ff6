"""Differences between an earlier check of a program and this one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cnc.model.diagnostics import Diagnostic


@dataclass(frozen=True, slots=True)
class Changes:
    """One program, then and now.

    new, kept, gone: findings by whether they were there then, and are now. figures: what both times
    have a number for and is not the same, (then, now) by name: ``duration_s``, ``path_length_mm``.
    box: extent of each axis that has another, (then, now), None where it did not move. known:
    whether the program was checked then; if not, every finding is new.
    """

    known: bool
    new: list[Diagnostic]
    kept: list[Diagnostic]
    gone: list[Diagnostic]
    figures: dict[str, tuple[float, float]]
    box: dict[str, tuple[list[float] | None, list[float] | None]]

    def as_json(self) -> dict[str, Any]:
        """For the public summary."""
        return {
            "known": self.known,
            "new": [_place_and_code(each) for each in self.new],
            "gone": [_place_and_code(each) for each in self.gone],
            **{name: list(pair) for name, pair in self.figures.items()},
            "bounding_box": {axis: list(pair) for axis, pair in self.box.items()},
        }

    def lines(self) -> list[str]:
        """For people, a line each; none if nothing changed."""
        from cnc.report.summary import clock, number, position

        if not self.known:
            return ["not in the baseline"]
        shown = []
        for name, (then, now) in self.figures.items():
            share = f" ({100.0 * (now - then) / then:+.1f} %)" if then else ""
            if name == "duration_s":
                shown.append(f"time: {clock(then)} -> {clock(now)}{share}")
            else:
                shown.append(f"path length: {number(then)} -> {number(now)} mm{share}")
        for axis, pair in self.box.items():
            ends = [" .. ".join(map(position, each)) if each else "none" for each in pair]
            shown.append(f"{axis.upper()}: {ends[0]} -> {ends[1]}")
        for word, findings in ("new", self.new), ("gone", self.gone):
            shown += [
                f"{word}: {each.severity} {each.line or '-'}: {each.code}: {each.message}"
                for each in findings
            ]
        return shown


def _place_and_code(found: Diagnostic) -> dict[str, Any]:
    return {
        "code": found.code,
        "message": found.message,
        "file": found.file,
        "line": found.line,
        "severity": found.severity,
    }
