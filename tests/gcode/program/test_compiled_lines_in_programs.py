"""Whole programs with and without compiled code: equal blocks, bit for bit, and diagnostics."""

from __future__ import annotations

import random
from typing import Any

import pytest

from cnc.gcode.core import compiled_program, line_steps
from cnc.gcode.core.call_stack import Flow, Limits
from cnc.gcode.core.control_flow import ControlLine
from cnc.gcode.core.modal_groups import GROUP_OF_G, GROUP_OF_M
from cnc.gcode.core.program import interpret
from cnc.gcode.dialects import NAMES
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.source_text import Text
from cnc.gcode.reader.words import G, M
from cnc.model.diagnostics import CncError, Diagnostic
from tests.gcode.program.test_plain_lines import AXES, bits, line, number
from tests.support.gcode.flow_author import Author as FlowAuthor
from tests.support.gcode.flow_writers import OWords
from tests.support.gcode.fuzzing import Author
from tests.support.gcode.gcode_cases import end_of, error_of, read, run
from tests.support.soak import share

LIMITS = Limits(repeated_lines=500)
OTHERS = """\
G2 X1 Y1 R5
G3 X5 Y1 I2 J0
G2 X3 Y3 I1
X2 Y2 R9
G18 G3 X1 Z1 I.5 K0
G17
G19
G3 X0 Y0 R1
G2 I1 J0 F100
R5
G1 X1 R5
G2 X1 Y1 I1 R1
G2 X9 Y9 I.1
G2 A1 I1
G2 G3 X1
G4 P1
M3 S1000
(msg, hello)
(a comment)
/X1 Y1
G91 X1
G90
G20
G21
G93
G94
G92 X1
G55
G54
G10 L2 P2 X.5 R15
G43.1 Z1
G81 X1 Y1 Z-1 R1 F50
G80
G0
G1
#1=5
X#1
G1 X[#1+1] F[100]
G41.1 D1
G40
G90.1
G91.1
G7
G8
G98
G38.2 X9 F10
G5 X9 Y9 I1 J1 P1 Q1
G33 X1 K1
M2
%
O5
N5
N-0
N1.5
G-0 X1
F0
Q5
""".splitlines()
"""Lines that change the meaning of straight moves and arcs, or only look like them."""


def outcome(
    lines: list[str],
    axes: tuple[str, ...],
    dialect: str,
    *,
    block_delete: bool = False,
    laser: bool = False,
) -> list[Any]:
    """The blocks, diagnostics and parameters of a program."""
    warnings: list[Any] = []
    executed: list[int] = []
    known = Parameters(macro=dialect == "fanuc")
    found: list[Any] = [warnings]
    try:
        blocks = read(
            Text.of_lines(lines, "t"),
            axes=axes,
            dialect=dialect,
            block_delete=block_delete,
            warn=warnings.append,
            parameters=known,
            limits=LIMITS,
            on_line=executed.append,
            laser=laser,
        )
        for block in blocks:
            found += bits([block])
    except CncError as error:
        found.append(error.diagnostic)
        # Progress is reported from time to time; only the last report of a whole program is fixed.
        executed.clear()
    return [*found, repr(known.stored()), executed[-1:]]


