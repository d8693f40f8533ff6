"""Long programs of SINUMERIK in compiled code: the blocks and errors are the interpreter's."""

from __future__ import annotations

import random
from typing import Any

import pytest

from cnc.gcode.core.compiled_program import CompiledProgram
from cnc.gcode.reader import source_text
from cnc.model.diagnostics import CncError
from tests.support.gcode.gcode_cases import block_summaries, end_of
from tests.support.soak import share

PLAIN = (
    "N{n} G1 X={r} Y={r} F={f}",
    "G0 X={r} Z={r}",
    "R{d}={r}",
    "R{d}=R{d}+{r}",
    "G1 X=R{d}+{r} Y=R1*2",
    "X{r} Y=R2/3 ; cut {n}",
    "G1 Z=SIN({r})*10 F{f}",
    "R{d}=R1*R2/({r}+1)",
    "DEPTH=DEPTH+0.25",
    "Z=-DEPTH",
    "N{n}0 R3=ROUND({r})",
)
RARE = (
    "X=IC({r}) Y={r}",
    "R1=R1+1 X=R1",
    "R1={r} R2=R1+1",
    "G91",
    "G90",
    "G2 X={r} Y={r} CR=900",
    "G3 X=IC(10) Y=IC(0) I=5 J=0 TURN=1",
    "G2 X=AC({r}) Y=IC(1) CR=800",
    "/X={r}",
    'MSG("part {n}")',
    "G4 F0.5",
    "S{f} M3",
    "M8",
    "TRANS X{r}",
    "TRANS",
    "IF R1>{r}\nX=R1\nELSE\nY=R2\nENDIF",
    "G54 D1",
    "G64",
    "G55",
    "COUNT={r}",
    "X=R1 RND=0.1",
    "G70",
    "G71",
    "",
)
BROKEN = (
    "X=1/0",
    "X={r} X={r}",
    "Q=5",
    "X=R77",
    "X=DEPHT",
    "DEPHT={r}",
    "COUNT=R77",
    "G1 X=SQRT(-{r})",
    "X=",
    "R1=",
    "G2 X=R1",
    "M{n}000",
)
HEAD = "DEF REAL DEPTH=1\nDEF INT COUNT=0\nG90 G71 G17 F1000\n"


def program(rng: random.Random, *, broken: bool) -> str:
    lines: list[str] = []
    for _ in range(rng.randrange(600, 900)):
        shape = rng.choice(RARE if rng.random() < 0.02 else PLAIN)
        lines.append(filled(shape, rng))
    for _ in range(rng.randrange(0, 3)):
        at = rng.randrange(len(lines))
        lines[at:at] = [f"WHILE R9<{rng.randrange(2, 5)}", "X=R9*3", "R9=R9+1", "ENDWHILE"]
    if broken:
        lines.insert(rng.randrange(300, len(lines)), filled(rng.choice(BROKEN), rng))
    start = "\n".join(f"R{index}={index}.5" for index in range(10))
    return f"{HEAD}{start}\n" + "\n".join(lines) + "\nM30"


def filled(shape: str, rng: random.Random) -> str:
    for mark, number in (
        ("{r}", lambda: f"{rng.uniform(0.1, 300):.3f}"),
        ("{f}", lambda: str(rng.randrange(100, 3000))),
        ("{n}", lambda: str(rng.randrange(1, 900))),
        ("{d}", lambda: str(rng.randrange(1, 9))),
    ):
        while mark in shape:
            shape = shape.replace(mark, number(), 1)
    return shape


def result(source: str) -> Any:
    found: list[str] = []
    try:
        found += block_summaries(source, dialect="siemens")
    except CncError as error:
        return error.diagnostic
    return found


@pytest.mark.parametrize("seed", range(share(30, 6)))
def test_compiled_code_gives_the_blocks_and_errors_of_the_interpreter(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = random.Random(seed)
    source = program(rng, broken=seed % 3 == 2)
    compiled = result(source)
    monkeypatch.setattr(CompiledProgram, "knows", lambda *arguments: False)
    assert compiled == result(source)


def test_most_lines_are_executed_by_compiled_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """X of each line is the sum of the numbers 1 to n, which R1 adds up."""
    count, read = 2000, []
    original = source_text.parse_line

    def counted(text: str, syntax: Any) -> Any:
        read.append(text)
        return original(text, syntax)

    monkeypatch.setattr("cnc.gcode.reader.source_text.parse_line", counted)
    lines = [f"R1=R1+{n}\nG1 X=R1*0.001 Y={n}.5 F=500" for n in range(1, count + 1)]
    end = end_of("R1=0\nG90 G71\n" + "\n".join(lines), dialect="siemens")
    assert end[:2] == pytest.approx([count * (count + 1) / 2000, count + 0.5])
    assert len(read) < count


def test_a_program_with_few_such_lines_is_left_to_the_interpreter() -> None:
    """Y adds up the steps 1 to n, from a position that compiled code does not know."""
    count = 800
    lines = [f"X={n}.5\nY=IC({n})" for n in range(1, count + 1)]
    end = end_of("G90 G71 G0\n" + "\n".join(lines), dialect="siemens")
    assert end[:2] == [count + 0.5, count * (count + 1) / 2]
