"""Control flow of FANUC's custom macro B, and calls with arguments.

The expected moves were worked out by hand.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.gcode.flow_moves import xs

LETTERS = "A1 B2 C3 D7 E8 F9 H11 I4 J5 K6 M13 Q17 R18 S19 T20 U21 V22 W23 X24 Y25 Z26"
"""Argument list I: the variable of each letter."""
THREES = [letter for _ in range(10) for letter in "IJK"]

CASES: dict[str, tuple[str, list[float]]] = {
    "goto forward": ("GOTO 20\nG0 X1\nN20 G0 X2", [2]),
    "goto back": ("#1=0\nN10 #1=#1+1\nG0 X#1\nIF [#1 LT 3] GOTO 10\nG0 X9", [1, 2, 3, 9]),
    "goto searches forward first": ("N5 G0 X1\nGOTO 5\nN5 G0 X2\nM30\nN5 G0 X3", [1, 2]),
    "goto from the beginning": ("GOTO 1\nN2 G0 X2\nM30\nN1 G0 X1\nGOTO 2", [1, 2]),
    "goto with a computed number": (
        "#1=20\nGOTO#1\nN10 G0 X1\nM30\nN20 G0 X2\nGOTO [#1 - 10]",
        [2, 1],
    ),
    "goto with blanks": ("N 1 G O T O 3 0\nG0 X1\nN30 G0 X2", [2]),
    "a condition that does not hold": ("IF [1 EQ 2] GOTO 9\nG0 X1\nN9 G0 X2", [1, 2]),
    "then": ("#1=3\nIF [#1 EQ 3] THEN #2=5\nIF [#1 EQ 4] THEN #2=6\nG0 X#2", [5]),
    "vacant is not 0": ("IF [#1 EQ #0] THEN #2=1\n#1=0\nIF [#1 EQ #0] THEN #2=7\nG0 X#2", [1]),
    "while": ("#1=0\nWHILE [#1 LT 3] DO1\n#1=#1+1\nG0 X#1\nEND1\nG0 X9", [1, 2, 3, 9]),
    "while never": ("WHILE [1 EQ 2] DO1\nG0 X1\nEND1\nG0 X2", [2]),
    "three loops within each other": (
        "#1=0\nWHILE [#1 LT 2] DO1\n#1=#1+1\n#2=0\nWHILE [#2 LT 2] DO2\n#2=#2+1\n#3=0\n"
        "WHILE [#3 LT 2] DO3\n#3=#3+1\n"
        "G0 X[100*#1+10*#2+#3]\nEND3\nEND2\nEND1",
        [111, 112, 121, 122, 211, 212, 221, 222],
    ),
    "the same number again": (
        "WHILE [#1 LT 1] DO1\n#1=#1+1\nG0 X1\nEND1\nWHILE [#1 LT 3] DO1\n#1=#1+1\nG0 X2\nEND1",
        [1, 2, 2],
    ),
    "a loop without condition": (
        "#1=0\nDO1\n#1=#1+1\nIF [#1 GT 2] GOTO 5\nG0 X#1\nEND1\nN5 G0 X9",
        [1, 2, 9],
    ),
    "goto out of loops": (
        "WHILE [1 EQ 1] DO1\nWHILE [1 EQ 1] DO2\n#1=#1+1\nG0 X#1\nIF [#1 GE 2] GOTO 7\nEND2\nEND1\n"
        "N7 G0 X9",
        [1, 2, 9],
    ),
    "goto within a loop": ("WHILE [#1 LT 2] DO1\n#1=#1+1\nGOTO 3\nG0 X99\nN3 G0 X#1\nEND1", [1, 2]),
    "goto to the first line of a loop": (
        "#1=0\nGOTO 2\nN2 WHILE [#1 LT 2] DO1\n#1=#1+1\nG0 X#1\nEND1",
        [1, 2],
    ),
    # calls
    "M98": ("G0 X1\nM98 P200\nG0 X3\nM30\nO0200\nG0 X2\nM99", [1, 2, 3]),
    "M98 with four digits of repeats": ("M98 P30200\nM30\nO200\nG0 X2\nM99", [2, 2, 2]),
    "M98 with eight digits": ("M98 P00021234\nM30\nO1234\nG0 X2\nM99", [2, 2]),
    "M98 P and L": (
        "M98 P200 L2\nM98 P12345 L1\nM30\nO200\nG0 X2\nM99\nO12345\nG0 X3\nM99",
        [2, 2, 3],
    ),
    "M98 shares the local variables": ("#1=1\nM98 P2\nG0 X#1\nM30\nO2\nG0 X#1\n#1=7\nM99", [1, 7]),
    "M99 to a block": ("M98 P2\nG0 X1\nN50 G0 X3\nM30\nO2\nG0 X2\nM99 P50", [2, 3]),
    "M99 to a block before the call": (
        "N50 #1=#1+1\nIF [#1 GT 2] GOTO 60\nM98 P2\nG0 X9\nN60 M30\nO2\nG0 X#1\nM99 P50",
        [1, 2],
    ),
    "M99 to a block after the last repeat": (
        "M98 P2 L2\nG0 X1\nN50 M30\nO2\nG0 X2\nM99 P50",
        [2, 2],
    ),
    "M99 to a block of the main program": (
        "#1=0\nN1 #1=#1+1\nG0 X#1\nIF [#1 EQ 2] GOTO 2\nM99 P1\nN2 G0 X9",
        [1, 2, 9],
    ),
    "programs have block numbers of their own": (
        "M98 P2\nGOTO 5\nG0 X1\nN5 G0 X2\nM30\nO2\nGOTO 5\nG0 X3\nN5 G0 X4\nM99",
        [4, 2],
    ),
    "G65": ("G65 P9010 A1.5 B-2.\nG0 X9\nM30\nO9010\nG0 X#1\nG0 X#2\nM99", [1.5, -2, 9]),
    "G65 has variables of its own": (
        "#1=1\n#100=1\nG65 P2 B5\nG0 X#1\nG0 X#100\nM30\nO2\nIF [#1 EQ #0] THEN #1=7\nG0 X#1\n"
        "#100=8\nM99",
        [7, 1, 8],
    ),
    "G65 with a computed program": ("#1=1\nG65 P[#1+1] A#1\nM30\nO2\nG0 X#1\nM99", [1]),
    "G65 L": ("#100=0\nG65 P2 L3 A2\nM30\nO2\n#100=#100+#1\nG0 X#100\nM99", [2, 4, 6]),
    "G65 in G65": (
        "G65 P2 A1\nG0 X9\nM30\nO2\nG65 P3 A[#1+1]\nG0 X#1\nM99\nO3\nG0 X#1\nM99",
        [2, 1, 9],
    ),
    "arguments are computed before the call": (
        "#1=5\n#2=6\nG65 P2 A#2 B#1\nM30\nO2\nG0 X[#1+10*#2]\nM99",
        [56],
    ),
    "vacant arguments are not given": (
        "G65 P2 A#0 B5\nM30\nO2\nIF [#1 EQ #0] THEN #2=#2+1\nG0 X#2\nM99",
        [6],
    ),
    "the later of two for one variable counts": (
        "G65 P1000 A1. B2. I-3. I4. D5.\nM30\nO1000\nG0 X#1\nG0 X#2\nG0 X#4\nG0 X#7\nM99",
        [1, 2, -3, 5],
    ),
    "letters that go back begin another three": (
        "G65 P2 J5 I7 K9\nM30\nO2\nG0 X#5\nG0 X#7\nG0 X#9\nM99",
        [5, 7, 9],
    ),
    "a line number before G65": ("N10 G65 P2 A1\nM30\nO2\nG0 X#1\nM99", [1]),
    **{
        f"argument {pair}": (
            f"G65 P2 {pair[0]}-{pair[1:]}.25\nM30\nO2\nG0 X#{pair[1:]}\nM99",
            [-float(pair[1:]) - 0.25],
        )
        for pair in LETTERS.split()
    },
    "the second argument list": (
        "G65 P2 A1 B2 C3 "
        + " ".join(f"{letter}{number}" for number, letter in enumerate(THREES, start=4))
        + "\nM30\nO2\n"
        + "".join(f"G0 X#{number}\n" for number in range(1, 34))
        + "M99",
        list(range(1, 34)),
    ),
}


@pytest.mark.parametrize(("source", "moves"), CASES.values(), ids=CASES)
def test_macro_programs_make_the_expected_moves(source: str, moves: list[float]) -> None:
    assert xs(source, dialect="fanuc") == moves


def test_m99_continues_after_a_deleted_block() -> None:
    source = "G0 X1\n/M99 P9\nG0 X2\nN9 G0 X3"
    assert xs(source, dialect="fanuc") == [1, 3]
    assert xs(source, dialect="fanuc", block_delete=True) == [1, 2, 3]


def test_goto_does_not_find_deleted_blocks() -> None:
    source = "GOTO 5\n/N5 G0 X1\nN5 G0 X2"
    assert xs(source, dialect="fanuc") == [1, 2]
    assert xs(source, dialect="fanuc", block_delete=True) == [2]


def test_programs_in_files(tmp_path: Path) -> None:
    (tmp_path / "o0123.nc").write_text("%\nO0123\nG0 X#1\nGOTO 7\nN7 M99\n%\n")
    (tmp_path / "9010.nc").write_text("G0 X#26\nM99")
    assert xs("#1=4\nM98 P123\nG65 P9010 Z3", dialect="fanuc", folders=[tmp_path]) == [4, 3]
