"""Faults on demand, and when they happen.

simulator.inject(Drop(3), byte=200)        from the 200th byte that the host sends
simulator.inject(Swallow(1), line=40)      the next reply after the 40th line
simulator.inject(Unplug(), time=2.5)       2.5 s after the simulator was made
simulator.inject(Alarm(3))                 now
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
    """The next ``count`` bytes towards the board arrive twice."""

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
    """The main program hangs: no answers; planned motion runs out; bytes still fill the ring."""

    seconds: float = math.inf


@dataclass(frozen=True, slots=True)
class Unplug:
    """The cable is unplugged. The board continues."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """An alarm with its stop."""

    code: int


@dataclass(frozen=True, slots=True)
class Error:
    """The next line is not carried out, but answered with this error."""

    code: int


Fault = Drop | Duplicate | Corrupt | Swallow | Freeze | Unplug | Alarm | Error
WRONG_BIT = 0x04
"""The wrong bit of a corrupted byte: a letter becomes another, a digit another or a sign."""


COUNTED: dict[str, type[Drop | Duplicate | Corrupt | Swallow]] = {
    "drop": Drop,
    "duplicate": Duplicate,
    "corrupt": Corrupt,
    "swallow": Swallow,
}
KINDS = (*COUNTED, "freeze", "unplug", "alarm", "error")


@dataclass(frozen=True, slots=True)
class ScheduledFault:
    """A fault and when it happens, as GrblSimulator.inject takes them."""

    fault: Fault
    byte: int | None = None
    line: int | None = None
    time: float | None = None


def parse_fault(text: str) -> ScheduledFault:
    """Return the fault of ``kind[:amount][@byte|line|time:number]``.

    Examples: ``drop:3@line:40``, ``unplug@time:2.5``.

    Raises:
        ValueError: The text does not have this form.
    """
    kind, _, moment = text.partition("@")
    name, _, amount = kind.partition(":")
    if name not in KINDS:
        raise ValueError(f"no fault is called {name!r}; known are {', '.join(KINDS)}")
    if name == "freeze":
        fault: Fault = Freeze(float(amount)) if amount else Freeze()
    elif name in ("alarm", "error"):
        fault = (Alarm if name == "alarm" else Error)(int(amount))
    elif name == "unplug":
        fault = Unplug()
    else:
        fault = COUNTED[name](int(amount or "1"))
    where, _, number = moment.partition(":")
    if not moment:
        return ScheduledFault(fault)
    if where == "time":
        return ScheduledFault(fault, time=float(number))
    if where == "byte":
        return ScheduledFault(fault, byte=int(number))
    if where == "line":
        return ScheduledFault(fault, line=int(number))
    raise ValueError(f"a fault happens at a byte, a line or a time, not at {where!r}")


class ByteFaults:
    """Faults of bytes on the wire to the board."""

    def __init__(self) -> None:
        self.drop = self.duplicate = self.corrupt = 0

    def pass_on(self, byte: int) -> tuple[int, ...]:
        """Return the bytes that arrive for one byte."""
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
