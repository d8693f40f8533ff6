"""The board's clock as seen by this computer.

A question for the clock is answered at a time between sending and receiving. The shorter the round
trip, the better the time is known. So the estimate is a line through the answers of the last
seconds, each weighted by its round trip beyond the shortest one.

      clock                         x   answers with a short round trip weigh most
        │                    x x  /
        │               x  / x
        │          x / x
        └──────────────────────────── time of this computer

An answer lies between the times of its question and of its receipt. So two answers bound the rate,
however long they took. A rate beyond these bounds is no drift: the firmware was built for another
crystal than the board has.
"""

from __future__ import annotations

from collections import deque

WRAP = 2**32
SAMPLES = 120
"""Answers that the estimate uses."""
MAX_DRIFT = 0.01
"""Largest relative deviation of a clock that is believed: a ceramic resonator has 0.005."""
JUMP_S = 0.02
"""Error of a time of this computer that makes no clock wrong: virtual machines have such jumps."""
LEAST_SPAN_S = 2.0
"""Time between the first and the last answer from which the frequency is estimated."""


class BoardClock:
    """Estimate of a board's clock.

    Args:
        frequency: Nominal ticks per second.

    Attributes:
        frequency: Nominal ticks per second.
        rate: Estimated ticks per second of this computer.
        wrong: Rate of a clock that deviates by more than MAX_DRIFT for certain; 0 if none does.
        half_trip_s: Half of the shortest round trip.
    """

    def __init__(self, frequency: float) -> None:
        self.frequency = frequency
        self.rate = frequency
        self.wrong = 0.0
        self.half_trip_s = 0.0
        self._samples: deque[tuple[float, int, float]] = deque(maxlen=SAMPLES)
        self._time = 0.0
        self._clock = 0.0

    @property
    def known(self) -> bool:
        """Whether there is an answer."""
        return bool(self._samples)

    @property
    def drift(self) -> float:
        """Relative deviation of the board's frequency from its nominal one."""
        return self.rate / self.frequency - 1.0

    def set(self, clock: int, sent: float, received: float) -> None:
        """Start again from an answer with all 64 bits."""
        self._samples.clear()
        self.wrong = 0.0
        self._add(clock, sent, received)

    def add(self, clock32: int, sent: float, received: float) -> None:
        """Add an answer to ``get_clock``: the lower 32 bits, and the times of the question, s."""
        self._add(self.extend(clock32, 0.5 * (sent + received)), sent, received)

    def extend(self, clock32: int, time: float) -> int:
        """Return the clock with these lower 32 bits that is next to the one at a time, s."""
        near = self.at(time)
        return near + (clock32 - near + WRAP // 2) % WRAP - WRAP // 2

    def at(self, time: float) -> int:
        """Return the clock at a time of this computer, s."""
        return round(self._clock + (time - self._time) * self.rate)

    def time_of(self, clock: int) -> float:
        """Return the time of a clock, s."""
        return self._time + (clock - self._clock) / self.rate

    def _check(self, clock: int, sent: float, received: float) -> None:
        """Compare the ticks since each earlier answer with the shortest and the longest time."""
        for middle, earlier, trip in self._samples:
            ticks = clock - earlier
            longest, shortest = received - middle + 0.5 * trip, sent - middle - 0.5 * trip
            passed = ticks / self.frequency
            fast = passed > (1.0 + MAX_DRIFT) * longest + JUMP_S
            if fast or passed < (1.0 - MAX_DRIFT) * shortest - JUMP_S:
                self.wrong = ticks / (0.5 * (longest + shortest))
                return

    def _add(self, clock: int, sent: float, received: float) -> None:
        trip = max(received - sent, 1e-9)
        if not self.wrong:
            self._check(clock, sent, received)
        self._samples.append((0.5 * (sent + received), clock, trip))
        least = min(each[2] for each in self._samples)
        self.half_trip_s = 0.5 * least
        # The error of an answer is at most half of its round trip beyond the shortest.
        scale = 0.1 * least + 1e-6
        first, base = self._samples[0][0], self._samples[0][1]
        weights = [1.0 / (scale + each[2] - least) ** 2 for each in self._samples]
        total = sum(weights)
        times = [each[0] - first for each in self._samples]
        clocks = [float(each[1] - base) for each in self._samples]
        time = sum(w * t for w, t in zip(weights, times, strict=True)) / total
        ticks = sum(w * c for w, c in zip(weights, clocks, strict=True)) / total
        if times[-1] - times[0] >= LEAST_SPAN_S:
            spread = sum(w * (t - time) ** 2 for w, t in zip(weights, times, strict=True))
            product = sum(
                w * (t - time) * (c - ticks) for w, t, c in zip(weights, times, clocks, strict=True)
            )
            if spread > 0.0:
                rate = product / spread
                bound = MAX_DRIFT * self.frequency
                self.rate = min(max(rate, self.frequency - bound), self.frequency + bound)
        self._time, self._clock = first + time, base + ticks
