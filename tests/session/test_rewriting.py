"""``cncrun format``: the form of lines, and that programs keep their blocks."""

from __future__ import annotations

import random
import re
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc import parse
from cnc.cli import exit_code
from cnc.gcode import dialects
from cnc.gcode.reader.layout import formatted
from cnc.machine.load import load_machine
from cnc.model.blocks import Block, Polyline
from cnc.model.choices import TextStyle
from cnc.model.diagnostics import CncError
from cnc.session import rewriting
from tests.support.corpus import STYLES
from tests.support.soak import share

MACHINE = load_machine(None)
FORMS = [
    # dialect, as written, readable, compact
    ("linuxcnc", "g01 x01.50 y-.5 f010.0 (Ab)", "G1 X1.5 Y-0.5 F10. (Ab)", "G1X1.5Y-.5F10.(Ab)"),
    ("linuxcnc", "G1 Y+2 X 3\tF100", "G1 X3 Y2 F100", "G1X3Y2F100"),
    ("linuxcnc", "x-0 z00 m03 s0500", "X-0 Z0 M3 S500", "X-0Z0M3S500"),
    ("linuxcnc", "g54.1 p01", "G54.1 P01", "G54.1P01"),
    ("linuxcnc", "t01 m06 ; Tool 1 ", "T01 M6 ; Tool 1", "T01M6; Tool 1"),
    ("linuxcnc", "m98 p0100 l02", "M98 P0100 L02", "M98P0100L02"),
    ("linuxcnc", "g43 h01 z5.", "G43 H01 Z5.", "G43H01Z5."),
    ("linuxcnc", "#1=[ 3 mod 2 ]#<_Ab c>= 05", "#1=[3 MOD 2] #<_Ab c>=05", "#1=[3MOD2]#<_Ab c>=05"),
    ("linuxcnc", "  o100 if [#1 eq 02]", "  O100 IF [#1 EQ 02]", "O100IF[#1EQ02]"),
    ("linuxcnc", "/ n020 g1x5", "/N020 G1 X5", "/N020G1X5"),
    ("linuxcnc", "", "", ""),
    ("grbl", "$h", "$h", "$h"),
    ("fanuc", "if [#1 gt 5.0] goto 0010", "IF [#1 GT 5.0] GOTO 0010", "IF[#1GT5.0]GOTO0010"),
    ("fanuc", "o0001 (PART)", "O0001 (PART)", "O0001(PART)"),
    ("fanuc", "x100 y.", "x100 y.", "x100 y."),  # not a number: it stays
    ("siemens", "n10  g01 X = r1 +2.50 y05.0", "N10 G1 X=r1+2.50 Y5.", "N10 G1 X=r1+2.50 Y5."),
    ("siemens", 'msg ( "Ab  c" )  ; Note', 'msg("Ab  c") ; Note', 'msg("Ab  c") ; Note'),
    ("siemens", "if r1 > 5 gotof ende", "if r1>5 gotof ende", "if r1>5 gotof ende"),
    ("heidenhain", "10  l  x+10.50   r0 fmax", "10 L X+10.50 R0 FMAX", "10 L X+10.50 R0 FMAX"),
    ("marlin", "y1 g1 x02", "Y1 G1 X2", "Y1G1X2"),  # the command comes first there
]  # fmt: skip


def written(path: Path, text: str, dialect: str, style: TextStyle) -> str:
    """Return a text in a style."""
    path.write_bytes(text.encode())
    rules = dialects.load(dialect)
    return b"".join(formatted(path, rules, style)).decode()


@pytest.mark.parametrize(("dialect", "line", "readable", "compact"), FORMS)
def test_lines_have_one_form(
    tmp_path: Path, dialect: str, line: str, readable: str, compact: str
) -> None:
    file = tmp_path / "a.nc"
    for style, wanted in zip(get_args(TextStyle), (readable, compact), strict=True):
        text = written(file, f"{line}\r\n", dialect, style)
        assert text == f"{wanted}\r\n"
        assert written(file, text, dialect, style) == text


def test_the_compact_style_leaves_out_what_is_in_effect(tmp_path: Path) -> None:
    lines = [
        "N1 G1 X1 F100", "N2 G1 Y2 F100.0", "N3 G0 Z1", "N4 G1 X2 F100", "N5 G1 F100",
        "N6 G53 G0 Z0", "N7 G0 X1", "N8 G1 X2 F100 M5", "N9 G1 X3 F100 M6", "N10 G1 X4 F100",
        "N11 G93 G1 X5 F2", "N12 G1 X6 F2", "N13", "N14 X1 X2 G1",
    ]  # fmt: skip
    wanted = [
        "G1X1F100", "Y2", "G0Z1", "G1X2", "G1F100",
        "G53G0Z0", "G0X1", "G1X2F100M5", "G1X3F100M6", "G1X4F100",
        "G93G1X5F2", "G1X6F2", "N13", "X1X2G1",
    ]  # fmt: skip
    text = written(tmp_path / "a.nc", "\n".join(lines), "linuxcnc", "compact")
    assert text.split("\n") == wanted


@pytest.mark.parametrize("word", ["GOTO 2", "M99", "G65 P9000", "G71 P1 Q2", "O<a> CALL", "#1=5"])
def test_lines_that_may_be_reached_from_elsewhere_keep_their_words(
    tmp_path: Path, word: str
) -> None:
    text = f"N1 G1 X1 F100\nN2 G1 X2 F100\n{word}\n"
    first = written(tmp_path / "a.nc", text, "fanuc", "compact").split("\n")[:2]
    assert first == ["N1G1X1F100", "N2G1X2F100"]


NUMBERS = st.from_regex(r"[+-]?([0-9]{1,7}(\.[0-9]{0,7})?|\.[0-9]{1,7})", fullmatch=True)


