"""The tables of a grammar: Lark itself is the oracle of what they read."""

from __future__ import annotations

import os
from pathlib import Path
from random import Random

import lark
import numpy as np
import pytest

from cnc.gcode.kernels import automaton
from cnc.gcode.reader.lines import Reading, classes, read_line
from cnc.gcode.reader.tables import GrammarError, grammar, make, write
from tests.support.corpus import shops
from tests.support.gcode.adversary import SYNTAXES, Adversary, decoded
from tests.support.gcode.expression_cases import grow, spell
from tests.support.soak import share

FOLDER = Path(__file__).parents[3] / "grammars"


def events_of(reading: Reading) -> list[tuple[str, int]]:
    """Names of the events of a line, each with its number of parts; -1 for a token."""
    found, events = reading.grammar, reading.events
    return [
        (found.terminals[kind - 1], -1) if kind > 0 else (found.rules[-kind - 1], int(value))
        for kind, value in zip(
            events.kind[: reading.results.first[1]].tolist(),
            events.value[: reading.results.first[1]].tolist(),
            strict=True,
        )
    ]


def events_of_tree(tree: lark.Tree[lark.Token] | lark.Token) -> list[tuple[str, int]]:
    """The same of a tree of Lark."""
    if isinstance(tree, lark.Token):
        return [(tree.type, -1)]
    inside = [event for child in tree.children for event in events_of_tree(child)]
    return [*inside, (str(tree.data), len(tree.children))]


@pytest.fixture(scope="module", params=["ngc", "macro"])
def oracle(request: pytest.FixtureRequest) -> tuple[str, lark.Lark]:
    name = str(request.param)
    return name, lark.Lark.open(
        str(FOLDER / f"{name}.lark"), parser="lalr", maybe_placeholders=False
    )


def squeezed(text: str) -> str:
    """Without blanks and in capitals outside of comments, as Lark's grammar wants it."""
    out: list[str] = []
    closing = ""
    for char in text:
        if closing or char not in " \t":
            out.append(char if closing or not char.isascii() else char.upper())
        if not closing:
            closing = {"(": ")", ";": "\n"}.get(char, "")
        elif char == closing:
            closing = ""
    return "".join(out)


def test_random_lines_are_read_as_by_lark(oracle: tuple[str, lark.Lark]) -> None:
    name, parser = oracle
    rng = Random(5)
    lines = [
        f"X{spell(grow(rng, rng.randint(1, 5), macro=name == 'macro'), macro=name == 'macro')}"
        for _ in range(share(20_000, 200))
    ]
    lines += [decoded(line) for line in Adversary(3).data(share(50_000, 800)).splitlines()]
    good = wrong = 0
    for line in lines:
        if "<" in line and ";" in line:  # its blanks have rules of their own
            continue
        reading = read_line(line, name)
        text = squeezed(line)
        try:
            wanted = events_of_tree(parser.parse(text))
        except lark.UnexpectedInput as error:
            assert reading.results.status[0], line
            token = getattr(error, "token", None)
            at = len(text) if token is not None and token.type == "$END" else error.pos_in_stream
            place = int(reading.results.place[0])
            assert len(squeezed(line[:place])) == at or "(" in line, line
            wrong += 1
        else:
            if any((ord(char) < 32 and char != "\t") or char == "\x7f" for char in line):
                assert reading.results.status[0], "a control character"
                continue
            assert not reading.results.status[0], line
            assert events_of(reading) == wanted, line
            good += 1
    assert min(good, wrong) > len(lines) / 20


SINUMERIK = """
%_N_PLATE_MPF
N10 G17 G54 G71 ; a comment "with" quotes
/3 N20 X-5. Y+3 Z .5 RND=2
:30 PART_1: A9: X = IC(5) Y=AC(R1) CR=-10
R1=2 R2=R1*(3-R[R1+1])**2 MOD 4/.5 S1=500
_DEPTH=SIN(90)+ATAN2(1,2)-POT(3) GRID[1,2]=SET(1,,2)
IF (R1<=2) AND (R2<>3) OR (R3==4) XOR (R4>5) GOTOF PART_1
GOTOB N 10
IF R1>=2
WHILE R1<3 ; end
UNTIL GRID[R1]==2
FOR R1=1 TO 3*R2
REPEAT PART_1 P5 P=3
REPEATB A9
DEF REAL A[3]=REP(5), _B, BB=3
DEF STRING[8] CC
PROC HOLE(REAL XP, VAR INT YP) DISPLOF SAVE
EXTERN HOLE(REAL,STRING[5])
MSG("X: ",1)
MSG()
MCALL CYCLE81(10,,-R1,"a;b",X,Y1)
T="DRILL;5" D1 M6
G1 X5 (note) Y3
X=
X=(5
X=5)
N10 X5 5
GOTOF
MSG("X
IF GOTOF A
DEF REAL
X=R1 * * 2
FOR R1=1
é
""".strip().splitlines()


def test_lines_of_sinumerik_are_read_as_by_lark() -> None:
    parser = lark.Lark.open(str(FOLDER / "sinumerik.lark"), parser="lalr", maybe_placeholders=False)
    wrong = 0
    for line in SINUMERIK:
        reading = read_line(line, "sinumerik")
        try:
            wanted = events_of_tree(parser.parse(line))
        except lark.UnexpectedInput:
            assert reading.results.status[0], line
            wrong += 1
        else:
            assert not reading.results.status[0], line
            assert events_of(reading) == wanted, line
    assert wrong == 11


