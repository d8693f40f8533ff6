"""Plain lines of a window: their words, heads and labels."""

from __future__ import annotations

import itertools
from functools import partial

import pytest

from cnc.gcode.kernels.statements import UNKNOWN
from cnc.gcode.reader import lines
from cnc.gcode.reader.lines import MAX_LINE
from cnc.gcode.reader.parser import Syntax, parse_line
from cnc.gcode.reader.source_text import Text, Window, split
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.adversary import (
    SYNTAXES,
    Adversary,
    agree,
    decoded,
)
from tests.support.soak import share

PLAIN = """\
  \t
G1 X1 Y2
g1x-1.5y+.25z3.f100
N10 G00 X0 Y-0
n0020g01z-5.000 (down) F250.
(only a comment)
; only a comment, too
G0 (a)X1(b)Y2(c);d
(a, comma) X1 ; (msg, not one)
(T1 D=5. CR=0. - ZMIN=-1 - flat end mill)
M3 S12000
G61.1
T1 M6
X123456789.123456
X0.000000000000001
X000000000000012.5
G1 X1 X1
G2 X1 Y1 I.5 J0
E5 H3 D2 L1 P1 Q1 R1 U0 V0 W0 A1 B1 C1 K1
X9007199.254740992
X1000000000
X 1
X1 .5
X1. 5
X- 1
X1 2
""".splitlines()

NOT_PLAIN = """\
X1.2.3
X--1
X
X.
X-
5
X1e5+
G1 X[1+2]
G1 X#1
#1=5
O100 sub
G1 O1
%
/G1 X1
G1 X1 /
(msg, hello)
( MSG, hello) X1
(debug, x)
(print,x)
(LOGCLOSE)
(probeclose)
(py,x)
(not closed
not open)
(one (inside) another)
X9007199.254740993
X0.0000000000000000001
X12345678901234567890
X1000000000.01
X-1000000001
X1 N5
$H
BSPLINE
SD=3
X1=2
G1 X1 é
(é) X1
X1 ;é
X1*2
@
[1]
X1_
{X1}
X`1
""".splitlines()


def window_of(data: bytes) -> Window:
    return Window(1, data, split(data, whole=True))


def test_typical_cam_lines_are_plain() -> None:
    text = Text.of_lines(PLAIN, "t")
    window = text.window(1)
    assert window is not None
    assert window.count == len(PLAIN)
    assert window.plain.tolist() == list(range(len(PLAIN), 0, -1))
    for index, line in enumerate(PLAIN):
        agree(line, window.statement(index, SYNTAXES[0]), SYNTAXES[0])


@pytest.mark.parametrize(
    "line",
    [
        *NOT_PLAIN,
        "X\x0b1",
        "X1\x00",
        "X1\x7f",
        "(\x01)",
        ";\x1f",
        "(\x7f)",
        ";\x80",
        "X1".ljust(MAX_LINE + 1),
    ],
)
def test_other_lines_are_not_plain(line: str) -> None:
    assert window_of(line.encode("latin-1") + b"\n").plain[0] == 0


