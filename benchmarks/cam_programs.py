"""Programs as CAM systems and their posts write them, from seeded generators.

Each style has the habits of one system: line numbers, comments, a feed or a spindle speed on each
line, several codes a line, arcs in every plane with I J K or R, cycles, tool changes, blank lines,
small letters, missing blanks and numbers that begin with the point.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

Point = tuple[float, float, float]


class Stroke(NamedTuple):
    """A move of a toolpath: its code, end, and the centre and plane of an arc."""

    code: int
    end: Point
    center: tuple[float, float] = (0.0, 0.0)
    plane: int = 17


def toolpath(rng: random.Random, arcs: float, planes: tuple[int, ...] = (17,)) -> Iterator[Stroke]:
    """Yield an endless toolpath: cuts of short moves and arcs, with traverses between them.

    Args:
        rng: Source of random numbers.
        arcs: Part of the cutting moves that are arcs.
        planes: G-codes of the planes of arcs.
    """
    x, y, z = 0.0, 0.0, 5.0
    while True:
        x, y = round(rng.uniform(0, 200), 3), round(rng.uniform(0, 200), 3)
        yield Stroke(0, (x, y, 5.0))
        z = round(-rng.uniform(0.2, 6), 3)
        yield Stroke(1, (x, y, z))
        angle = rng.uniform(0, math.tau)
        for _ in range(rng.randint(20, 400)):
            if rng.random() >= arcs:
                angle += rng.gauss(0, 0.3)
                length = rng.uniform(0.05, 2)
                x = round(x + length * math.cos(angle), 3)
                y = round(y + length * math.sin(angle), 3)
                yield Stroke(1, (x, y, z))
                continue
            plane, radius = rng.choice(planes), rng.uniform(0.5, 8)
            clockwise = rng.random() < 0.5
            begin = rng.uniform(0, math.tau)
            swept = rng.uniform(0.2, 2.5) * (-1 if clockwise else 1)
            i, j = -radius * math.cos(begin), -radius * math.sin(begin)
            here = {17: (x, y), 18: (z, x), 19: (y, z)}[plane]
            a = round(here[0] + i + radius * math.cos(begin + swept), 4)
            b = round(here[1] + j + radius * math.sin(begin + swept), 4)
            x, y, z = {17: (a, b, z), 18: (b, y, a), 19: (x, a, b)}[plane]
            yield Stroke(2 if clockwise else 3, (x, y, z), (i, j), plane)
        yield Stroke(0, (x, y, 5.0))
        z = 5.0


CENTER = {17: "IJ", 18: "KI", 19: "JK"}
"""Letters of the centre by plane."""


def _center(stroke: Stroke, decimals: int = 4) -> str:
    return " ".join(
        f"{letter}{value:.{decimals}f}"
        for letter, value in zip(CENTER[stroke.plane], stroke.center, strict=True)
    )


def _short(value: float) -> str:
    """Return a number without its leading 0, as Mastercam writes it."""
    text = f"{value:.4f}".rstrip("0")
    if text in ("0.", "-0."):
        return "0."
    return text.replace("-0.", "-.") if text.startswith("-0.") else text.removeprefix("0")


def fusion(rng: random.Random) -> Iterator[str]:
    """Autodesk Fusion, generic post: line numbers, modal words, arcs in all planes."""
    yield from ["%", "O1001 (part)", "(T1 D=6. CR=0. - ZMIN=-6. - flat end mill)"]
    number = 10
    yield "N10 G90 G94 G17"
    yield "N15 G21"
    yield "N20 M3 S12000"
    before: tuple[int, Point, int] = (-1, (math.nan,) * 3, 17)
    for count, stroke in enumerate(toolpath(rng, 0.2, (17, 18, 19))):
        number = (number + 5) % 99995
        if count % 2500 == 0:
            yield from ["", f"(2D Adaptive{count})", f"N{number} M9", "S12000 M3"]
            before = (-1, (math.nan,) * 3, before[2])
        words = [f"N{number}"]
        if stroke.code > 1 and stroke.plane != before[2]:
            words.append(f"G{stroke.plane}")
            before = before[0], before[1], stroke.plane
        if stroke.code != before[0] or stroke.code > 1:
            words.append(f"G{stroke.code}")
        words += [
            f"{letter}{value:.3f}"
            for letter, value, old in zip("XYZ", stroke.end, before[1], strict=True)
            if value != old or stroke.code > 1
        ]
        if stroke.code > 1:
            words.append(_center(stroke))
        if stroke.code == 1 and before[0] != 1:
            words.append(f"F{rng.choice([300, 800, 1500])}.")
        before = stroke.code, stroke.end, before[2]
        yield " ".join(words)


def hsm(rng: random.Random) -> Iterator[str]:
    """HSMWorks for LinuxCNC: adaptive clearing, F on many lines, no line numbers."""
    yield from ["%", "(adaptive)", "G90 G94 G17 G91.1", "G21", "G53 G0 Z0.", "(T2 D=8.)", "M9"]
    yield from ["S9550 M3", "G54", "M8", "G64 P0.01"]
    for stroke in toolpath(rng, 0.35):
        x, y, z = stroke.end
        if stroke.code < 2:
            feed = f" F{rng.choice([1200, 1500, 333.3])}" if rng.random() < 0.3 else ""
            yield f"G{stroke.code} X{x:.3f} Y{y:.3f} Z{z:.3f}{feed or ' F1200'}"
        else:
            yield f"G{stroke.code} X{x:.4f} Y{y:.4f} {_center(stroke)}"


def mastercam(rng: random.Random) -> Iterator[str]:
    """Mastercam: arcs with R, leading points, no trailing zeros, drilling cycles, tool changes."""
    yield from ["%", "O0000(PART)", "(MATERIAL - ALUMINUM MM - 2024)", "N100 G21"]
    yield "N110 G0 G17 G40 G49 G80 G90"
    strokes = toolpath(rng, 0.25)
    here = 0.0, 0.0, 5.0
    number = 110
    for tool in range(1, 1_000_000):
        yield f"N{number} T{tool % 90 + 1} M6"
        yield f"N{number} G0 G90 G54 X0. Y0. S4000 M3"
        yield f"G43 H{tool % 90 + 1} Z50."
        yield f"N{number} Z10. M8"
        x, y, z = (_short(value) for value in here)
        yield from [f"X{x} Y{y}", f"G1 Z{z} F500."]
        for _ in range(3000):
            stroke = next(strokes)
            here = stroke.end
            number += 2
            x, y, z = (_short(value) for value in stroke.end)
            if stroke.code < 2:
                feed = " F500." if stroke.code == 1 and z[0] == "-" else ""
                yield f"N{number} G{stroke.code} X{x} Y{y} Z{z}{feed}"
            else:
                radius = _short(math.hypot(*stroke.center) + 2e-4)
                yield f"N{number} G{stroke.code} X{x} Y{y} R{radius}"
        yield f"N{number} G0 Z10."
        yield f"N{number} G98 G83 X{rng.uniform(0, 99):.3f} Y5. Z-12. R2. Q3. F120."
        for _ in range(40):
            number += 2
            yield f"N{number} X{rng.uniform(0, 99):.3f} Y{rng.uniform(0, 99):.3f}"
        yield from ["G80", "M9", "M5", "G0 Z50."]


def freecad(rng: random.Random) -> Iterator[str]:
    """FreeCAD, linuxcnc post: all words on all lines, comments about operations."""
    yield from ["(Exported by FreeCAD)", "(Post Processor: linuxcnc_post)", "(begin preamble)"]
    yield from ["G17 G54 G40 G49 G80 G90", "G21", "(begin operation: T1)", "M5", "M3 S8000"]
    for count, stroke in enumerate(toolpath(rng, 0.15)):
        x, y, z = stroke.end
        if count % 700 == 0:
            yield f"(finish operation: Profile{count})"
            yield f"(begin operation: Pocket{count})"
        if stroke.code < 2:
            feed = " F900.000" if stroke.code else ""
            yield f"G{stroke.code} X{x:.3f} Y{y:.3f} Z{z:.3f}{feed}"
        else:
            yield f"G{stroke.code} {_center(stroke)} X{x:.4f} Y{y:.4f} Z{z:.3f} F900.000"


def estlcam(rng: random.Random) -> Iterator[str]:
    """Estlcam: F and S on each line, two-digit codes, comments at tools."""
    yield from [
        "(Project relief)",
        "(Created by Estlcam)",
        "G21",
        "G90",
        "M03 S24000",
        "G00 Z5.0000",
    ]
    for stroke in toolpath(rng, 0.1):
        x, y, z = stroke.end
        if stroke.code < 2:
            yield f"G0{stroke.code} X{x:.4f} Y{y:.4f} Z{z:.4f} F1800 S24000"
        else:
            yield f"G0{stroke.code} X{x:.4f} Y{y:.4f} {_center(stroke)} F1800 S24000"


def lightburn(rng: random.Random) -> Iterator[str]:
    """LightBurn, raster image: S on each line, no blanks, the laser on and off."""
    yield from ["; LightBurn 1.4", "; GRBL device profile", "G00 G17 G40 G21 G54", "G90", "M4"]
    yield from ["; Scan @ 6000 mm/min", "M9", "G0X0Y0", "G91", "G1F6000S0"]
    forward = 1
    while True:
        for _ in range(rng.randint(50, 300)):
            yield f"X{forward * rng.uniform(0.1, 2):.3f}S{rng.randint(0, 1000)}"
        forward = -forward
        yield "G0Y0.1S0" if rng.random() < 0.5 else "G1Y0.1S0"
        yield "G1"


def pcb2gcode(rng: random.Random) -> Iterator[str]:
    """pcb2gcode: isolation milling with spaces, comments on lines, dwells, then drilling."""
    yield from ["( pcb2gcode 2.5.0 )", "( This file uses 1 drill bit size. )", ""]
    yield from ["G94 ( Millimeters per minute feed rate. )", "G21 ( Units == Millimeters. )", ""]
    yield from ["G90 ( Absolute coordinates. )", "G00 S10000 ( RPM spindle speed. )", "M3"]
    yield "G04 P1.00000"
    strokes = toolpath(rng, 0.0)
    while True:
        for _ in range(rng.randint(400, 900)):
            stroke = next(strokes)
            x, y, _ = stroke.end
            if stroke.code == 0:
                yield from ["", "G00 Z2.00000 ( retract )", "", f"G00 X{x:.5f} Y{y:.5f} ( rapid )"]
                yield f"G01 Z{-0.05:.5f} F200.00000 ( plunge. )"
                yield from ["G04 P0 ( dwell for no time -- G64 should not smooth over this point )"]
                yield "F600.00000"
            else:
                yield f"G01 X{x:.5f} Y{y:.5f}"
        yield f"G81 R2.00000 Z-1.80000 F300.00000 X{rng.uniform(0, 50):.5f} Y1.00000"
        for _ in range(rng.randint(50, 200)):
            yield f"X{rng.uniform(0, 50):.5f} Y{rng.uniform(0, 50):.5f}"
        yield "G80"


def inkscape(rng: random.Random) -> Iterator[str]:
    """Inkscape, Gcodetools: small arcs, six decimals, comments at each path."""
    yield from ["%", "(Header)", "M3", "(Header end.)", "G21 (All units in mm)", ""]
    for stroke in toolpath(rng, 0.6):
        x, y, z = stroke.end
        if stroke.code == 0:
            yield f"(Start cutting path id: path{rng.randint(1000, 9999)})"
            yield f"G00 X{x:.6f} Y{y:.6f}"
        elif stroke.code == 1:
            yield f"G01 X{x:.6f} Y{y:.6f} Z{z:.6f} F400.000000"
        else:
            yield f"G0{stroke.code} X{x:.6f} Y{y:.6f} Z{z:.6f} {_center(stroke, 6)}"


def lower_case(rng: random.Random) -> Iterator[str]:
    """Fusion's program in small letters without blanks."""
    for line in fusion(rng):
        yield line if line.startswith("(") or "(" in line else line.lower().replace(" ", "")


STYLES: dict[str, tuple[Callable[[random.Random], Iterator[str]], int]] = {
    "fusion": (fusion, 100_000),
    "hsm": (hsm, 120_000),
    "mastercam": (mastercam, 80_000),
    "freecad": (freecad, 90_000),
    "estlcam": (estlcam, 160_000),
    "lightburn": (lightburn, 100_000),
    "pcb2gcode": (pcb2gcode, 60_000),
    "inkscape": (inkscape, 70_000),
    "lower case": (lower_case, 34_000),
}
"""Generators and usual numbers of lines by style."""


def write(path: Path, style: str, lines: int | None = None, seed: int = 1) -> int:
    """Write a program; return the number of its lines."""
    generator, usual = STYLES[style]
    written = 0
    with path.open("w", newline="") as file:
        for line in generator(random.Random(seed)):
            if written >= (lines or usual) - 3:
                break
            file.write(f"{line}\n")
            written += 1
        file.write("G80\nM5\nM2\n")
    return written + 3
