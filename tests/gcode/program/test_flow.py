"""Control flow of RS274/NGC: programs of O-words.

The expected moves were worked out by hand.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cnc.gcode.program import program
from cnc.gcode.program.call_stack import Limits, Listing
from cnc.gcode.program.program import interpret
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.source_text import Text
from cnc.model.blocks import Polyline
from cnc.model.diagnostics import Diagnostic
from tests.support.gcode.gcode_cases import error_of, rows, run

COUNTED = "#1 = [#1 + 1]\n"

CASES: dict[str, tuple[str, list[float]]] = {
    # if
    "if": ("o1 if [1]\nG0 X1\no1 endif\no2 if [0]\nG0 X2\no2 endif\nG0 X3", [1, 3]),
    "else": (
        "o1 if [0]\nG0 X1\no1 else\nG0 X2\no1 endif\no2 if [1]\nG0 X3\no2 else\nG0 X4\no2 endif",
        [2, 3],
    ),
    "elseif": (
        "#1=0\no9 while [#1 LT 4]\n#1=[#1+1]\no1 if [#1 EQ 1]\nG0 X10\no1 elseif [#1 LT 3]\n"
        "G0 X20\no1 elseif [#1 LT 3]\nG0 X30\n"
        "o1 else\nG0 X40\no1 endif\no9 endwhile",
        [10, 20, 40, 40],
    ),
    "elseif without else": ("o1 if [0]\nG0 X1\no1 elseif [0]\nG0 X2\no1 endif\nG0 X3", [3]),
    "any number but 0 is true": (
        "o1 if [-0.25]\nG0 X1\no1 endif\no2 if [0.0]\nG0 X2\no2 endif",
        [1],
    ),
    "if in if": (
        "o1 if [1]\no2 if [0]\nG0 X1\no2 else\no3 if [1]\nG0 X2\no3 endif\no2 endif\nG0 X3\n"
        "o1 else\nG0 X4\no1 endif",
        [2, 3],
    ),
    "a condition that is not asked is not computed": (
        "o1 if [1]\nG0 X1\no1 elseif [1/0]\no1 endif",
        [1],
    ),
    "what is skipped is not read": ("o1 if [0]\nthis is no G-code\n)(\no1 endif\nG0 X1", [1]),
    # loops
    "while": (f"#1=0\no1 while [#1 LT 3]\nG0 X#1\n{COUNTED}o1 endwhile", [0, 1, 2]),
    "while never": ("o1 while [0]\nG0 X1\no1 endwhile\nG0 X2", [2]),
    "while in while": (
        f"#1=0\no1 while [#1 LT 2]\n{COUNTED}#2=0\no2 while [#2 LT 2]\n#2=[#2+1]\nG0 X[10*#1+#2]\n"
        f"o2 endwhile\no1 endwhile",
        [11, 12, 21, 22],
    ),
    "do while": (f"#1=5\no1 do\nG0 X#1\n{COUNTED}o1 while [#1 LT 3]", [5]),
    "do while again": (f"#1=0\no1 do\n{COUNTED}G0 X#1\no1 while [#1 LT 3]", [1, 2, 3]),
    "do in do": (
        f"#1=0\no1 do\n{COUNTED}#2=0\no2 do\n#2=[#2+1]\nG0 X[10*#1+#2]\no2 while [#2 LT 2]\n"
        f"o1 while [#1 LT 2]",
        [11, 12, 21, 22],
    ),
    "while in do": (
        f"#1=0\no1 do\n{COUNTED}o2 while [#1 EQ 1]\nG0 X#1\n{COUNTED}o2 endwhile\n"
        f"o1 while [#1 LT 4]",
        [1],
    ),
    "repeat": ("o1 repeat [3]\nG0 X1\no1 endrepeat", [1, 1, 1]),
    "repeat rounds, halves to the even number": (
        "".join(
            f"o{n} repeat [{count}]\nG0 X{n}\no{n} endrepeat\n"
            for n, count in enumerate(["2.4", "2.5", "3.5", "0.5", "0.6"], 1)
        ),
        [1, 1, 2, 2, 3, 3, 3, 3, 5],
    ),
    "repeat never": (
        "o1 repeat [0]\nG0 X1\no1 endrepeat\no2 repeat [-5]\nG0 X2\no2 endrepeat\nG0 X3",
        [3],
    ),
    "repeat in repeat": (
        f"o1 repeat [2]\no2 repeat [2]\n{COUNTED}G0 X#1\no2 endrepeat\no1 endrepeat",
        [1, 2, 3, 4],
    ),
    "the count of repeat is asked once": (
        f"#1=2\no1 repeat [#1]\n{COUNTED}G0 X#1\no1 endrepeat",
        [3, 4],
    ),
    "break": (
        f"o1 while [1]\n{COUNTED}o2 if [#1 GT 2]\no1 break\no2 endif\nG0 X#1\no1 endwhile\nG0 X9",
        [1, 2, 9],
    ),
    "break of do": (
        f"o1 do\n{COUNTED}o2 if [#1 GT 2]\no1 break\no2 endif\nG0 X#1\no1 while [1]\nG0 X9",
        [1, 2, 9],
    ),
    "break out of two": (
        "o1 while [1]\no2 while [1]\nG0 X1\no1 break\no2 endwhile\nG0 X2\no1 endwhile\nG0 X3",
        [1, 3],
    ),
    "break out of a repeat": (
        f"o9 repeat [2]\no1 while [1]\no2 repeat [5]\n{COUNTED}G0 X#1\no1 break\no2 endrepeat\n"
        f"o1 endwhile\no9 endrepeat",
        [1, 2],
    ),
    "continue": (
        f"o1 while [#1 LT 4]\n{COUNTED}o2 if [#1 EQ 2]\no1 continue\no2 endif\nG0 X#1\no1 endwhile",
        [1, 3, 4],
    ),
    "continue of do asks the condition": (
        f"o1 do\n{COUNTED}G0 X#1\no1 continue\nG0 X99\no1 while [#1 LT 3]",
        [1, 2, 3],
    ),
    "continue of the outer loop": (
        f"o1 while [#1 LT 2]\n{COUNTED}o2 while [1]\nG0 X#1\no1 continue\no2 endwhile\nG0 X9\n"
        f"o1 endwhile",
        [1, 2],
    ),
    "do after a break": (
        f"o1 while [1]\no1 break\no1 endwhile\n#1=0\no2 do\n{COUNTED}G0 X#1\no2 while [#1 LT 2]",
        [1, 2],
    ),
    # calls
    "sub": ("o1 sub\nG0 X1\no1 endsub\nG0 X2\no1 call\nG0 X3\no1 call", [2, 1, 3, 1]),
    "a sub behind the end": ("o1 call\nG0 X2\nM2\no1 sub\nG0 X1\no1 endsub", [1, 2]),
    "a sub that is never closed is of no concern where it is never called": (
        "G0 X1\nM2\no1 sub\nG0 X2",
        [1],
    ),
    "arguments": (
        "o1 sub\nG0 X[#1 + 10*#2]\no1 endsub\no1 call [1] [2]\no1 call [3]\no1 call",
        [21, 3, 0],
    ),
    "arguments are computed before the call": (
        "#1=5\n#2=6\no1 sub\nG0 X[#1 + 10*#2]\no1 endsub\no1 call [#2] [#1]",
        [56],
    ),
    "thirty arguments": (
        f"o1 sub\nG0 X#30\no1 endsub\no1 call {''.join(f'[{n}]' for n in range(1, 31))}",
        [30],
    ),
    "numbers to 30 are the sub's own": (
        "o1 sub\n#1=[#1+1]\n#31=[#31+1]\nG0 X#1\no1 endsub\n#1=50\no1 call [7]\nG0 X#1\nG0 X#31",
        [8, 50, 1],
    ),
    "names are the sub's own": (
        "o1 sub\n#<a>=2\n#<_mine>=3\nG0 X#<a>\no1 endsub\n#<a>=1\no1 call\nG0 X#<a>\nG0 X#<_mine>",
        [2, 1, 3],
    ),
    "return": (
        "o1 sub\no2 if [#1]\no1 return\no2 endif\nG0 X1\no1 endsub\no1 call [1]\nG0 X2\no1 call",
        [2, 1],
    ),
    "a return of any label": (
        "o1 sub\no2 if [#1]\no2 return [7]\no2 endif\nG0 X1\no1 endsub\no1 call [1]\n"
        "G0 X#<_value>\no1 call",
        [7, 1],
    ),
    "return out of loops": (
        "o1 sub\no2 repeat [5]\no3 while [1]\nG0 X1\no1 return\no3 endwhile\no2 endrepeat\n"
        "o1 endsub\no1 call\no1 call",
        [1, 1],
    ),
    "a value": (
        "o1 sub\no1 return [#1 * 2]\no1 endsub\no1 call [4]\nG0 X#<_value>\nG0 X#<_value_returned>",
        [8, 1],
    ),
    "a value at the end": ("o1 sub\no1 endsub [#1 * 3]\no1 call [4]\nG0 X#<_value>", [12]),
    "no value": (
        "o1 sub\no1 endsub\no2 sub\no2 endsub [5]\no2 call\no1 call\nG0 X#<_value>\n"
        "G0 X#<_value_returned>",
        [0, 0],
    ),
    "the last value is still there when the arguments are computed": (
        "o1 sub\no1 endsub [#1 + 1]\no1 call [1]\no1 call [#<_value>]\nG0 X#<_value>",
        [3],
    ),
    "recursion": (
        "o1 sub\no2 if [#1 LE 1]\no1 return [1]\no2 endif\no1 call [#1 - 1]\n"
        "o1 endsub [#1 * #<_value>]\no1 call [5]\nG0 X#<_value>",
        [120],
    ),
    "repeat loops of calls count for themselves": (
        "o1 sub\no2 repeat [2]\nG0 X#1\no3 if [#1 GT 0]\no1 call [#1 - 1]\no3 endif\no2 endrepeat\n"
        "o1 endsub\no1 call [1]",
        [1, 0, 0, 1, 0, 0],
    ),
    "subs call each other": (
        "o1 sub\nG0 X1\no2 call\no1 endsub\no2 sub\nG0 X2\no2 endsub\no1 call",
        [1, 2],
    ),
    "a computed label": (
        "o7 sub\nG0 X7\no7 endsub\no8 sub\nG0 X8\no8 endsub\n#1=6\no[#1+1] call\n#1=8\no#1 call\n"
        "o[7] call",
        [7, 8, 7],
    ),
    "leading zeros": ("o007 sub\nG0 X1\no7 endsub\no07 call", [1]),
    "names": ("O<Drill Hole> SUB\nG0 X1\no<drillhole>endsub\no<DRILL HOLE> call", [1]),
    "labels of subs and of the main program are apart": (
        "o1 sub\no2 if [1]\nG0 X1\no2 endif\no1 endsub\no2 if [1]\no1 call\no1 call\no2 endif\n"
        "o1 if [1]\nG0 X3\no1 endif",
        [1, 1, 3],
    ),
    "M2 in a sub": ("o1 sub\nG0 X1\nM2\no1 endsub\no1 call\nG0 X2", [1]),
    # programs
    "M98": ("G0 X1\nM98 P100\nG0 X3\nM30\nO100\nG0 X2\nM99", [1, 2, 3]),
    "M98 of a main program with a number": ("O1 (main)\nM98 P100\nM30\nO100\nG0 X2\nM99", [2]),
    "M98 L": (f"M98 P100 L3\nM98 P100 L0\nG0 X9\nM2\nO100\n{COUNTED}G0 X#1\nM99", [1, 2, 3, 9]),
    "M98 shares the numbers": (
        "#1=1\n#31=1\nM98 P100\nG0 X#1\nG0 X#31\nM2\nO100\n#1=5\n#31=6\nM99",
        [5, 6],
    ),
    "M98 has names of its own": (
        "#<a>=1\nM98 P100\nG0 X#<a>\nM2\nO100\n#<a>=2\nG0 X#<a>\nM99",
        [2, 1],
    ),
    "M98 behind a computed move": ("#1=3\nG0 X[#1 * 2] M98 P100\nM2\nO100\nG0 X2\nM99", [6, 2]),
    "M98 behind a move": ("G0 X1 M98 P100\nM2\nO100\nG0 X2\nM99 X4", [1, 2, 4]),
    "M98 with what was computed before its line": (
        "#1=100 \nM98 P#1 L[#1-98] #1=7\nG0 X#1\nM2\nO100\nG0 X#1\nM99",
        [7, 7, 7],
    ),
    "M98 within M98": (
        "M98 P1 L2\nM2\nO1\nG0 X1\nM98 P2 L2\nM99\nO2\nG0 X2\nM99",
        [1, 2, 2, 1, 2, 2],
    ),
    "M98 in the order of the file or not": ("M98 P2\nM2\nO1\nG0 X1\nM99\nO2\nM98 P1\nM99", [1]),
    "loops in M98": ("M98 P1 L2\nM2\nO1\no5 repeat [2]\nG0 X1\no5 endrepeat\nM99", [1, 1, 1, 1]),
    "M99 beside M30": ("M98 P1\nG0 X9\nM2\nO1\nG0 X1 M30 M99", [1]),
    "five times five": (
        "O1\n#1=0\nM98 P100 L5\nG0 X#1\nM30\n\nO100\n#1=[#1 + 1]\nM98 P200 L5\nM99\n\nO200\n"
        "#1=[#1 + 0.25]\nM99",
        [11.25],
    ),
    "M99 in a loop": ("M98 P1 L2\nM2\nO1\no5 repeat [5]\nG0 X1\nM99\no5 endrepeat\nM99", [1, 1]),
    "a sub calls a program": (
        "o1 sub\nM98 P5\nG0 X#1\no1 endsub\no1 call [3]\nM2\nO5\nG0 X[#1 * 2]\nM99",
        [6, 3],
    ),
    # the program as a whole
    "percent": ("%\nG0 X1\n%\nG0 X2", [1]),
    "text behind the second percent": ("%\nG0 X1\n%\nthis is not read", [1]),
    "program number behind a percent": ("%\nO12\nG0 X1\n%", [1]),
    "no control in comments": ("(o1 if [0])\nG0 X1\n; o1 endif", [1]),
    "line numbers": ("N10 o1 repeat [2]\nN20 G0 X1\nN30 o1 endrepeat", [1, 1]),
    "comments beside": ("o1 repeat [2] (twice)\nG0 X1\no1 endrepeat ; done", [1, 1]),
    "blanks and case": ("O 1 Re Peat[ 2 ]\nG0 X1\n\to1EndRepeat", [1, 1]),
    "empty lines": ("o1 repeat [2]\n\n  \nG0 X1\n\no1 endrepeat\n\n", [1, 1]),
}


def xs(source: str, **options: object) -> list[float]:
    """The X positions of a program's moves."""
    blocks = run(source, axes=("x",), **options)
    return [
        float(point)
        for block in blocks
        if isinstance(block, Polyline)
        for point in block.points[:, 0]
    ]


