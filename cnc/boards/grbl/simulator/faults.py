"""Faults on demand: what goes wrong, and when.

simulator.inject(Drop(3), byte=200)        from the 200th byte that the host sends
simulator.inject(Swallow(1), line=40)      the next reply once the 40th line has come
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
    """The main program hangs: nothing is answered, planned motion runs out, bytes still fill the
    ring.
    """

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


COUNTED: dict[str, type[Drop | Duplicate | Corrupt | Swallow]] = {
    "drop": Drop,
    "duplicate": Duplicate,
    "corrupt": Corrupt,
    "swallow": Swallow,
}
KINDS = (*COUNTED, "freeze", "unplug", "alarm", "error")


@dataclass(frozen=True, slots=True)
class Appointment:
    """A fault and its moment, as :meth:`cnc.boards.grbl.simulator.grbl_simulator.GrblSimulator.inject` takes
    them.
    """

    fault: Fault
    byte: int | None = None
    line: int | None = None
    time: float | None = None


def parse_fault(text: str) -> Appointment:
    """``kind[:amount][@byte|line|time:number]``, such as ``drop:3@line:40``, ``unplug@time:2.5``.
    ValueError if it is not of that form.
    """
    what, _, moment = text.partition("@")
    name, _, amount = what.partition(":")
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
        return Appointment(fault)
    if where == "time":
        return Appointment(fault, time=float(number))
    if where == "byte":
        return Appointment(fault, byte=int(number))
    if where == "line":
        return Appointment(fault, line=int(number))
    raise ValueError(f"a fault happens at a byte, a line or a time, not at {where!r}")


class ByteFaults:
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
