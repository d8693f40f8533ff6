"""Records of a path, gathered into chunks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block
from cnc.model.motion_commands import Commands, command_array, places_of
from cnc.path.chunk import PathChunk
from cnc.path.fit_pieces import Pieces
from cnc.path.records import Floats, Records

MOST_PIECES = 4096
MOST_NUMBERS = 1 << 18
"""A chunk is closed when its records are this many, or have this many numbers."""


class Gatherer:
    """Gathers records into chunks."""

    def __init__(self, axes: tuple[str, ...]) -> None:
        self.axes = axes
        self.file = ""
        self.timed = False
        self.waiting: list[Block] = []
        """Commands that take effect at the start of the next piece."""
        self.clear()

    def clear(self) -> None:
        """Forget all pieces and commands but those that wait."""
        self.parts: list[Pieces] = []
        self.stops: list[NDArray[np.bool_]] = []
        self.pieces = 0
        self.numbers = 0
        self.commands: dict[int, tuple[Block, ...]] = {}

    def add(
        self,
        records: Records,
        feeds: Floats,
        lines: NDArray[np.int32],
        stops: NDArray[np.bool_],
        tolerance: float,
        commands: Commands | None = None,
    ) -> None:
        """Add records of one kind.

        Args:
            records: the records.
            feeds: (m,): mm/s, NaN for a traverse.
            lines: (m,): source lines.
            stops: (m,): whether motion rests behind each.
            tolerance: of their joints, mm.
            commands: (m,): commands that go with each.
        """
        for place in places_of(commands):
            assert commands is not None
            self.commands[self.pieces + place] = commands[place]
        kind = np.full(len(records.at), records.kind)
        self.put(
            Pieces(
                kind,
                records.at,
                records.data,
                records.length,
                feeds,
                lines,
                np.where(stops, 0.0, tolerance),
            ),
            stops,
        )

    def put(self, pieces: Pieces, stops: NDArray[np.bool_]) -> None:
        """Add pieces; motion rests behind those with a stop (m,)."""
        if self.waiting and len(pieces.at):
            self.commands[self.pieces] = (*self.waiting, *self.commands.get(self.pieces, ()))
            self.waiting.clear()
        self.parts.append(pieces)
        self.stops.append(stops)
        self.pieces += len(pieces.at)
        self.numbers += len(pieces.data)

    def full(self) -> bool:
        """Return whether the chunk is to be closed."""
        return self.pieces >= MOST_PIECES or self.numbers >= MOST_NUMBERS

    def take(self) -> PathChunk:
        """Return everything gathered as one chunk, and empty the gatherer."""
        parts = self.parts
        offsets = np.cumsum([0] + [len(part.data) for part in parts[:-1]])
        chunk = PathChunk(
            axes=self.axes,
            file=self.file,
            kind=np.concatenate([part.kind for part in parts]),
            at=np.concatenate(
                [part.at + offset for part, offset in zip(parts, offsets, strict=True)]
            ),
            data=np.concatenate([part.data for part in parts]),
            length=np.concatenate([part.length for part in parts]),
            feed=np.concatenate([part.feed for part in parts]),
            line=np.concatenate([part.line for part in parts]),
            stop_after=np.concatenate(self.stops),
            tolerance=np.concatenate([part.tolerance for part in parts]),
            commands=command_array(self.pieces, self.commands),
            timed=self.timed,
        )
        self.clear()
        return chunk