def test_the_longest_line_is_plain() -> None:
    data = b"X1".ljust(MAX_LINE) + b"\nG1" + b"X1" * (MAX_LINE // 2 - 1)
    assert window_of(data).plain[:2].tolist() == [2, 1]


@pytest.mark.timeout(3600)
def test_plain_lines_have_the_words_of_the_grammar() -> None:
    """The lines equal those of the file, with any kind of line end."""
    amount, batch = share(1_000_000, 8_250), 1000
    plain = 0
    syntaxes = itertools.cycle(SYNTAXES)
    for seed in range(amount // batch):
        data = Adversary(seed).data(batch)
        found, places = window_of(data), split(data, whole=True)
        lines = data.splitlines()
        assert (found.count, places.size) == (len(lines), len(data))
        for index, line in enumerate(lines):
            assert data[places.begin[index] : places.end[index]] == line
            if found.plain[index]:
                syntax = next(syntaxes)
                agree(decoded(line), found.statement(index, syntax), syntax)
                plain += 1
    assert amount * 0.3 < plain < amount * 0.9, (
        "a test of nothing but plain lines, or of none, tests little"
    )


def test_other_lines_have_the_statement_of_the_grammar(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.nc"
    path.write_bytes(Adversary(-1).data(share(20_000, 1_000)))
    text, line = Text.of_file(path), 1
    while window := text.window(line):
        for index in range(window.count):
            outcomes = []
            for read in (
                partial(window.statement, index, SYNTAXES[1]),
                partial(parse_line, window.text(index), SYNTAXES[1]),
            ):
                try:
                    outcomes.append(repr(read()))
                except GcodeError as error:
                    outcomes.append(str(error))
            assert outcomes[0] == outcomes[1]
        line += window.count


@pytest.mark.parametrize(
    ("line", "head", "label"),
    [
        ("", 0, -1),
        ("G1", "G", -1),
        ("  g1", "G", -1),
        ("N10", 0, 10),
        ("n 1 0 O5 sub", "O", 10),
        ("N10 G1", "G", 10),
        ("N0010X1", "X", 10),
        ("N10#1=5", 0, 10),
        ("/N10 M98 P1", "M", 10),
        ("o<name> call", "O", -1),
        ("  / O100 endsub", "O", -1),
        ("(note) o100 if [1]", "O", -1),
        ("IF [#1 EQ 1] GOTO 10", "I", -1),
        ("N20 WHILE [#1 LT 2] DO1", "W", 20),
        ("#1=2", 0, -1),
        ("%", 0, -1),
        ("N", "N", -1),
        ("N1 N2", "N", 1),
        ("N-5", 0, -1),
        ("N1.5 G1", "G", -1),
        ("(open", 0, -1),
        ("[G1", 0, -1),
        ("`", 0, -1),
    ],
)
def test_head_and_label(line: str, head: str | int, label: int) -> None:
    found = window_of(line.encode() + b"\n")
    assert (int(found.head[0]), int(found.label[0])) == (
        ord(head) if isinstance(head, str) else head,
        label,
    )


def test_the_label_of_random_lines_is_the_n_word() -> None:
    for seed in range(share(200, 6)):
        data = Adversary(seed).data(200)
        found = window_of(data)
        for index, line in enumerate(data.splitlines()):
            try:
                statement = parse_line(decoded(line), SYNTAXES[0])
            except GcodeError:
                continue
            words = statement.words
            if statement.assignments or statement.control:
                continue
            if not words or words[0].letter != "N":
                assert found.label[index] == -1, line
                # @ and ^ are words, but no letters.
                assert not words or found.head[index] == (
                    ord(words[0].letter) if words[0].letter.isalpha() else 0
                ), line
            elif words[0].written[1:].isdigit():
                assert found.label[index] == words[0].number, line


SIMPLE = [
    "",
    "N1",
    "X1",
    "G0",
    "G01 X1 Y2 Z3 A1 B1 C1 U1 V1 W1 F1",
    "N5 G1 F100 X1",
    "(a) X1",
    "F5",
    "G2 X1 I1",
    "G0 G1 M3 M3",
    "S1 T1 M6",
]

NOT_SIMPLE = [
    "N-0",
    "N1.5",
    "X1 X2",
    "F1 f2",
    "%",
    "X[1]",
    "X-[1]",
    "X[-1]",
    "G[1] X2",
    "N[5] X1",
    "#1=2",
    "O5",
]


def test_simple_lines_are_marked() -> None:
    found = window_of("\n".join(SIMPLE).encode() + b"\n")
    assert found.simple.tolist() == list(range(len(SIMPLE), 0, -1))
    for line in NOT_SIMPLE:
        assert window_of(line.encode() + b"\n").simple[0] == 0, line


def test_a_run_ends_at_a_line_that_is_not_plain() -> None:
    found = window_of(b"G0X1\nX2\nX3X3\nX3\nO1 sub\nX1\n")
    assert found.plain.tolist() == [4, 3, 2, 1, 0, 1]
    assert found.simple.tolist() == [2, 1, 0, 1, 0, 1]


@pytest.mark.parametrize(
    ("data", "whole", "lines", "size"),
    [
        (b"G0 X1\r\nG0 Y2\r", False, [b"G0 X1"], 7),
        (b"G0 X1\r\nG0 Y2\r", True, [b"G0 X1", b"G0 Y2"], 13),
        (b"G0 X1", False, [], 0),
        (b"", True, [], 0),
        (b"\r\r\n\n\rX", True, [b"", b"", b"", b"", b"X"], 6),
        (b"\n\rX", False, [b"", b""], 2),
    ],
)
def test_lines_end_in_three_ways(data: bytes, whole: bool, lines: list[bytes], size: int) -> None:
    found = split(data, whole=whole)
    places = zip(found.begin.tolist(), found.end.tolist(), strict=True)
    assert [data[begin:end] for begin, end in places] == lines
    assert found.size == size


def test_a_blank_inside_a_word_is_of_no_siemens_program() -> None:
    """There a blank ends a name, so the line is left to the parser of that language."""
    found = window_of(b"G1 X 5\nG1 X5\n")
    found.read_as(Syntax("siemens").language)
    assert found.plain.tolist() == [0, 1]


def test_a_line_with_one_name_too_many_is_left_to_the_interpreter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(lines, "_MOST_NAMES", 2)
    monkeypatch.setattr(lines, "_scratch", lines._Scratch())
    found = window_of(b"#<a>=1\n#<b>=2\n#<c>=3\n#<A>=4\n").code()
    left = [False, False, True, False]
    assert (found.kind == UNKNOWN).tolist() == left
    assert len(found.names.begin) == 2
