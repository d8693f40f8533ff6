"""Canned cycles in compiled code equal those of the interpreter, bit for bit, and its errors."""

from __future__ import annotations

import random

import pytest

from cnc.gcode.core import line_steps
from cnc.gcode.core.line_steps import PlainLines
from cnc.gcode.core.program import interpret
from cnc.gcode.reader.source_text import Text, Window
from cnc.model.blocks import Polyline
from tests.gcode.program.test_compiled_lines_in_programs import _wrong_line, agree
from tests.gcode.program.test_plain_lines import AXES, number
from tests.support.soak import share

DIALECTS = ["auto", "linuxcnc", "fanuc", "haas", "mach3", "siemens", "grbl"]
CYCLES = ["G73", "G81", "G82", "G83", "G85", "G89"]
OTHERS = """\
G80
G98
G99
G90
G91
G17
G18
G19
G20
G21
G0 X1 Y2 Z9
G1 X3 F200
G2 X1 Y1 R50
G84 X1 Z-2 R1
G86 X2 Z-1 R2 P.1
G88 Y2 R2 Z-1 P0
G76 X1 Z-1 R1 Q.2
G54
G55
G10 L2 P1 Z.3
G92 X1
G92.1
G43.1 Z.25
G49
G64
G64 P.05
G61
G4 P.5
M3 S500
M5
S700
F90
T1 M6
M0
(msg, hole)
#1=2
X[#1] Y#1
Z[-#1] R[#1/2]
X#1 L[#1]
L2 X1 Y0
K2 X.5
Q.4 X1
Q0 X1
P.2 X3
P-1 X1
R-9 X1
R5
Z-3
A1
I1 X2
G81
G0 G81 X1
G81 X1 G98
G83 G91 X1 Y1 L3
G16
G15
G68 X0 Y0 R30
G69
G51 X0 Y0 Z0 P2
G50
G41.1 D1
G40
G7
G8
G93
G94
""".splitlines()


def cycle_line(rng: random.Random) -> str:
    """A line with a cycle, or a hole of the cycle in effect."""
    words = [f"{axis}{number(rng)}" for axis in "XY" if rng.random() < 0.8]
    if rng.random() < 0.25:
        words.insert(0, rng.choice(CYCLES))
        words += [
            f"Z{rng.choice(['-2', '-3.25', '-.5', '1'])}",
            f"R{rng.choice(['1', '2.5', '0'])}",
        ]
        words += [f"Q{rng.choice(['.7', '1', '5', '.05'])}"] * (rng.random() < 0.5)
        words += [f"P{rng.choice(['.25', '0', '1'])}"] * (rng.random() < 0.4)
    elif rng.random() < 0.2:
        words.append(rng.choice(["Z-1.5", "R1.5", "L2", "L3", "K2", "F120", "S900", "G98", "G99"]))
    words += ["G98"] * (rng.random() < 0.05)
    rng.shuffle(words)
    return " ".join(words)


@pytest.mark.timeout(3600)
def test_random_programs_of_cycles(monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(share(60_000, 35)):
        rng = random.Random(seed)
        axes = rng.choice([*AXES[:2], *AXES])
        dialect = rng.choice(DIALECTS)
        lines = ["G1 F100", "G0 Z9", rng.choice(["G64", "G91", "M3 S300", "", "G20", "G18"])]
        for _ in range(rng.randint(1, 4)):
            lines += [cycle_line(rng) for _ in range(rng.randint(1, 9))]
            lines += [rng.choice(OTHERS) for _ in range(rng.randint(0, 2))]
        # Wrong lines are left out, so that programs get far; some keep theirs.
        while (wrong := _wrong_line(lines, axes, dialect)) and rng.random() < 0.97:
            del lines[wrong - 1]
        agree(monkeypatch, lines, axes, dialect, shortest=rng.choice([1, 1, 3]))


@pytest.mark.parametrize(
    "words", ["G81", "G82 P.5", "G83 Q1", "G73 Q.6", "G85", "G89 P.1"][:: share(1, 2)]
)
@pytest.mark.parametrize("level", ["G98", "G99"])
def test_a_pattern_of_holes_runs_in_compiled_code(
    monkeypatch: pytest.MonkeyPatch, words: str, level: str
) -> None:
    holes = [f"X{n} Y{n % 7}" for n in range(200)]
    lines = ["G0 Z9", f"{words} {level} X1 Y1 Z-3 R2 F100", *holes, "G80", "M2"]
    agree(monkeypatch, lines, AXES[0], "linuxcnc")
    taken: list[int] = []
    run = PlainLines.run

    def counted(self: PlainLines, window: Window, index: int) -> int:
        taken.append(run(self, window, index))
        return taken[-1]

    monkeypatch.setattr(PlainLines, "run", counted)
    blocks = list(interpret(Text.of_lines(lines, "t"), dialect="linuxcnc"))
    assert sum(taken) >= 0.9 * len(holes)
    drilled = sum(len(block.points) for block in blocks if isinstance(block, Polyline))
    assert drilled >= 3 * len(holes)


def test_a_series_goes_on_between_compiled_code_and_the_interpreter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """G91 counts R from the level at the start of the series, whoever began it."""
    monkeypatch.setattr(line_steps, "SHORTEST", 1)
    for begin, between in (("G83 Q1", "G68 R30"), ("G81", "G54"), ("G73 Q2", "G10 L2 P1 Z1")):
        lines = ["G0 Z9", "G1 F90", f"{begin} G91 G98 X1 Y1 Z-3 R-2", *["X1 Y2"] * 9, between]
        agree(monkeypatch, [*lines, *["X1 Y3"] * 9], AXES[0], "fanuc")