def test_a_name_may_begin_like_a_word_of_the_grammar() -> None:
    lines = ["TOTAL=ORANGE+MODUS*IFFY", "DEFECT(ANDY)", "IF_1: FORK=SINE", "X=R1MOD 2"]
    for line in lines:
        assert not read_line(line, "sinumerik").results.status[0], line


@pytest.mark.parametrize("shop", ["fusion-siemens", "siemens-shop"])
def test_the_grammar_reads_every_line_of_programs_for_sinumerik(shop: str) -> None:
    for seed in range(20):
        for line in shops.STYLES[shop](Random(seed)).splitlines():
            assert not read_line(line, "sinumerik").results.status[0], line


def test_many_lines_are_read_alike_without_a_compiler() -> None:
    """Counts must not take the small types of the tables: there are more than 256 events."""
    line = b"#1=[2+3*[4-5]]\n"
    begins = np.arange(0, 40 * len(line), len(line), dtype=np.int32)
    data, ends = np.frombuffer(40 * line, np.uint8), begins + np.int32(len(line) - 1)
    found = []
    for function in (automaton.read, automaton.read.py_func):
        events = automaton.Events(
            np.zeros(1000, np.int16), np.zeros(1000, np.int32), np.zeros(1000, np.int32),
            np.zeros(1000),
        )  # fmt: skip
        results = automaton.Results(
            np.zeros(41, np.int32), np.zeros(40, np.uint8), np.zeros(40, np.int32),
            np.zeros(40, np.int16),
        )  # fmt: skip
        count = function(
            data, begins, ends, 100, grammar("ngc").tables, classes("ngc"),
            np.zeros((3, 108), np.int64), events, results,
        )  # fmt: skip
        found.append((int(count), *(row[:count].tolist() for row in events), results.first[40]))
    assert found[0] == found[1]
    # Of each line 1 = 2 + 3 * 4 - 5; the parameter, three operations, the assignment and the block.
    assert found[0][0] == 40 * (9 + 6)


def test_numbers_have_the_bits_of_float() -> None:
    rng = Random(8)
    for _ in range(share(20_000, 500)):
        digits = "".join(rng.choice("0123456789") for _ in range(rng.randint(1, 17)))
        at = rng.randint(0, len(digits))
        text = f"{digits[:at]}.{digits[at:]}"
        value = float(read_line(f"X{text}", "ngc").events.value[1])
        assert value == float(text) or (value != value and int(digits) > 1 << 53), text


def test_a_file_of_tables_is_read_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    wanted = grammar.__wrapped__("macro")
    (file,) = (tmp_path / "cnc").iterdir()
    whole = file.read_bytes()
    rng = Random(1)
    cut = [whole[: rng.randrange(len(whole))] for _ in range(share(5, 2))]
    flipped = []
    for _ in range(share(20, 4)):
        at = rng.randrange(len(whole))
        flipped.append(whole[:at] + bytes([whole[at] ^ 1 << rng.randrange(8)]) + whole[at + 1 :])
    for data in (b"", *cut, *flipped):
        file.write_bytes(data)
        found = grammar.__wrapped__("macro")
        assert found._replace(tables=()) == wanted._replace(tables=())  # type: ignore[arg-type]
        for own, other in zip(found.tables, wanted.tables, strict=True):
            assert np.array_equal(own, other)
        assert file.read_bytes() == whole, "it is written anew"


def test_tables_of_other_installations_stay_in_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two installations with other grammars would else make their tables at each start."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "cnc"
    folder.mkdir()
    others = [folder / f"macro-{number:016x}.tables" for number in range(9)]
    for age, file in enumerate(others):
        file.write_bytes(b"")
        os.utime(file, (1e9 - age, 1e9 - age))
    grammar.__wrapped__("macro")
    left = set(folder.iterdir())
    assert set(others) & left == set(others[:7])
    assert len(left) == 8


def test_an_unwritable_folder_leaves_no_file_behind(tmp_path: Path) -> None:
    place = tmp_path / "a.tables"
    place.mkdir()
    with pytest.raises(OSError):
        write(grammar("ngc"), place)
    assert list(tmp_path.iterdir()) == [place]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('start: (A | B) \nA: /[xy]/\nB: "x"\n', "A and B have a text in common"),
        ("start: a | b\na: N\nb: N\nN: /1+/\n", "Reduce/Reduce"),
        ('start: e\ne: e "+" e | N\nN: /1+/\n', "Shift/Reduce"),
    ],
)
def test_a_doubtful_grammar_is_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "some.lark"
    file.write_text(text)
    with pytest.raises(GrammarError, match=message):
        make(file, tmp_path)


def test_a_text_of_two_terminals_is_allowed_in_different_places(tmp_path: Path) -> None:
    file = tmp_path / "some.lark"
    file.write_text('start: A "-" B\nA: /[xy]/\nB: /x/\n')
    assert make(file, tmp_path).terminals


def test_the_grammars_have_no_conflict() -> None:
    assert {file.stem for file in FOLDER.glob("*.lark")} >= {"ngc", "macro", "line"}
    for syntax in SYNTAXES:
        assert grammar(syntax.language.grammar).tables.moves.shape[1] == 129
