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
however long they took. A rate far beyond the nominal one is no drift: the firmware was built for
another crystal than the board has. It shows in both halves of the time. A computer or a simulator
that was held up shows in one half only, or catches up in the other.
"""

from __future__ import annotations

from collections import deque

WRAP = 2**32
SAMPLES = 120
"""Answers that the estimate uses."""
MAX_DRIFT = 0.1
"""Largest relative deviation of a clock that is followed: a resistor and a capacitor inside a
microcontroller keep this.
"""
USUAL_DRIFT = 0.01
"""A larger deviation is told: a crystal has 1e-4 at most, a ceramic resonator 0.005."""
JUMP_S = 0.25
"""Error of a time of this computer that makes no clock wrong during motion: virtual machines have
such jumps. A longer one ends the motion in any case.
"""
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

    def restart(self) -> None:
        """Forget all answers but the last."""
        while len(self._samples) > 1:
            self._samples.popleft()
        self.wrong = 0.0

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

    def beyond(self, drift: float, jump: float = JUMP_S) -> float:
        """Return the rate of the board's clock if it deviates by more than ``drift`` for certain.

        Args:
            drift: relative.
            jump: error of a time that may have happened, s.

        Returns:
            Ticks per second; 0 if it may be nearer to the nominal rate, as far as is known.
        """
        first, last = self._samples[0], self._samples[-1]
        half = 0.5 * (first[0] + last[0])
        middle = min(self._samples, key=lambda each: abs(each[0] - half))
        signs = {self._sign(drift, jump, *pair) for pair in ((first, middle), (middle, last))}
        if len(signs) > 1 or 0 in signs:
            return 0.0
        return (last[1] - first[1]) / (last[0] - first[0])

    def _sign(
        self,
        drift: float,
        jump: float,
        first: tuple[float, int, float],
        last: tuple[float, int, float],
    ) -> int:
        """Return 1 if the clock was faster than ``drift`` for certain, -1 if it was slower."""
        passed = (last[1] - first[1]) / self.frequency
        time, margin = last[0] - first[0], 0.5 * (first[2] + last[2])
        if passed > (1.0 + drift) * (time + margin) + jump:
            return 1
        return -1 if passed < (1.0 - drift) * (time - margin) - jump else 0

    def _add(self, clock: int, sent: float, received: float) -> None:
        trip = max(received - sent, 1e-9)
        self._samples.append((0.5 * (sent + received), clock, trip))
        self.wrong = self.wrong or self.beyond(MAX_DRIFT)
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
