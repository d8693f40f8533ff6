"""Lines for a board, packed so that a long program fits in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.model.line_effects import LineEffect, LineKind
from cnc.model.streams import GcodeLine

UNKNOWN = -1
"""In place of a kind: the line carries no effect."""
NO_EFFECT = (UNKNOWN, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ROW = np.dtype(
    [
        ("line", np.int32),
        ("kind", np.int8),
        ("plane", np.int8),
        ("x", np.float64),
        ("y", np.float64),
        ("z", np.float64),
        ("feed", np.float64),
        ("center_first", np.float64),
        ("center_second", np.float64),
        ("seconds", np.float64),
    ]
)


@dataclass(frozen=True, slots=True)
class PackedLines:
    """A sequence of lines.

    Attributes:
        text: The lines, each with its line end.
        rows: Source line and effect of each line (n,), of type ROW.
    """

    text: str
    rows: NDArray[np.void]

    @classmethod
    def of(cls, lines: Sequence[GcodeLine]) -> PackedLines:
        """Pack lines."""
        text = "".join(line.text + "\n" for line in lines)
        return cls(text, np.array([_row(line) for line in lines], ROW))

    @property
    def size(self) -> int:
        """Bytes of memory."""
        return len(self.text) + self.rows.nbytes

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[GcodeLine]:
        for text, row in zip(self.text.split("\n"), self.rows.tolist(), strict=False):
            line, kind, plane, x, y, z, feed, first, second, seconds = row
            effect = (
                None
                if kind == UNKNOWN
                else LineEffect(LineKind(kind), (x, y, z), feed, plane, (first, second), seconds)
            )
            yield GcodeLine(text, line, effect)


def _row(line: GcodeLine) -> tuple[float, ...]:
    effect = line.effect
    if effect is None:
        return (line.line, *NO_EFFECT)
    return (
        line.line,
        effect.kind,
        effect.plane,
        *effect.target,
        effect.feed,
        *effect.center,
        effect.seconds,
    )
