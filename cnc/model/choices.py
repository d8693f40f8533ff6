"""Names of the choices that a user makes for a run."""

from __future__ import annotations

from typing import Literal

DialectName = Literal["auto", "linuxcnc", "grbl", "fanuc", "paper"]
"""How a program is read. ``auto`` is LinuxCNC's language with more forms of splines."""
MachineKind = Literal["mill", "lathe", "laser", "printer"]
"""Kind of machine."""
Interpolator = Literal["reference-pulse", "sampled"]
"""``reference-pulse`` makes grid moves. ``sampled`` also samples positions at a fixed period."""
Algorithm = Literal["enclosing-line", "half-step", "point-by-point", "kiritsis", "crossings"]
"""How grid moves follow a curve."""
Pauses = Literal["wait", "refuse", "skip"]
"""At M0 and M6: wait for the operator, reject the program, or continue without a pause."""