@pytest.mark.parametrize(("source", "moves"), CASES.values(), ids=CASES)
def test_programs_make_the_expected_moves(source: str, moves: list[float]) -> None:
    assert xs(source) == moves


def test_blocks_of_repeated_lines_have_line_numbers() -> None:
    (block,) = run("o1 repeat [2]\nG0 X1\nG0 X2\no1 endrepeat\nG0 X3")
    assert isinstance(block, Polyline)
    assert block.lines.tolist() == [2, 3, 2, 3, 5]


def test_a_message_in_a_control_line_is_given_when_it_is_executed() -> None:
    found = rows(
        run(
            "o1 if [0] (msg, one)\n(msg, two)\no1 else\no1 endif\no2 repeat [2] (msg, three)\n"
            "o2 endrepeat"
        )
    )
    assert list(found) == [("message", "one"), ("message", "three")]


@pytest.mark.parametrize(("on", "moves"), [(False, [1, 1, 2]), (True, [2])])
def test_block_delete_applies_to_control_lines(on: bool, moves: list[float]) -> None:
    assert xs("/ o1 repeat [2]\n/G0 X1\n / o1 endrepeat\nG0 X2", block_delete=on) == moves


def test_block_delete_hides_subroutines_and_faulty_lines() -> None:
    assert xs(
        "/o1 sub\n/G0 X1\n/o1 endsub\n/ ???\no1 call\nM2\no1 sub\nG0 X2\no1 endsub",
        block_delete=True,
    ) == [2]


