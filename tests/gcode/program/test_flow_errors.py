"""Faults of control flow with the code, line and column of their errors.

The mark ¦ stands before the faulty part. It is removed before the program is run.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.gcode.core.call_stack import Limits
from cnc.gcode.core.program import ProgramOptions, interpret
from cnc.gcode.reader.source_text import Text
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError
from tests.support.gcode.gcode_cases import assert_diagnostic_at, assert_error_at, error_of
from tests.support.work import at_most

NGC: dict[str, tuple[str, str]] = {
    # blocks
    "if without end": ("block-not-closed", "¦o1 if [1]\nG0 X1"),
    "inner if without end": ("block-not-closed", "o1 while [1]\n ¦o2 if [1]\nG0 X1"),
    "while without end": ("block-not-closed", "G0 X1\n ¦o1 while [1]\nG0 X1"),
    "do without end": ("block-not-closed", "¦o1 do\nG0 X1"),
    "repeat without end": ("block-not-closed", "¦o1 repeat [3]\nG0 X1"),
    "cut by the end of its sub": ("block-not-closed", "o1 sub\n¦o2 if [1]\no1 endsub\no1 call"),
    "cut by a program": ("block-not-closed", "¦o2 while [1]\nO100\no2 endwhile\nM2"),
    "endif without if": ("block-not-open", "G0 X1\n¦o1 endif"),
    "endif of another label": ("block-not-open", "o1 if [1]\n¦o2 endif\no1 endif"),
    "endwhile without while": ("block-not-open", "¦o1 endwhile"),
    "endrepeat without repeat": ("block-not-open", "¦o<two> endrepeat"),
    "else without if": ("block-not-open", "G0 X1\n  ¦o1 else"),
    "elseif without if": ("block-not-open", "¦o1 elseif [1]\no1 endif"),
    "else of a while": ("block-not-open", "o1 while [1]\n¦o1 else\no1 endwhile"),
    "endwhile of a do": ("block-not-open", "o1 do\n¦o1 endwhile"),
    "endwhile of a repeat": ("block-not-open", "o1 repeat [1]\n¦o1 endwhile\no1 endrepeat"),
    "crossed blocks": ("block-crossed", "o1 if [1]\no2 while [1]\n¦o1 endif\no2 endwhile"),
    "crossed by else": (
        "block-crossed",
        "o1 if [1]\no2 repeat [1]\n¦o1 else\no2 endrepeat\no1 endif",
    ),
    "crossed do": ("block-crossed", "o1 do\no2 do\n¦o1 while [1]\no2 while [1]"),
    "else twice": ("else-repeated", "o1 if [1]\no1 else\n¦o1 else\no1 endif"),
    "elseif after else": ("else-repeated", "o1 if [1]\no1 else\n¦o1 elseif [1]\no1 endif"),
    "a label used again": ("label-repeated", "o1 if [1]\no1 endif\n¦o1 if [1]\no1 endif"),
    "a label within itself": (
        "label-repeated",
        "o1 while [1]\n¦o1 repeat [1]\no1 endrepeat\no1 endwhile",
    ),
    "a label of another kind": (
        "label-repeated",
        "o<a b> repeat [1]\no<ab> endrepeat\n¦o<AB> do\no<ab> while [0]",
    ),
    "a computed label": ("label-computed", "#1=5\n¦o[#1] if [1]\no5 endif"),
    "a computed label of a sub": ("label-computed", "#1=5\n¦o#1 sub\no5 endsub"),
    "break outside": ("loop-not-open", "G0 X1\n¦o1 break"),
    "break of an if": ("loop-not-open", "o1 if [1]\n¦o1 break\no1 endif"),
    "break of a repeat": ("loop-not-open", "o1 repeat [2]\nG0 X1\n¦o1 break\no1 endrepeat"),
    "continue of another loop": ("loop-not-open", "o1 while [1]\n¦o2 continue\no1 endwhile"),
    "break behind its loop": ("loop-not-open", "o1 while [0]\no1 endwhile\n¦o1 break"),
    "break of the caller's loop": (
        "loop-not-open",
        "o5 sub\n¦o1 break\no5 endsub\no1 while [1]\no5 call\no1 endwhile",
    ),
    "a fault in the block that is not taken": (
        "block-not-open",
        "o1 if [0]\n¦o2 endwhile\no1 endif",
    ),
    # values
    "a condition that can't be computed": ("division-by-zero", "o1 while [1 ¦/ 0]\no1 endwhile"),
    "a condition that can't be computed the second time": (
        "division-by-zero",
        "#1=1\no1 while [1 ¦/ #1]\n#1=0\no1 endwhile",
    ),
    "elseif that can't be computed": (
        "division-by-zero",
        "o1 if [0]\no1 elseif [1 ¦/ 0]\no1 endif",
    ),
    "a count that can't be computed": ("division-by-zero", "o1 repeat [1 ¦/ 0]\no1 endrepeat"),
    "an argument that was never set": (
        "parameter-undefined",
        "o1 sub\no1 endsub\no1 call [1] [¦#<depth>]",
    ),
    "a local name of the caller": (
        "parameter-undefined",
        "o1 sub\nG0 X¦#<a>\no1 endsub\n#<a>=1\no1 call",
    ),
    "a name after the return": (
        "parameter-undefined",
        "o1 sub\n#<a>=1\no1 endsub\no1 call\nG0 X¦#<a>",
    ),
    "the result is no parameter to set": ("parameter-read-only", "¦#<_value>=1"),
    # subroutines
    "no such sub": ("sub-unknown", "G0 X1\n¦o1 call"),
    "no such name": ("sub-unknown", "¦o<drill> call [1]"),
    "no such computed label": ("sub-unknown", "#1=5\n¦o[#1*2] call"),
    "half a label": ("label-bad", "¦o[1/2] call"),
    "an absurd label": ("label-bad", "¦o[10**300] call"),
    "negative label": ("label-bad", "¦o[-1] call"),
    "sub without end": ("sub-not-closed", "¦o1 sub\nG0 X1"),
    "sub behind without end": ("sub-not-closed", "o1 call\nM2\n  ¦o1 sub\nG0 X1"),
    "sub in a sub": ("sub-nested", "o1 sub\n¦o2 sub\no2 endsub\no1 endsub"),
    "sub in a block": ("sub-nested", "o1 if [1]\n¦o2 sub\no2 endsub\no1 endif"),
    "end of another sub": ("sub-not-open", "o1 sub\n¦o2 endsub\no1 endsub"),
    "end without sub": ("sub-not-open", "G0 X1\n¦o1 endsub"),
    "return outside": ("sub-not-open", "¦o1 return"),
    "sub twice": ("sub-repeated", "o1 sub\no1 endsub\n¦o1 sub\no1 endsub"),
    "sub twice behind": ("sub-repeated", "o1 call\nM2\no1 sub\no1 endsub\n¦o1 sub\no1 endsub"),
    "thirty-one arguments": ("call-arguments", f"o1 sub\no1 endsub\n¦o1 call {'[1]' * 31}"),
    "call of itself": ("call-too-deep", "o1 sub\nG0 X1\n ¦o1 call\no1 endsub\no1 call"),
    "calls in a circle": (
        "call-too-deep",
        "o1 sub\n¦o2 call\no1 endsub\no2 sub\no1 call\no2 endsub\no2 call",
    ),
    "a name that no file has": ("sub-unknown", "¦o<drill!> call"),
    "a sub that runs into a program": ("sub-not-closed", "¦o1 sub\nG0 X1\nO100\nM99"),
    "a path for a name": ("sub-file-outside", "¦o<../secret> call"),
    "a path from the root": ("sub-file-outside", "¦o</etc/passwd> call"),
    "a path of another system": ("sub-file-outside", "¦o<c:\\drill> call"),
    # programs
    "no such program": ("program-unknown", "M98 ¦P100\nM2"),
    "M98 without P": ("program-number-missing", "G0 X1 ¦M98\nM2"),
    "half a program": ("value-out-of-range", "M98 ¦P1.5\nM2"),
    "negative repeats": ("value-out-of-range", "M98 P1 ¦L-1\nM2\nO1\nM99"),
    "half a repeat": ("value-out-of-range", "M98 P1 ¦L2.5\nM2\nO1\nM99"),
    "P twice": ("word-repeated", "M98 P1 ¦P2\nM2\nO1\nM99"),
    "a word for nobody": ("word-unused", "M98 P1 ¦Q2\nM2\nO1\nM99"),
    "M99 with a block": ("word-unused", "M98 P1\nM2\nO1\nM99 ¦P2"),
    "M99 in a sub": ("call-style-mixed", "o1 sub\n¦M99\no1 endsub\no1 call"),
    "a program called as a sub": ("call-style-mixed", "¦o100 call\nM2\nO100\nM99"),
    "a sub called as a program": ("call-style-mixed", "o100 sub\no100 endsub\nM98 ¦P100\nM2"),
    "endsub in a program": ("sub-not-open", "M98 P1\nM2\nO1\n¦o1 endsub"),
    "a program that runs into the next": (
        "subprogram-not-ended",
        "M98 P1\nM2\n¦O1\nG0 X1\nO2\nM99",
    ),
    "a program that runs into the end": ("subprogram-not-ended", "M98 P1\nM2\n¦O1\nG0 X1"),
    "a program that runs into a percent": ("subprogram-not-ended", "%\nM98 P1\nM2\n¦O1\nG0 X1\n%"),
    "a program twice": ("program-repeated", "M98 P1\nM2\nO1\nM99\n¦O1\nM99"),
    "a main program that runs into the next": ("program-end-missing", "G0 X1\n¦O1\nM99"),
    "a second number": ("program-end-missing", "O1\n¦O2\nG0 X1\nM2"),
    "M98 calls itself": ("call-too-deep", "M98 P1\nM2\nO1\n¦M98 P1\nM99"),
    "a computed M98": ("call-not-alone", "¦M[98] P1\nM2\nO1\nM99"),
    "a computed M99": ("call-not-alone", "M98 P1\nM2\nO1\n¦M[99]"),
    "a call and a return": ("call-not-alone", "M98 P1 ¦M99\nM2\nO1\nM99"),
    "G65 is FANUC's": ("code-not-in-dialect", "¦G65 P1 A1\nM2\nO1\nM99"),
}

FANUC: dict[str, tuple[str, str]] = {
    "goto nowhere": ("jump-target-missing", "N1 G0 X1\n¦GOTO 5"),
    "goto into another program": ("jump-target-missing", "¦GOTO 5\nM30\nO2\nN5 M99"),
    "goto out of a program": ("jump-target-missing", "N5 M98 P2\nM30\nO2\n¦GOTO 5\nM99"),
    "goto half a block": ("jump-target-bad", "#1=2.5\n¦GOTO #1\nN2"),
    "M99 in the main program": ("program-endless", "G0 X1\n¦M99"),
    "goto 0": ("jump-target-bad", "¦GOTO 0"),
    "goto vacant": ("jump-target-bad", "¦GOTO #1"),
    "goto into a loop": ("block-not-open", "GOTO 5\nWHILE [1 EQ 1] DO1\nN5 G0 X1\n¦END1"),
    "goto back into a loop": (
        "jump-into-loop",
        "WHILE [#1 LT 1] DO1\nN5 #1=#1+1\nEND1\n¦IF [#1 EQ 1] GOTO 5",
    ),
    "do without end": ("block-not-closed", "¦WHILE [1 EQ 1] DO1\nG0 X1"),
    "do cut by the next program": ("block-not-closed", "¦DO1\nM30\nO2\nEND1\nM99"),
    "end without do": ("block-not-open", "G0 X1\n¦END1"),
    "end of another do": ("block-not-open", "DO1\n¦END2\nEND1"),
    "crossed loops": ("block-crossed", "DO1\nDO2\n¦END1\nEND2"),
    "a loop within itself": ("label-repeated", "DO1\n¦DO1\nEND1\nEND1"),
    "a fourth loop": ("loop-number-bad", "¦WHILE [1 EQ 1] DO4\nEND4"),
    "loop 0": ("loop-number-bad", "¦DO0\nEND0"),
    "M98 of vacant": ("program-number-missing", "¦M98 P#1"),
    "G65 without P": ("program-number-missing", "¦G65 A1"),
    "G65 of no program": ("program-unknown", "G65 ¦P5 A1"),
    "an argument before G65": ("argument-bad", "¦A1 G65 P2\nM30\nO2\nM99"),
    "another code beside G65": ("argument-bad", "G65 P2 ¦G1 X5\nM30\nO2\nM99"),
    "an argument twice": ("word-repeated", "G65 P2 A1 ¦A2\nM30\nO2\nM99"),
    "a computed G65": ("call-not-alone", "¦G[65] P2\nM30\nO2\nM99"),
    "eleven threes": ("argument-bad", f"G65 P2 {'I1 ' * 10}¦I1\nM30\nO2\nM99"),
    "return to no block": ("jump-target-missing", "M98 P2\nM30\nO2\n¦M99 P7"),
    "M99 to no block": ("jump-target-missing", "G0 X1\n¦M99 P7"),
    "return to half a block": ("value-out-of-range", "M98 P2\nM30\nO2\nM99 ¦P7.5"),
}


@pytest.mark.parametrize(("code", "source"), NGC.values(), ids=NGC)
def test_the_error_has_its_code_and_place(code: str, source: str) -> None:
    assert_error_at(code, source)


@pytest.mark.parametrize(("code", "source"), FANUC.values(), ids=FANUC)
def test_the_error_of_a_macro_has_its_code_and_place(code: str, source: str) -> None:
    assert_error_at(code, source, dialect="fanuc")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("o1 if [1]\no2 while [1]\no1 endif\no2 endwhile", "o1 endif inside o2 while of line 2"),
        ("o1 if [1]\no1 else\no1 else\no1 endif", "after the else of line 2"),
        ("\no1 if [1]\no1 endif\no1 do\no1 while [0]", "in line 2"),
        ("o1 sub\no2 sub\no2 endsub\no1 endsub", "inside o1 sub of line 1"),
        ("o1 repeat [1]\no1 break\no1 endrepeat", "o1 repeat of line 1 is not a while or do loop"),
        ("o1 if [1]\nG0 X1", "o1 endif is missing"),
        ("o<pocket> sub\no<pocket> endsub\no<poket> call", "did you mean o<pocket>?"),
        ("o<drill> call", "no drill.ngc in the folders"),
        ("o<x y> do\nG0 X1", "o<xy> while is missing"),
    ],
)
def test_the_message_names_the_other_line(source: str, words: str) -> None:
    found = error_of(source)
    assert words in f"{found.message} {found.hint}"


ENDLESS: dict[str, tuple[str, str, str]] = {
    "while without body": ("auto", "¦o1 while [1]\no1 endwhile", "o1 while"),
    "do without body": ("auto", "G0 X1\n ¦o<x> do\no<x> while [1]", "o<x> do"),
    "a condition that never changes": (
        "auto",
        "#1=0\n¦o1 while [#1 LT 5]\nG0 X#1\no1 endwhile",
        "o1 while",
    ),
    "repeat for ever": ("auto", "¦o1 repeat [10**18]\no1 endrepeat", "o1 repeat"),
    "continue for ever": ("auto", "¦o1 while [1]\no1 continue\no1 endwhile", "o1 while"),
    "the inner loop": (
        "auto",
        "o1 repeat [3]\n¦o2 while [1]\nG0 X1\no2 endwhile\no1 endrepeat",
        "o2 while",
    ),
    "the outer loop": (
        "auto",
        "¦o1 while [1]\no2 repeat [50]\nG0 X1\no2 endrepeat\no1 endwhile",
        "o1 while",
    ),
    "the loop that calls": (
        "auto",
        "o5 sub\no2 repeat [9]\nG0 X1\no2 endrepeat\no5 endsub\n¦o1 while [1]\no5 call\n"
        "o1 endwhile",
        "o1 while",
    ),
    "the loop in the sub": (
        "auto",
        "o5 sub\n¦o2 while [1]\no2 endwhile\no5 endsub\no1 repeat [9]\no5 call\no1 endrepeat",
        "o2 while",
    ),
    "a loop without rounds in the loop": (
        "auto",
        "¦o1 while [1]\no2 repeat [0]\nG0 X1\no2 endrepeat\no1 endwhile",
        "o1 while",
    ),
    "a loop without rounds in a longer loop": (
        "auto",
        "¦o1 while [1]\nG0 X1\no2 repeat [0]\nG0 X1\no2 endrepeat\no1 endwhile",
        "o1 while",
    ),
    "calls that branch": (
        "auto",
        "o1 sub\no2 if [#1 GT 0]\no1 call [#1 - 1]\no1 call [#1 - 1]\no2 endif\no1 endsub\n"
        "¦o1 call [50]",
        "the call of o1",
    ),
    "repeats of a program": ("auto", "¦M98 P1 L99999999\nM2\nO1\nM99", "the call of O1"),
    "goto itself": ("fanuc", "N1 ¦GOTO 1", "this GOTO"),
    "goto there and back": ("fanuc", "GOTO 2\nN1 G0 X1\nN2 ¦GOTO 1", "this GOTO"),
    "DO for ever": ("fanuc", "¦DO1\nEND1", "DO1"),
    "WHILE for ever": ("fanuc", "¦WHILE [#1 EQ #0] DO2\nG0 X1\nEND2", "DO2"),
    "M99 P in the main program": ("fanuc", "N1 G0 X1\n¦M99 P1", "this M99"),
    "M99 P back to the call": ("fanuc", "N1 G0 X1\n¦M98 P2\nM30\nO2\nM99 P1", "the call of O2"),
}


@pytest.mark.parametrize(("dialect", "source", "name"), ENDLESS.values(), ids=ENDLESS)
def test_an_endless_program_is_stopped(dialect: str, source: str, name: str) -> None:
    with at_most(calls=500_000):
        found = assert_error_at(
            "loop-endless", source, dialect=dialect, limits=Limits(repeated_lines=1000)
        )
    assert found.message == f"{name} does not end: more than 1 000 lines were executed again"


def test_two_million_lines_are_executed_without_a_call_each() -> None:
    with at_most(calls=500_000):
        assert error_of("o1 while [1]\no1 endwhile").code == "loop-endless"


def test_after_an_error_nothing_is_executed() -> None:
    blocks = interpret(Text.of_lines(["M3 S5", "o1 call", "M5"], "p.nc"))
    assert type(next(blocks)).__name__ == "Spindle"
    with pytest.raises(GcodeError):
        next(blocks)
    assert not list(blocks)


@pytest.mark.parametrize(
    ("source", "line", "column", "text"),
    [
        ("%\nG0 X1", 2, 1, "G0 X1"),
        ("G0 X1\nG0 X2\n\n", 2, 1, "G0 X2"),
        ("", 1, 0, ""),
        ("o1 sub\nM2\no1 endsub", 3, 1, "o1 endsub"),
    ],
)
def test_linuxcnc_requires_an_end(source: str, line: int, column: int, text: str) -> None:
    found = error_of(source, dialect="linuxcnc")
    assert (found.code, found.line, found.column, found.text) == (
        "program-end-missing",
        line,
        column,
        text,
    )


FILES: dict[str, tuple[str, str, str]] = {
    "a fault in the file": ("word-unused", "o<f> sub\nG0 X1\nG0 X2 ¦Q5\no<f> endsub", "o<f> call"),
    "a line that can't be read": ("number-missing", "o<f> sub\nG0 ¦X\no<f> endsub", "o<f> call"),
    "no end": ("sub-not-closed", "(f)\n¦o<f> sub\nG0 X1", "o<f> call"),
    "blocks in the file": ("block-not-open", "o<f> sub\n¦o1 endif\no<f> endsub", "o<f> call"),
    "twice": ("sub-repeated", "o<f> sub\no<f> endsub\n¦o<f> sub\no<f> endsub", "o<f> call"),
    "a call from the file": ("sub-unknown", "o<f> sub\n ¦o<g> call\no<f> endsub", "o<f> call"),
    "the second line of a loop": (
        "division-by-zero",
        "o<f> sub\no1 while [1¦/#5]\no1 endwhile\no<f> endsub",
        "o<f> call",
    ),
}


@pytest.mark.parametrize(("code", "file", "main"), FILES.values(), ids=FILES)
def test_an_error_names_its_file(tmp_path: Path, code: str, file: str, main: str) -> None:
    (tmp_path / "f.ngc").write_text(file.replace("¦", ""))
    assert_diagnostic_at(
        error_of(main, folders=[tmp_path]), code, file, file=str(tmp_path / "f.ngc")
    )


def test_after_a_return_errors_name_the_program(tmp_path: Path) -> None:
    (tmp_path / "f.ngc").write_text("o<f> sub\nG0 X1\no<f> endsub")
    found = error_of("o<f> call\nG0 X2 Q1", folders=[tmp_path])
    assert (found.file, found.line, found.column, found.text) == ("test.nc", 2, 7, "G0 X2 Q1")


def test_a_file_without_the_subroutine(tmp_path: Path) -> None:
    (tmp_path / "f.ngc").write_text("o<g> sub\no<g> endsub")
    found = error_of("G0 X1\n o<f> call", folders=[tmp_path])
    assert (found.code, found.file, found.line, found.column) == ("sub-file-empty", "test.nc", 2, 2)
    assert str(tmp_path / "f.ngc") in found.message


def test_a_link_to_a_file_outside_of_the_folder(tmp_path: Path) -> None:
    inside, outside = tmp_path / "subs", tmp_path / "secret.ngc"
    inside.mkdir()
    outside.write_text("o<f> sub\nG0 X1\no<f> endsub")
    (inside / "f.ngc").symlink_to(outside)
    assert error_of("o<f> call", folders=[inside]).code == "sub-file-outside"
    (inside / "f.ngc").unlink()
    (inside / "g.ngc").write_text("o<f> sub\nG0 X1\no<f> endsub")
    (inside / "f.ngc").symlink_to(inside / "g.ngc")
    assert list(
        interpret(Text.of_lines(["o<f> call"], "t"), options=ProgramOptions(folders=[inside]))
    )


def test_an_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "f.ngc").write_text("o<f> sub\no<f> endsub")

    def locked(path: Path, name: str) -> Text:
        raise UsageError(Diagnostic("unreadable-file", f"can't read {name}: it is locked"))

    monkeypatch.setattr(Text, "of_file", locked)
    found = error_of("G0 X1\n o<f> call", folders=[tmp_path])
    assert (found.code, found.line, found.column) == ("unreadable-file", 2, 2)
    assert "it is locked" in found.message


def test_a_folder_is_not_a_subroutine_file(tmp_path: Path) -> None:
    (tmp_path / "f.ngc").mkdir()
    assert error_of("o<f> call", folders=[tmp_path]).code == "sub-unknown"
    assert error_of(f"o<{'f' * 1000}> call", folders=[tmp_path]).code == "sub-unknown"


def test_the_number_alone_that_ends_a_subroutine_is_named() -> None:
    found = error_of("o<f> sub\no3 if [1]\nO3\no<f> endsub\nM2", dialect="linuxcnc")
    assert (found.code, found.line) == ("sub-not-closed", 1)
    assert "before O3 in line 3" in found.hint
