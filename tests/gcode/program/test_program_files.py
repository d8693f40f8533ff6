"""Subroutines in files, and the percent signs around a program."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.gcode.dialects.recognition import recognise
from cnc.model.blocks import Polyline
from cnc.model.diagnostics import Diagnostic
from tests.support.gcode.flow_moves import xs
from tests.support.gcode.gcode_cases import assert_error_at, block_summaries, error_of, run


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


@pytest.mark.parametrize("dialect", ["auto", "linuxcnc", "fanuc"])
def test_nothing_behind_the_second_percent_is_called(dialect: str) -> None:
    found = error_of("%\nM98 P2\nM30\n%\nO2\nG0 X9\nM99", dialect=dialect)
    assert found.code == "program-unknown"


def test_a_percent_without_a_first_one_ends_no_program() -> None:
    found = error_of("G0 X1\n%\nG0 X2\nM2")
    assert (found.code, found.line) == ("percent-place", 2)
    assert error_of("G0 X1\n%", dialect="linuxcnc").code == "percent-place"


def test_code_behind_the_percent_that_ends_a_program_is_reported() -> None:
    program = "%\nG0 X1\n%\n(end)\nG0 X2"
    assert (error_of(program).code, error_of(program).line) == ("percent-place", 3)
    warnings: list[Diagnostic] = []
    blocks = run(program, dialect="linuxcnc", warn=warnings.append)
    assert len(blocks) == 1
    assert [(each.code, each.line) for each in warnings] == [("percent-code-behind", 3)]
    assert "line 5" in warnings[0].message
    assert xs("%\nG0 X1\n%\n(end X2)\nthe end") == [1]
    assert xs("%\nG0 X1\nM2\n%\nG0 X2") == [1]


def test_an_unopened_percent_in_the_last_line_is_a_warning() -> None:
    warnings: list[Diagnostic] = []
    assert xs("G0 X1\n%\n\n", warn=warnings.append) == [1]
    assert [each.code for each in warnings] == ["percent-unopened"]


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "auto"])
@pytest.mark.parametrize("head", ["PART 17 FOR A CUSTOMER", "\nfrom: CNC-3\n(a comment)", "..."])
def test_text_before_the_first_percent_is_a_leader(head: str, dialect: str) -> None:
    warnings: list[Diagnostic] = []
    program = f"{head}\n%\nO7\nM98 P8\nG0 X1.\nM30\nO8\nG0 X2.\nM99\n%\n"
    assert xs(program, dialect=dialect, warn=warnings.append) == [2, 1]
    assert [(each.code, each.line) for each in warnings] == [("percent-leader", 1)]
    assert error_of(program, dialect="linuxcnc").line == 1 + head.startswith("\n")


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "auto"])
@pytest.mark.parametrize("head", ["PART NAME 12", "it does not work, %", "Деталь №2"])
def test_a_text_before_the_number_of_the_program_is_a_leader(head: str, dialect: str) -> None:
    """FANUC Series 16i: what precedes the first end of line is not read."""
    warnings: list[Diagnostic] = []
    program = f"{head}\nO7\nG0 X1.\nM30\n"
    assert xs(program, dialect=dialect, warn=warnings.append) == [1]
    assert [(each.code, each.line) for each in warnings] == [("percent-leader", 1)]
    assert error_of(program, dialect="linuxcnc").line == 1
    assert recognise(program.split("\n")).dialect == "fanuc"


@pytest.mark.parametrize(
    ("program", "line"),
    [
        ("G0 X1.\nnothing\n%\nO2\nG0 X2.\nM30\n%", 2),  # a program without its first %
        ("G0 X1.Y\n%\n", 1),
        ("nothing G4O\nO1\nG0 X1.\nM30\n", 1),
        ("nothing X1\nO1\nG0 X1.\nM30\n", 1),
        ("nothing\nat all\nO1\nG0 X1.\nM30\n", 1),
        ("nothing\nO1 X1.\nM30\n", 1),
        ("nothing\n" * 21 + "%\nO1\nG0 X1.\nM30\n%", 1),
    ],
)
def test_a_line_that_belongs_to_the_program_is_no_leader(program: str, line: int) -> None:
    assert error_of(program, dialect="fanuc").line == line


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "auto"])
def test_a_called_program_behind_the_last_percent_is_named(dialect: str) -> None:
    """The control ends to read at the second %."""
    program = "%\nO1\nM98 P10\nM30\n%\n\n(SUB)\nO10\nG0 X1.\nM99\n"
    found = error_of(program, dialect=dialect)
    assert (found.code, found.line) == ("program-unknown", 3)
    assert found.hint == "O10 stands behind the % in line 5, which ends the text: remove it"


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "auto"])
def test_a_program_may_have_a_name_in_angle_brackets(dialect: str) -> None:
    """FANUC's Series 30i names programs; another name begins another program."""
    assert xs("%\n<PART-1.NC> (OP 10)\nG0 X1.\nM30\n<OTHER>\nG0 X2.\nM99", dialect=dialect) == [1]
    found = error_of("<A>\nG0 X1.\n<B>\nG0 X2.\nM30", dialect=dialect)
    assert (found.code, found.line) == ("program-end-missing", 3)
    assert error_of("G0 X1.\nG1 <5> X2.", dialect=dialect).code == "character-unknown"


@pytest.mark.parametrize("around", ["\0\0", "\2", "\3", "\x0c", "\x12", "\x14", "\x1a", "\x7f\x7f"])
def test_what_tapes_and_links_put_around_a_line_means_nothing(around: str) -> None:
    """ISO 6983-1: the blank (NUL), the erasure (DEL) and reader codes are no part of a block."""
    plain = "%\nG21\nG0 X1\nM30\n%"
    marked = "\n".join(f"{around}{line}{around}" for line in plain.split("\n"))
    assert block_summaries(marked) == block_summaries(plain)
    assert_error_at("number-missing", f"{around}G0 ¦X")
    assert error_of(f"{around}G0 X1", dialect="linuxcnc").code == "control-character"