def test_linuxcnc_accepts_both_forms_of_end() -> None:
    assert xs("G0 X1\nM2", dialect="linuxcnc") == [1]
    assert xs("%\nG0 X1\n%", dialect="linuxcnc") == [1]
    assert xs("G0 X1\nM30\n", dialect="linuxcnc") == [1]


def test_progress_is_reported_in_executed_lines() -> None:
    reported: list[int] = []
    xs("o1 repeat [5000]\nG0 X1\no1 endrepeat", on_line=reported.append)
    assert reported[-1] == 10_001
    assert len(reported) > 8
    assert reported == sorted(reported)


def test_blocks_of_an_endless_program_are_yielded() -> None:
    blocks = interpret(
        Text.of_lines(["o1 while [1]", "G0 X1", "M0", "o1 endwhile"], "endless.nc"), axes=("x",)
    )
    first = [next(blocks) for _ in range(100)]
    assert [type(block).__name__ for block in first] == ["Polyline", "Stop"] * 50


def test_the_body_of_a_loop_is_parsed_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    whole = Listing.statement

    def counting(self: Listing, window: object, index: int) -> object:
        read.append(index)
        return whole(self, window, index)  # type: ignore[arg-type]

    monkeypatch.setattr(Listing, "statement", counting)
    xs("o1 repeat [100]\n#1=[#1+1]\nG0 X#1\no1 endrepeat")
    assert sorted(set(read)) == [0, 1, 2, 3]
    assert len(read) <= 8


