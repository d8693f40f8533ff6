"""Shape of a tool, from its entry in the tool table and from comments.

The table has diameters. What a tool looks like stands in the comment of its line, or in a comment
of the program, as CAM systems write it. These words are read, in capitals or not:

    ball, ball nose                 half a sphere
    bull, CR=1, corner radius 1     flat with a rounded corner (the radius in mm)
    drill                           a cone of 118 degrees; spot drill and centre drill: 90 degrees
    V-bit, chamfer, engraver        a cone; its angle must stand beside it
    60 deg, 60°, V60                the full angle of a cone
    TAPER=45DEG                     as Fusion 360 writes it: of drills the full angle, else half
    tip 0.2                         diameter of the flat tip of a cone, mm
    flute 20, FL=20, LOC 20         length of the cutting part, mm
    holder 40x35                    diameter of the holder, and its distance from the tip, mm
    flat, end mill, face mill, ...  flat; other words, too, but this is then said to be assumed

Lengths in comments of the table are in mm, those of a program in its unit.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from cnc.kernels.stock.cutter import BALL, BULL, CONE, FLAT, Cutter
from cnc.kernels.stock.sweep import Assembly

_NUMBER = r"\s*[=:]?\s*([0-9]*\.?[0-9]+)"
_CORNER = re.compile(rf"\b(?:CR|CORNER\s*RAD(?:IUS)?){_NUMBER}", re.IGNORECASE)
_TAPER = re.compile(rf"\bTAPER{_NUMBER}", re.IGNORECASE)
_ANGLE = re.compile(
    r"\b(?:V-?)?([0-9]+\.?[0-9]*)\s*(?:DEG\b|DEGREES?\b|°)|\bV-?([0-9]{2,3})\b", re.IGNORECASE
)
_TIP = re.compile(rf"\bTIP{_NUMBER}", re.IGNORECASE)
_FLUTE = re.compile(rf"\b(?:FLUTE(?:\s*LENGTH)?|FL|LOC){_NUMBER}", re.IGNORECASE)
_HOLDER = re.compile(rf"\bHOLDER{_NUMBER}\s*X{_NUMBER}", re.IGNORECASE)
_BALL = re.compile(r"\bBALL", re.IGNORECASE)
_BULL = re.compile(r"\bBULL|\bRADIUSED\b", re.IGNORECASE)
_SPOT = re.compile(r"\b(?:SPOT|CENT(?:ER|RE))[\s-]*(?:DRILL|BIT)", re.IGNORECASE)
_DRILL = re.compile(r"\bDRILL", re.IGNORECASE)
_CONE = re.compile(r"\bV[\s-]?(?:BIT|CARVE)|\bCHAMFER|\bENGRAV|\bCONE\b|\bCONICAL", re.IGNORECASE)
_FLAT = re.compile(
    r"\bFLAT|\bEND[\s-]?MILL|\bFACE[\s-]?MILL|\bSLOT|\bROUTER|\bREAMER|\bTAP\b", re.IGNORECASE
)
DRILL_ANGLE, SPOT_ANGLE = 118.0, 90.0
"""Degrees. Point angles of drills whose comment names none."""


@dataclass(frozen=True, slots=True)
class ToolShape:
    """A tool as the simulation cuts with it.

    Attributes:
        assembly: Its parts.
        described: The shape for people, such as ``ball 6 mm``.
        assumed: What was assumed because nothing says it; empty if nothing was.
    """

    assembly: Assembly
    described: str
    assumed: str = ""


def tool_shape(diameter: float, comment: str, *, scale: float = 1.0) -> ToolShape:
    """Return the shape of a tool.

    Args:
        diameter: Diameter of the tool, mm; 0 if it is not known.
        comment: Comment that describes it.
        scale: Millimetres in a unit of the comment's lengths.
    """
    if diameter <= 0.0:
        assembly = Assembly(Cutter(FLAT, 0.0, 0.0, 0.0), math.inf, math.inf, 0.0)
        return ToolShape(
            assembly, "no diameter", "no diameter is known; it cuts one column of cells"
        )
    radius = diameter / 2.0
    cutter, name, assumed = _cutter(radius, comment, scale)
    flutes = _length(_FLUTE.search(comment), scale, math.inf)
    holder = _HOLDER.search(comment)
    stickout = math.inf if holder is None else float(holder[2]) * scale
    width = 0.0 if holder is None else float(holder[1]) * scale / 2.0
    return ToolShape(
        Assembly(cutter, flutes, stickout, width), f"{name} {diameter:.6g} mm", assumed
    )


def _cutter(radius: float, comment: str, scale: float) -> tuple[Cutter, str, str]:
    """Return the cutting part, its name, and what was assumed."""
    corner = _length(_CORNER.search(comment), scale, 0.0)
    if _BALL.search(comment) or corner >= radius * (1.0 - 1e-6):
        return Cutter(BALL, radius, 0.0, radius), "ball", ""
    if corner > 0.0:
        return Cutter(BULL, radius, radius - corner, corner), f"bull nose R{corner:.6g}", ""
    flat = Cutter(FLAT, radius, radius, 0.0)
    if _BULL.search(comment):
        return flat, "flat", "its corner radius is not known; it is taken as flat"
    angle, assumed = _angle(comment)
    if angle is not None:
        if not 0.0 < angle < 180.0:
            return flat, "flat", assumed
        tip = min(_length(_TIP.search(comment), scale, 0.0) / 2.0, radius)
        rise = 1.0 / math.tan(math.radians(angle) / 2.0)
        return Cutter(CONE, radius, tip, rise), f"cone of {angle:.6g} degrees", assumed
    if _CONE.search(comment):
        return flat, "flat", "its angle is not known; it is taken as flat"
    return flat, "flat", "" if _FLAT.search(comment) else "no shape is known; it is taken as flat"


def _angle(comment: str) -> tuple[float | None, str]:
    """Return the full angle of a cone in degrees, None without one, and what was assumed."""
    spot, drill = _SPOT.search(comment), _DRILL.search(comment)
    if taper := _TAPER.search(comment):
        return float(taper[1]) * (1.0 if drill or spot else 2.0), ""
    if found := _ANGLE.search(comment):
        return float(found[1] or found[2]), ""
    if spot:
        return SPOT_ANGLE, f"a point angle of {SPOT_ANGLE:.6g} degrees is assumed"
    if drill:
        return DRILL_ANGLE, f"a point angle of {DRILL_ANGLE:.6g} degrees is assumed"
    return None, ""


def _length(found: re.Match[str] | None, scale: float, missing: float) -> float:
    """Return the number of a match in mm."""
    return missing if found is None else float(found[1]) * scale
