"""Lines for a board, packed so that a long program fits in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.model.line_effects import rows_of
from cnc.model.streams import GcodeLine


@dataclass(frozen=True, slots=True)
class PackedLines:
    """A sequence of lines.

    Attributes:
        text: The lines, each with its line end.
        rows: Source line and effect of each line (n,), see
            :func:`~cnc.model.line_effects.row_type`.
    """

    text: str
    rows: NDArray[np.void]

    @classmethod
    def of(cls, lines: Sequence[GcodeLine]) -> PackedLines:
        """Pack lines."""
        text = "".join([line.text + "\n" for line in lines])
        rows = rows_of([line.line for line in lines], [line.effect for line in lines])
        return cls(text, rows)

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Bytes of each line with its end (n,)."""
        ends = np.flatnonzero(np.frombuffer(self.text.encode(), np.uint8) == ord("\n"))
        return np.diff(ends, prepend=-1)

    @property
    def size(self) -> int:
        """Bytes of memory."""
        return len(self.text) + self.rows.nbytes

    def __len__(self) -> int:
        return len(self.rows)