def agree(
    monkeypatch: pytest.MonkeyPatch,
    lines: list[str],
    axes: tuple[str, ...],
    dialect: str,
    *,
    block_delete: bool = False,
    laser: bool = False,
    shortest: int = 1,
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(line_steps, "SHORTEST", shortest)
        patch.setattr(line_steps, "MANY_LINES", 1)
        patch.setattr(compiled_program, "START_COST", 0)
        quick = outcome(lines, axes, dialect, block_delete=block_delete, laser=laser)
    with monkeypatch.context() as patch:
        patch.setattr(line_steps, "SHORTEST", len(lines) + 1)
        patch.setattr(line_steps, "MANY_LINES", 1 << 40)
        slow = outcome(lines, axes, dialect, block_delete=block_delete, laser=laser)
    assert quick == slow, (lines, axes, dialect)


@pytest.mark.timeout(3600)
def test_moves_between_other_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(share(30_000, 30)):
        rng = random.Random(seed)
        axes = rng.choice(AXES)
        lines = [
            rng.choice(
                ["G1 F100", "G21 G90 G17 G1 F500", "G20 G91 G1 F9", "%", "G1 F100", "O1000"]
            ),
            "F100",
        ]
        for _ in range(rng.randint(1, 5)):
            lines += [line(rng, axes) for _ in range(rng.randint(1, 12))]
            lines += [rng.choice(OTHERS) for _ in range(rng.randint(0, 2))]
        if rng.random() < 0.3:
            at = rng.randrange(len(lines))
            lines[at:at] = ["#2=0", "o1 while [#2 LT 3]", "#2=[#2+1]"]
            lines.insert(rng.randint(at + 3, len(lines)), "o1 endwhile")
        agree(
            monkeypatch,
            lines,
            axes,
            rng.choice(NAMES),
            block_delete=rng.random() < 0.5,
        )


CODES = [
    "G0", "G1", "G1", "G1", "G2", "G3", "G2", "G3", "G17", "G18", "G19", "G20", "G21", "G40", "G49",
    "G54", "G55", "G80", "G90", "G91", "G90.1", "G91.1", "G94", "G98", "G99", "G4", "G4", "G8",
    "G61", "G64", "G15", "G69", "M3", "M4", "M5", "M7", "M8", "M9", "M3", "M5", "M0", "M6", "M30",
    "G-1", "G1.5", "G100",
]  # fmt: skip
"""Codes of lines as CAM systems write them, and some that are left to the interpreter."""


def cam_line(rng: random.Random, axes: tuple[str, ...]) -> str:
    """A line with any words in any order; most are correct."""
    words = [letter.upper() + number(rng) for letter in axes if rng.random() < 0.35]
    kind = rng.random()
    if kind < 0.25:
        words += rng.sample(CODES, rng.choice([1, 1, 1, 2, 3]))
    elif kind < 0.5:
        words = rng.choice(
            [
                ["G2", "I5", "J0"], ["G3", "J-2.5"], ["G2", "X1", "Y1", "R50"], ["X-1", "R-90"],
                ["G17", "G3", "X2", "R99"], ["G18", "G2", "Z.5", "R40"], ["G19", "G3", "K3"],
                ["G91", "G2", "X2", "Y2", "I1", "J1"], ["G3", "I1", "K0"], ["G2", "I1", "J1", "K2"],
                ["R7"], ["I1"], ["G2", "X1", "I.5", "R2"], ["G18", "K1", "X0"], ["G3", "Z3", "I1"],
            ]
        ).copy()  # fmt: skip
    if rng.random() < 0.25:
        words.append("F" + rng.choice(["100", "100", "200.5", number(rng)]))
    if rng.random() < 0.2:
        words.append("S" + rng.choice(["1000", "1000", "0", "500", number(rng)]))
    if rng.random() < 0.1:
        words.append("P" + rng.choice(["1", "0", "0.5", "200", "-1"]))
    if rng.random() < 0.01:
        words.append(rng.choice("ABCDEHKLQTUVW") + number(rng))
    rng.shuffle(words)
    if rng.random() < 0.3:
        words.insert(0, f"N{rng.randint(0, 99)}")
    if rng.random() < 0.1:
        words.insert(rng.randint(0, len(words)), rng.choice(["(note)", "(msg, a)"]))
    text = rng.choice(["", " "]).join(words)
    return text.lower() if rng.random() < 0.1 else text


@pytest.mark.timeout(3600)
def test_lines_of_any_words(monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(share(60_000, 20)):
        rng = random.Random(seed)
        axes = rng.choice(AXES)
        dialect = rng.choice(NAMES)
        lines = ["F100 S500 G1", rng.choice(["M3", "M8", "G91", "G90", "", "G20", "G41.1 D1"])]
        lines += [cam_line(rng, axes) for _ in range(rng.randint(3, 40))]
        # Wrong lines are left out, so that programs get far; some keep theirs.
        while (wrong := _wrong_line(lines, axes, dialect)) and rng.random() < 0.97:
            del lines[wrong - 1]
        laser = rng.random() < 0.3
        agree(monkeypatch, lines, axes, dialect, laser=laser, shortest=rng.choice([1, 1, 3]))


def _wrong_line(lines: list[str], axes: tuple[str, ...], dialect: str) -> int:
    """The line of the first error; 0 for none."""
    try:
        for _ in read(Text.of_lines(lines, "t"), axes=axes, dialect=dialect):
            pass
    except CncError as error:
        return min(error.diagnostic.line, len(lines))
    return 0


@pytest.mark.timeout(3600)
def test_random_programs_of_the_whole_language(monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(share(30_000, 30)):
        written = Author(seed).program()
        agree(
            monkeypatch,
            list(written.lines),
            written.axes,
            written.dialect,
            block_delete=written.block_delete,
        )


INSIDE = [
    "M70", "M72", "M71", "M73", "(msg, hi)", "G4 P1", "#<n>=[#1+1]", "#<_g>=[#2*2]", "X[#<n>]",
    "Y[#<_g>+#1]", "#3=#<_value>", "#4=#<_call_level>", "X#<_line>", "#[#1]=5", "Y#[#1+1]", "G91",
    "#5=#<_value_returned>", "F[100+#1]", "G2 X[#1] Y2 R[90+#2]", "M98 P5", "#31=[1/#1]", "N5 #7=8",
    "X[SQRT[#1]]", "#1=#2 #2=#1", "G81 X1 Z-1 R1", "G80 G1", "M2", "S[#1]", "M3", "T1 M6",
    "#5161=3", "G[1] X1", "X[#1] X2", "/X#1", "o1 call [1] [2]", "o2 call [#1]", "o<a> call",
]  # fmt: skip
"""Lines between those of loops and subroutines."""


@pytest.mark.timeout(3600)
def test_programs_of_loops_and_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some are damaged, and some repeat more lines than is allowed."""
    for seed in range(share(40_000, 20)):
        rng = random.Random(seed)
        lines = ["G1 F100", "#<n>=1", *OWords(FlowAuthor(seed).program(), seed).text()]
        for _ in range(rng.choice([0, 0, 0, 1, 2, 8])):
            lines.insert(rng.randrange(len(lines)), rng.choice(INSIDE))
        if rng.random() < 0.2:
            del lines[rng.randrange(len(lines))]
        agree(monkeypatch, lines, AXES[0], rng.choice(["auto", "linuxcnc"]))


def test_a_raster_of_a_laser(monkeypatch: pytest.MonkeyPatch) -> None:
    """S on most lines is the power in motion; other blocks stand between."""
    for seed in range(share(400, 2)):
        rng = random.Random(seed)
        lines = ["G1 F6000 S0", "M4", "G91"]
        for _ in range(rng.choice([30, 300, 9000])):
            power = f"S{rng.randint(0, 3) * 250}" if rng.random() < 0.8 else ""
            lines.append(f"X{rng.choice(['.1', '.25', '-1'])}{power}")
            if rng.random() < 0.02:
                lines.append(rng.choice(["M8", "M9", "G4 P0.1", "G2 X1 R4", "G1", "M5", "M4 S100"]))
        agree(monkeypatch, lines, AXES[0], "grbl" if rng.random() < 0.5 else "auto", laser=True)


@pytest.mark.parametrize(
    "lines",
    [
        ["#<_;a>=5", "X#<_;a> Y2"],
        ["#<_;a>=5", "X#<_;a>Y2"],
        ["#<_;a>=5", "X#<_;a>"],
        ["#<_;a>=5 #1=2"],
        ["o<a;b>SUB", "X4", "o<a;b>ENDSUB", "o<a;b>CALL"],
        ["o<a;b>SUB", "X4", "o<a;b>ENDSUB", "o<a;b> CALL"],
    ],
)
def test_a_semicolon_in_a_name(monkeypatch: pytest.MonkeyPatch, lines: list[str]) -> None:
    """LinuxCNC keeps the blanks behind it, which are no words."""
    program = ["G1 F100", *lines, "M2"]
    agree(monkeypatch, program, AXES[0], "linuxcnc")
    is_refused = any(isinstance(each, Diagnostic) for each in outcome(program, AXES[0], "linuxcnc"))
    assert is_refused == any(" " in each for each in lines)


@pytest.mark.parametrize(
    "move", ["X1. Y2", "G1 X1 Y2", "G2 X1. I1. R5", "X1.(X2)", "(X2) X1.0 Y01"]
)
def test_a_distance_without_a_point_is_warned_about_once(
    monkeypatch: pytest.MonkeyPatch, move: str
) -> None:
    for before in (0, 1, 20):
        lines = ["G1 F100", *["X1.5 Y0"] * before, move, *["X3 Y2"] * 20]
        agree(monkeypatch, lines, AXES[0], "fanuc")
        (warning, *_) = outcome(lines, AXES[0], "fanuc")[0]
        assert warning.code == "decimal-point-missing"


def test_lines_of_a_run_count_as_executed_and_as_new() -> None:
    limits = Limits(repeated_lines=100)
    reported: list[int] = []
    lines = ["G1 F100", *["X1", "X2"] * 5000]
    list(read(Text.of_lines(lines, "t"), limits=limits, on_line=reported.append))
    assert reported[-1] == len(lines)
    loop = ["G1 F100", "o1 repeat [1000]", *["X1", "X2"] * 50, "o1 endrepeat"]
    with pytest.raises(CncError) as caught:
        list(read(Text.of_lines(loop, "t"), limits=limits))
    assert caught.value.diagnostic.code == "loop-endless"


def test_an_error_in_a_run_names_its_line() -> None:
    lines = ["G1 F100", *["X1"] * 100, "A1", *["X1"] * 100]
    with pytest.raises(CncError) as caught:
        list(interpret(Text.of_lines(lines, "t")))
    assert (caught.value.diagnostic.line, caught.value.diagnostic.code) == (102, "axis-missing")


@pytest.mark.parametrize("count", [1, 2000])
@pytest.mark.parametrize("line", ["M4 S100 M8", "G17 G91"])
def test_a_modal_group_holds_in_short_and_long_programs(
    line: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Groups stand in one table. Here M8 is put into that of M3, and G17 into that of G90."""
    moves = "".join(f"G1 X{n % 9} Y{n % 7} F500\n" for n in range(count))
    program = f"G21\nG90\n{moves}{line}\n{moves}M2"
    run(program)
    monkeypatch.setitem(GROUP_OF_M, M.M8, GROUP_OF_M[M.M3])
    monkeypatch.setitem(GROUP_OF_G, G.G17, GROUP_OF_G[G.G90])
    found = error_of(program)
    assert (found.code, found.line) == ("modal-conflict", count + 3)


def test_an_elseif_behind_a_branch_is_executed_by_compiled_code(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The rounds of the loop take each branch; the interpreter executes each line a few times."""
    program = """\
G21 G90 F500
#1=0
o1 while [#1 LT 3000]
o2 if [[#1 MOD 3] EQ 0]
#2=1
o2 elseif [[#1 MOD 3] EQ 1]
#2=2
o2 elseif [#1 GE 0]
#2=3
o2 endif
#3=[#3+#2]
#1=[#1+1]
o1 endwhile
G1 X[#3/1000]
"""
    calls = []
    original = ControlLine.run

    def counted(self: ControlLine, flow: Flow, line: int) -> int:
        calls.append(line)
        return original(self, flow, line)

    monkeypatch.setattr(ControlLine, "run", counted)
    assert end_of(program)[0] == 6.0
    assert len(calls) < 1000