def test_a_loop_longer_than_a_window() -> None:
    lines = 40_000
    source = "\n".join(
        [
            "o1 repeat [2]",
            *(f"G0 X{n % 1000}" for n in range(lines)),
            "o1 endrepeat",
            "o2 call",
            "M2",
            "o2 sub",
            "G0 X1",
            "o2 endsub",
        ]
    )
    assert xs(source) == [n % 1000 for n in range(lines)] * 2 + [1]


@pytest.mark.parametrize("moves", [2, 3, 10, 500])
def test_lines_within_the_limit_are_accepted(moves: int) -> None:
    """In the second round the moves and the end of the loop are executed again."""
    source = "\n".join(
        [
            "o1 repeat [2]",
            *(f"G0 X{n}" for n in range(moves)),
            "o1 endrepeat",
            "G0 X1\nG0 X2\nG0 X3\nG0 X4\nG0 X5",
        ]
    )
    assert len(xs(source, limits=Limits(repeated_lines=moves + 1))) == 2 * moves + 5
    assert error_of(source, limits=Limits(repeated_lines=moves)).code == "loop-endless"


def test_a_jump_into_a_run_of_moves() -> None:
    source = (
        "GOTO 3\n"
        + "\n".join(f"N{n} G1 X{n} F100" for n in range(10))
        + "\n#1 = #1 + 1\nIF [#1 LT 2] GOTO 8\nM30"
    )
    assert xs(source, dialect="fanuc") == [3, 4, 5, 6, 7, 8, 9, 8, 9]


