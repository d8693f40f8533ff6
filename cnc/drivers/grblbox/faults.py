"""Faults on demand: what goes wrong, and when.

box.inject(Drop(3), byte=200)        from the 200th byte that the host sends
box.inject(Swallow(1), line=40)      the next reply once the 40th line has come
box.inject(Unplug(), time=2.5)       2.5 s after the box was made
box.inject(Alarm(3))                 now
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Drop:
    """The next ``count`` bytes towards the board are lost."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class Duplicate:
    """The next ``count`` bytes towards the board come twice."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class Corrupt:
    """The next ``count`` bytes towards the board have one bit wrong."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class Swallow:
    """The next ``count`` replies (ok, error:n) are not sent."""

    count: int = 1


@dataclass(frozen=True, slots=True)
class Freeze:
    """The main program hangs: nothing is answered, planned motion runs out, bytes still fill the ring."""

    seconds: float = math.inf


@dataclass(frozen=True, slots=True)
class Unplug:
    """The cable is pulled. The board goes on."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """An alarm, with the stop that goes with it."""

    code: int


@dataclass(frozen=True, slots=True)
class Error:
    """The next line is not carried out, but answered by this error."""

    code: int


Fault = Drop | Duplicate | Corrupt | Swallow | Freeze | Unplug | Alarm | Error
WRONG_BIT = 0x04
"""What a corrupted byte differs by: a letter becomes another, a digit another or a sign."""


class Garbler:
    """What happens to bytes on their way to the board."""

    def __init__(self) -> None:
        self.drop = self.duplicate = self.corrupt = 0

    def pass_on(self, byte: int) -> tuple[int, ...]:
        """What of a byte arrives."""
        if self.drop:
            self.drop -= 1
            return ()
        if self.corrupt:
            self.corrupt -= 1
            byte ^= WRONG_BIT
        if self.duplicate:
            self.duplicate -= 1
            return (byte, byte)
        return (byte,)
