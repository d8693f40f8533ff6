"""Names of the choices that a user makes for a run."""

from __future__ import annotations

from typing import Literal

DialectName = Literal[
    "auto", "linuxcnc", "grbl", "fanuc", "haas", "siemens", "mach3", "marlin", "fagor",
    "heidenhain", "paper",
]  # fmt: skip
"""How a program is read. ``auto`` recognises the controller by the program's first lines."""
GcodeSystem = Literal["A", "B", "C"]
"""System of the G-codes of a FANUC or Haas lathe."""
MachineKind = Literal["mill", "lathe", "laser", "printer"]
"""Kind of machine."""
ToolLengths = Literal["table", "zero"]
"""Lengths and radii of tools without a tool table: refused, or 0 with a warning."""
UnknownCodes = Literal["error", "warn"]
"""M- and G-codes that no dialect knows: refused, or skipped with a warning."""
MissingPrograms = Literal["error", "warn"]
"""Programs that are called and not at hand: refused, or skipped with a warning."""
TextStyle = Literal["readable", "compact"]
"""``readable`` puts blanks between words; ``compact`` writes only what the control needs."""
Interpolator = Literal["reference-pulse", "sampled"]
"""``reference-pulse`` makes grid moves. ``sampled`` also samples positions at a fixed period."""
Algorithm = Literal["enclosing-line", "half-step", "point-by-point", "kiritsis", "crossings"]
"""How grid moves follow a curve."""
Pauses = Literal["wait", "refuse", "skip"]
"""At M0 and M6: wait for the operator, reject the program, or continue without a pause."""
Interpolation = Literal["bilinear", "bicubic"]
"""Heights between the points of a grid; bicubic: the natural spline."""
WrapRule = Literal["dialect", "shortest", "sign", "in-turn"]
"""Direction of absolute moves of a rotary axis that repeats after 360 degrees."""
TargetName = Literal["grbl", "linuxcnc", "fanuc", "haas", "siemens", "mach3", "marlin"]
"""Controls for which ``cncrun convert`` writes programs."""
Curves = Literal["lines", "arcs", "nurbs"]
"""How ``cncrun convert`` writes short straight moves."""
