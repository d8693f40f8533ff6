"""The position that a Klipper board and the file of the last program have kept together."""

from __future__ import annotations

import numpy as np

from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import Layout
from cnc.boards.klipper.position import MotorPosition
from cnc.boards.klipper.position_store import PositionStore, StoredPosition
from cnc.boards.klipper.setup import configure


class PositionKeeper:
    """The stored position of one board.

    Args:
        identity: Identity of the board, "" for one whose position is not kept.
        layout: The objects of the board.

    Attributes:
        warnings: Findings about the file.
    """

    def __init__(self, identity: str, layout: Layout) -> None:
        self._layout = layout
        self._store = PositionStore(identity)
        self._stored, self.warnings = self._store.read()
        self._number = 0

    def configure(self, connection: Connection) -> tuple[int, bool]:
        """Configure the board, unless it has this configuration already.

        Returns:
            Entries of its move queue, and whether it has kept its counts.
        """
        layout, stored = self._layout.crc, self._stored
        kept = stored.number if stored is not None and stored.layout == layout else layout
        self._number = self._store.number(layout)
        slots, same = configure(connection, self._layout, kept, self._number)
        if same:
            self._number = kept
        return slots, same

    def restore(self, position: MotorPosition) -> None:
        """Take over the stored position, if it belongs to the counts of the board."""
        stored = self._stored
        if stored is None or len(stored.offset) != len(self._layout.motors):
            return
        position.offset = list(stored.offset)
        # A program that was killed has left the motors without a ramp.
        if len(stored.known) == len(position.known) and not stored.moving:
            position.known = np.array(stored.known, np.bool_)

    def write(self, position: MotorPosition, *, moving: bool) -> None:
        """Keep the position for the next program."""
        known, offset = position.known.tolist(), list(position.offset)
        self._store.write(
            StoredPosition(
                layout=self._layout.crc,
                number=self._number,
                offset=offset,
                known=known,
                moving=moving,
            )
        )