def test_calls_up_to_the_depth_limit() -> None:
    source = (
        "o1 sub\no2 if [#1 GT 1]\no1 call [#1 - 1]\no2 endif\nG0 X#1\no1 endsub\no1 call [{}]\nM2"
    )
    assert xs(source.format(100)) == list(range(1, 101))
    assert xs(source.format(500), limits=Limits(depth=500))[-1] == 500


@pytest.mark.parametrize(
    ("dialect", "source"),
    [
        ("auto", "#1=5\no1 sub\nM2\no1 endsub\no1 call [7]"),
        ("auto", "#1=5\nM98 P1\nM2\nO1\no2 call [7]\nM99\no2 sub\nM2\no2 endsub"),
        ("fanuc", "#1=5\nM98 P1\nM2\nO1\nG65 P2 A7\nM99\nO2\nM30"),
    ],
)
def test_an_end_in_a_call_restores_the_main_programs_parameters(dialect: str, source: str) -> None:
    parameters = Parameters(macro=dialect == "fanuc")
    xs(source, dialect=dialect, parameters=parameters)
    assert parameters.locals == {1: 5}
    with pytest.raises(IndexError):
        parameters.pop()


def write(folder: Path, **files: str) -> None:
    for name, text in files.items():
        (folder / f"{name}.ngc").write_text(text)