@given(st.lists(st.tuples(st.sampled_from("XYZABCIJKRFSGM"), NUMBERS), min_size=1, max_size=12))
def test_numbers_keep_their_value_and_their_point(
    tmp_path_factory: pytest.TempPathFactory, words: list[tuple[str, str]]
) -> None:
    line = " ".join(letter + number for letter, number in words)
    file = tmp_path_factory.mktemp("format") / "a.nc"
    for style in get_args(TextStyle):
        rest = written(file, line, "fanuc", style)
        found = re.findall(r"([A-Z])([-.0-9]+)", rest)

        def values(pairs: list[tuple[str, str]]) -> list[tuple[str, str, bool]]:
            return sorted((key, float(text).hex(), "." in text) for key, text in pairs)

        assert values(found) == values(words)
        assert "+" not in rest
        assert not re.search(r"[A-Z]-?0[0-9]|\.[0-9]*0(?![0-9.])", rest)


def moves(blocks: list[Block]) -> list[Any]:
    """Return blocks move by move, in a form that can be compared, without their file."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return [plain(item) for item in value.tolist()]
        if isinstance(value, tuple | list):
            return list(map(plain, value))
        if isinstance(value, Block):
            return [type(value).__name__] + [
                plain(getattr(value, field.name))
                for field in fields(value)
                if field.name not in ("file", "answer")
            ]
        return value.hex() if isinstance(value, float) else value

    rows: list[Any] = []
    for block in blocks:
        if isinstance(block, Polyline):
            commands = block.commands if block.commands is not None else [None] * len(block.lines)
            columns = (block.points, block.feeds, block.lines, commands)
            rows += [plain([*row]) for row in zip(*map(list, columns), strict=True)]
        else:
            rows.append(plain(block))
    return rows


@pytest.mark.parametrize("style", sorted(STYLES)[:: share(1, 3)])
def test_programs_keep_their_blocks(tmp_path: Path, style: str) -> None:
    for seed in range(share(10, 1)):
        before, after = tmp_path / "before.nc", tmp_path / "after.nc"
        text = STYLES[style](random.Random(f"form {style} {seed}"))
        before.write_bytes(text.encode(errors="surrogateescape"))
        for form in get_args(TextStyle):
            try:
                blocks = list(parse(before))
            except CncError:
                continue
            with rewriting.in_form(str(before), MACHINE, None, form) as result:
                after.write_bytes(result.file.read())
            assert moves(list(parse(after))) == moves(blocks)
            with rewriting.in_form(str(after), MACHINE, None, form) as again:
                assert not again.changed


# The command


def test_one_program_goes_to_standard_output(
    tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    file = tmp_path / "a.nc"
    file.write_bytes(b"\xef\xbb\xbfg00 x1\r\nm30")
    assert exit_code(["format", str(file)]) == 0
    assert capsysbinary.readouterr().out == b"\xef\xbb\xbfG0 X1\r\nM30"
    assert file.read_bytes() == b"\xef\xbb\xbfg00 x1\r\nm30"


def test_check_names_the_programs_that_would_change(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.nc").write_text("g00 x1\nm30\n")
    (tmp_path / "b.nc").write_text("G0 X1\nM30\n")
    assert exit_code(["format", "--check", str(tmp_path)]) == 1
    assert capsys.readouterr().out.split() == ["has", "another", "form", str(tmp_path / "a.nc")]
    assert exit_code(["format", "--check", str(tmp_path / "b.nc")]) == 0


def test_in_place_replaces_the_file_and_keeps_its_mode(tmp_path: Path) -> None:
    file = tmp_path / "a.nc"
    file.write_text("g00 x1\nm30\n")
    file.chmod(0o640)
    assert exit_code(["format", "--in-place", "--style", "compact", str(tmp_path)]) == 0
    assert file.read_text() == "G0X1\nM30\n"
    assert file.stat().st_mode & 0o777 == 0o640
    assert list(tmp_path.iterdir()) == [file]


def test_the_machine_file_names_the_style(
    tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    file, machine = tmp_path / "a.nc", tmp_path / "m.toml"
    file.write_text("g00 x1\n")
    axis = "steps_per_mm = 100\nmax_velocity = 100\nmax_acceleration = 500\nmax_jerk = 5000\n"
    machine.write_text(f"[axes.x]\n{axis}[program]\nstyle = 'compact'\n")
    assert exit_code(["format", str(file), "--machine", str(machine)]) == 0
    assert capsysbinary.readouterr().out == b"G0X1\n"


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--check", "--in-place", "a.nc"], "usage"),
        (["a.nc", "b.nc"], "one-program-only"),
        (["--in-place", "-"], "usage"),
        ([], "no-program"),
        (["missing.nc"], "no-such-file"),
    ],
)
def test_wrong_usage(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.nc", "b.nc"):
        Path(name).write_text("G0 X1\n")
    assert exit_code(["format", *arguments]) == 2
    assert f"{code}: " in capsys.readouterr().err


def test_a_faulty_program_stays_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.nc"
    file.write_text("g00 x1\nx1 y\n")
    assert exit_code(["format", "--in-place", str(file)]) == 1
    shown = capsys.readouterr().err
    assert f"{file}:2:4: number-missing" in shown
    assert "x1 y\n     ^" in shown
    assert file.read_text() == "g00 x1\nx1 y\n"


def test_a_text_with_other_blocks_is_not_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.nc"
    file.write_text("G0 X1\nM30\n")
    monkeypatch.setattr(rewriting, "formatted", lambda *_: iter([b"G0 X2\nM30\n"]))
    assert exit_code(["format", "--in-place", str(file)]) == 1
    assert "format-differs" in capsys.readouterr().err
    assert file.read_text() == "G0 X1\nM30\n"
