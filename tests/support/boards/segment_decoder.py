"""Grid moves of segments, as the encoder of the stepper board itself plays them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.boards.stepper.kernels import segments as form
from cnc.boards.stepper.segments import split


class SegmentDecoder:
    """Plays segments as the board does, bit for bit; ``axes``: number of axes."""

    def __init__(self, axes: int) -> None:
        self._axes = np.arange(axes)
        self._clock = 0
        self._tick = np.empty(form.MAX_ROWS, dtype=np.int64)
        self._mask = np.empty(form.MAX_ROWS, dtype=np.uint8)

    def play(self, segments: bytes) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int8]]]:
        """Yield the grid moves of segments: times (n,), ns, and steps (n, axes).

        Raises:
            ValueError: No segment begins at one of the bytes.
        """
        for segment in split(segments):
            data = np.frombuffer(segment, dtype=np.uint8)
            rows, self._clock = form.play(data, 0, self._clock, self._tick, self._mask)
            backward = segment[1] >> 4 >> self._axes & 1
            steps = self._mask[:rows, None] >> self._axes & 1
            yield (
                self._tick[:rows] * form.TICK_NS,
                np.where(backward, -steps, steps).astype(np.int8),
            )