def test_subs_in_files(tmp_path: Path) -> None:
    write(
        tmp_path,
        tree="o<tree> sub\nG0 X#1\no300 call [#1 + 1]\no<tree> endsub [9]\no300 sub\nG0 X#1\n"
        "o300 endsub\n",
        **{
            "12": "(header)\no12 sub\nG0 X12\no12 endsub\nM2\n",
            "77": "O77\nG0 X77\nM99\n",
            "78": "%\nG0 X78\nM99\n%\n",
        },
    )
    source = "o<Tree> call [5]\nG0 X#<_value>\no12 call\nM98 P77 L2\nM98 P78\nG0 X0"
    assert xs(source, folders=[tmp_path]) == [5, 6, 9, 12, 77, 77, 78, 0]


def test_folders_are_searched_in_order_after_the_program(tmp_path: Path) -> None:
    first, second = tmp_path / "a", tmp_path / "b"
    for folder, x in ((first, 1), (second, 2)):
        folder.mkdir()
        write(
            folder,
            one=f"o<one> sub\nG0 X{x}\no<one> endsub",
            own=f"o<own> sub\nG0 X{x}\no<own> endsub",
        )
    (second / "two.nc").write_text("o<two> sub\nG0 X22\no<two> endsub")
    source = "o<one> call\no<two> call\no<own> call\nM2\no<own> sub\nG0 X3\no<own> endsub"
    assert xs(source, folders=[first, second, tmp_path / "missing"]) == [1, 22, 3]


def test_blocks_name_the_file_of_their_line(tmp_path: Path) -> None:
    write(tmp_path, one="o<one> sub\nG0 X1\nG0 X2\no<one> endsub")
    blocks = run("G0 X0\no<one> call\nG0 X3", folders=[tmp_path])
    found = [(block.file, block.lines.tolist()) for block in blocks if isinstance(block, Polyline)]
    assert found == [("test.nc", [1]), (str(tmp_path / "one.ngc"), [2, 3]), ("test.nc", [3])]


def test_calls_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """A program may have a million calls. Only the line of the definition has a kept step."""
    made: list[Listing] = []

    class Watched(Listing):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            made.append(self)

    monkeypatch.setattr(program, "Listing", Watched)
    run("o1 sub\nG0 X[#1]\no1 endsub\n" + "".join(f"o1 call [{number}]\n" for number in range(50)))
    assert made[0].steps.keys() == {1}


@pytest.mark.parametrize("dialect", ["auto", "linuxcnc", "fanuc"])
def test_nothing_behind_the_second_percent_is_called(dialect: str) -> None:
    found = error_of("%\nM98 P2\nM30\n%\nO2\nG0 X9\nM99", dialect=dialect)
    assert found.code == "program-unknown"


def test_a_percent_without_a_first_one_ends_no_program() -> None:
    found = error_of("G0 X1\n%\nG0 X2\nM2")
    assert (found.code, found.line) == ("percent-place", 2)
    assert error_of("G0 X1\n%", dialect="linuxcnc").code == "percent-place"


def test_an_unopened_percent_in_the_last_line_is_a_warning() -> None:
    warnings: list[Diagnostic] = []
    assert xs("G0 X1\n%\n\n", warn=warnings.append) == [1]
    assert [each.code for each in warnings] == ["percent-unopened"]
