"""Write finishing.nc: a 3D finishing pass of 20 000 short moves.

The moves run in a zig-zag over a smooth surface, as a CAM system writes them.

    python programs/make_finishing.py [FILE]

The numbers are rounded to a micrometre and words that did not change are left out, so that the
program has the noise and the shape of a real one. The same on every machine: only sums, products
and a few sines, rounded far above their last bit.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

ROWS = 80
MOVES_IN_ROW = 250
STEP_OVER = 0.4
"""mm between rows."""
CHORD = 0.15
"""mm along X and Y between points of a row."""
CORNER = (20.0, 20.0)
"""Lower left corner in mm."""

HEADER = """%
(3D finishing pass: zig-zag over a wavy surface, 20 000 moves of about 0.15 mm)
(Made by make_finishing.py. Tool 4: 6 mm ball. Zero: lower left corner, top face)
G21 G90 G17 G94 G40 G49 G80
G54
T4 M6
S16000 M3
M8
G64 P0.005
G0 Z20
"""

FOOTER = """G0 Z20
M9
M5
G0 X0 Y0
M30
%
"""


def height(x: float, y: float) -> float:
    """Z of the surface in mm: a dome, a wave across it and a valley along it."""
    across = (x - CORNER[0]) / (CHORD * (MOVES_IN_ROW - 1))
    along = (y - CORNER[1]) / (STEP_OVER * (ROWS - 1))
    dome = 16.0 * across * (1.0 - across) * along * (1.0 - along)
    return (
        -6.0
        + 4.0 * dome
        + 0.8 * math.sin(5.0 * across + 3.0 * along)
        - 1.2 * math.exp(-((along - 0.35) ** 2) / 0.01)
    )


def points() -> Iterator[tuple[float, float, float]]:
    """Every point of the pass in turn; the first is where the tool goes down."""
    for row in range(ROWS):
        y = CORNER[1] + row * STEP_OVER
        columns = range(MOVES_IN_ROW)
        for column in columns if row % 2 == 0 else reversed(columns):
            x = CORNER[0] + column * CHORD
            yield x, y, height(x, y)
    yield x, y + STEP_OVER, height(x, y + STEP_OVER)


def _word(letter: str, value: float) -> str:
    digits = f"{value:.3f}".rstrip("0").rstrip(".")
    return letter + ("0" if digits == "-0" else digits)


def lines() -> Iterator[str]:
    """The program, line by line, without line ends."""
    yield from HEADER.splitlines()
    before: tuple[str, ...] = ()
    feed = " F2500"
    for point in points():
        words = tuple(_word(letter, value) for letter, value in zip("XYZ", point, strict=True))
        if not before:
            yield f"G0 {words[0]} {words[1]}"
            yield "G0 Z5"
            yield f"G1 {words[2]} F400"
        else:
            yield (
                " ".join(word for word, old in zip(words, before, strict=True) if word != old)
                + feed
            )
            feed = ""
        before = words
    yield from FOOTER.splitlines()


def main() -> None:
    """Write the program to the file named, or beside this script."""
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("finishing.nc")
    file.write_text("\n".join(lines()) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main()
