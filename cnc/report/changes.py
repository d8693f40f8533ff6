"""Differences between a program's baseline and its present check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cnc.model.diagnostics import Diagnostic
from cnc.report.number_format import clock, number, position

if TYPE_CHECKING:
    from cnc.report import models


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

    def as_model(self) -> models.Changes:
        """Return the differences as a part of the summary."""
        from cnc.report import models

        figures: dict[str, Any] = {name: list(pair) for name, pair in self.figures.items()}
        return models.Changes.model_construct(
            known=self.known,
            new=[finding_model(each) for each in self.new],
            gone=[finding_model(each) for each in self.gone],
            **figures,
            bounding_box={axis: list(pair) for axis, pair in self.box.items()},
        )

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
            ends = [" .. ".join(map(position, each)) if each else "none" for each in pair]
            lines.append(f"{axis.upper()}: {ends[0]} -> {ends[1]}")
        for word, findings in ("new", self.new), ("gone", self.gone):
            lines += [
                f"{word}: {each.severity} {each.line or '-'}: {each.code}: {each.message}"
                for each in findings
            ]
        return lines


def finding_model(found: Diagnostic, *, with_hint: bool = False) -> models.Finding:
    """Return a finding as a part of the summary.

    Args:
        found: the finding.
        with_hint: whether the part has the column and the hint.
    """
    from cnc.report import models

    more: dict[str, Any] = {"column": found.column, "hint": found.hint} if with_hint else {}
    return models.Finding.model_construct(
        code=found.code,
        message=found.message,
        file=found.file,
        line=found.line,
        severity=found.severity,
        **more,
    )
