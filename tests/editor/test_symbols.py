"""Symbols, outline, words and tokens of each language."""

from __future__ import annotations

import random

import pytest

from cnc.editor.document import Document
from cnc.editor.symbols import NotRenamed, definitions, outline, places, renamed, symbol_at
from cnc.editor.words import TOKEN_TYPES, codes, completions, meaning, meaning_at, tokens
from cnc.gcode import dialects
from cnc.gcode.reader.parser import Flavour
from tests.support.corpus import EXPECTED, STYLES

NGC = "o<deep> sub\n#<_z>=[#<_z>-1] (#<_z>)\no<deep> endsub\n#<a b>=1\no<deep> call [#<AB>]\nM2\n"
MACRO = (
    "O1\n#100=5\nN010 G0 X#100\nM98 P0200\nG65 P200 A1.\nIF [#100 GT 1] GOTO 10\nM30\nO200\nM99\n"
)
SIEMENS = 'DEF REAL TIEFE=5\nSTART: G0 X=TIEFE R1=2 ; TIEFE\nMSG("TIEFE")\nGOTOB START\nM30\n'
KLARTEXT = "1 LBL 1\n2 Q1 = Q2 + Q1\n3 LBL 0\n4 CALL LBL 1 REP 2\n"
PLACES: list[tuple[Flavour, str, tuple[int, int], list[tuple[int, int]], list[int]]] = [
    # text, place of the cursor, places of the symbol, lines of its definition
    ("ngc", NGC, (5, 3), [(1, 1), (3, 1), (5, 1)], [1]),
    ("ngc", NGC, (2, 3), [(2, 1), (2, 8)], [2]),
    ("ngc", NGC, (5, 17), [(4, 1), (5, 15)], [4]),
    ("macro-b", MACRO, (4, 6), [(4, 5), (5, 5), (8, 1)], [8]),
    ("macro-b", MACRO, (6, 21), [(3, 1), (6, 20)], [3]),
    ("macro-b", MACRO, (3, 11), [(2, 1), (3, 10), (6, 5)], [2]),
    ("siemens", SIEMENS, (4, 8), [(2, 0), (4, 6)], [2]),
    ("klartext", KLARTEXT, (4, 11), [(1, 6), (4, 11)], [1]),
    ("klartext", KLARTEXT, (2, 12), [(2, 2), (2, 12)], [2]),
]  # fmt: skip


@pytest.mark.parametrize(("flavour", "text", "at", "wanted", "defined"), PLACES)
def test_places_of_symbols(
    flavour: Flavour,
    text: str,
    at: tuple[int, int],
    wanted: list[tuple[int, int]],
    defined: list[int],
) -> None:
    document = Document.of("a", text)
    symbol = symbol_at(document, flavour, *at)
    assert symbol is not None
    listed = places(document, flavour, symbol)
    assert [(place.span.line, place.span.begin) for place in listed] == wanted
    assert [place.span.line for place in definitions(document, flavour, symbol)] == defined


def edited(flavour: Flavour, text: str, at: tuple[int, int], name: str) -> str:
    document = Document.of("a", text)
    symbol = symbol_at(document, flavour, *at)
    assert symbol is not None
    edits = renamed(document, flavour, symbol, name)
    for edit in reversed(edits):
        document = document.edited([edit], 2)
    return document.text


def test_variables_are_renamed_everywhere_but_in_comments() -> None:
    assert edited("ngc", NGC, (2, 3), "_depth") == NGC.replace(
        "#<_z>=[#<_z>-1]", "#<_depth>=[#<_depth>-1]"
    )
    assert edited("macro-b", MACRO, (2, 2), "101") == MACRO.replace("#100", "#101")
    new = edited("siemens", SIEMENS, (1, 10), "DEPTH")
    assert (
        new == 'DEF REAL DEPTH=5\nSTART: G0 X=DEPTH R1=2 ; TIEFE\nMSG("TIEFE")\nGOTOB START\nM30\n'
    )


@pytest.mark.parametrize(
    ("flavour", "text", "at", "name"),
    [
        ("ngc", NGC, (2, 3), "z"),  # global to local
        ("ngc", NGC, (5, 17), "_z"),
        ("ngc", NGC, (5, 17), "a#b"),
        ("ngc", NGC, (5, 3), "flat"),  # a subroutine
        ("macro-b", MACRO + "#101=2\n", (2, 2), "101"),  # in use
        ("macro-b", MACRO, (2, 2), "<a>"),
        ("siemens", SIEMENS, (1, 10), "R5"),
    ],
)
def test_a_wrong_name_is_refused(
    flavour: Flavour, text: str, at: tuple[int, int], name: str
) -> None:
    with pytest.raises(NotRenamed):
        edited(flavour, text, at, name)


def test_the_outline_has_programs_tools_and_operations() -> None:
    text = "O1\n(T5 D6. BALL)\nT5 M6\n(ROUGH)\nG0 X1\n(FINISH)\nT05\nT6 M6\nM30\nO200 (SUB)\nM99\n"
    entries = outline(Document.of("a", text))
    listed = [
        (entry.name, entry.line, entry.last, [
            (tool.name, [operation.name for operation in tool.children])
            for tool in entry.children
        ])
        for entry in entries
    ]  # fmt: skip
    assert listed == [
        ("O1", 1, 9, [("T5 D6. BALL", ["ROUGH", "FINISH"]), ("T6", [])]),
        ("O200", 10, 12, []),
    ]
    klartext = "0 BEGIN PGM A MM\n1 TOOL CALL 5 Z S2000\n2 LBL 1\n3 LBL 0\n"
    names = [entry.name for entry in outline(Document.of("a", klartext))]
    assert names == ["BEGIN PGM A", "LBL 1"]


MEANINGS = [
    ("haas", None, "G", 154.0, "further coordinate system, number P (as G54.1)"),
    ("haas", "A", "G", 90.0, "turning cycle along Z (as G77)"),
    ("haas", "A", "G", 71.0, "roughing along Z of the profile P to Q"),
    ("haas", None, "G", 71.0, "holes on an arc"),
    ("siemens", None, "G", 71.0, "millimetres (as G21)"),
    ("linuxcnc", None, "G", 76.0, "thread in several passes"),
    ("fanuc", None, "G", 76.0, "fine boring"),
    ("marlin", None, "G", 29.0, "levelling of the bed; no effect here"),
    ("grbl", None, "G", 81.0, ""),
    ("grbl", None, "M", 3.0, "spindle clockwise"),
]


@pytest.mark.parametrize(("dialect", "lathe", "letter", "number", "text"), MEANINGS)
def test_a_code_means_what_its_dialect_says(
    dialect: str, lathe: str | None, letter: str, number: float, text: str
) -> None:
    rules = dialects.load(dialect, lathe=lathe)  # type: ignore[arg-type]
    assert meaning(letter, number, rules) == text


def test_every_code_of_every_dialect_has_a_meaning() -> None:
    for name in dialects.with_codes():
        systems = ("A", "B") if dialects.has_lathe_language(name) else ()
        for lathe in (None, *systems):
            rules = dialects.load(name, lathe=lathe)
            for code in rules.g:
                written = code / 10
                reached = {alias.code for alias in rules.aliases.values()}
                if code >= 0 and written not in rules.aliases and written not in reached:
                    assert meaning("G", written, rules), (name, lathe, written)
            for number in rules.m:
                assert meaning("M", float(number), rules), (name, number)


def test_the_word_under_the_cursor() -> None:
    rules = dialects.load("linuxcnc")
    document = Document.of("a", "N10 g01 x 1.5 (G2) M999\n")
    assert meaning_at(document, 1, 5, rules)[:3] == (4, 7, "G01")  # type: ignore[index]
    assert meaning_at(document, 1, 9, rules)[2:] == ("X1.5", "axis X")  # type: ignore[index]
    assert meaning_at(document, 1, 15, rules) is None
    assert meaning_at(document, 1, 20, rules)[3] == "not in the dialect linuxcnc"  # type: ignore[index]
    klartext = dialects.load("heidenhain")
    found = meaning_at(Document.of("a", "10 CALL LBL 1"), 1, 5, klartext)
    assert found is not None
    assert found.word == "CALL LBL"


def test_completions() -> None:
    rules = dialects.load("grbl")
    listed = [item.text for item in completions(Document.of("a", "G1 X1 G38"), 1, 9, rules)]
    assert listed == ["G38.2", "G38.3", "G38.4", "G38.5"]
    assert completions(Document.of("a", "(G"), 1, 2, rules) == []
    ngc = dialects.load("linuxcnc")
    document = Document.of("a", "#<depth>=1\nX#<\n")
    assert [(item.text, item.begin) for item in completions(document, 2, 3, ngc)] == [
        ("<depth>", 2)
    ]
    macro = Document.of("a", "M98 P\nO200\n")
    assert [item.text for item in completions(macro, 1, 5, dialects.load("fanuc"))] == ["200"]
    assert not list(codes(dialects.load("heidenhain"), None))


@pytest.mark.parametrize("style", sorted(STYLES))
def test_tokens_cover_every_character_that_is_no_blank(style: str) -> None:
    """A comment is one token, no token overlaps another, and only brackets and # stand alone."""
    text = STYLES[style](random.Random(style))
    document = Document.of("a", text)
    rules = dialects.load(EXPECTED[style], lenient=True)
    rest = [list(document.line(number)) for number in range(1, document.count + 1)]
    before = (0, 0)
    for token in tokens(document, rules, 1, document.count):
        assert (token.line, token.begin) >= before
        assert 0 <= token.type < len(TOKEN_TYPES)
        before = token.line, token.end
        rest[token.line - 1][token.begin : token.end] = " " * (token.end - token.begin)
    left = {"".join(line).strip() for line in rest}
    whole = {line for line in left if len(line) > 12}
    assert len(whole) <= 0.2 * document.count, sorted(whole)[:3]


def test_tokens_count_characters() -> None:
    rules = dialects.load("linuxcnc")
    document = Document.of("a", "(\u00e9\U0001f600) G1 X#5\n")
    listed = [
        (document.line(1)[token.begin : token.end], TOKEN_TYPES[token.type])
        for token in tokens(document, rules, 1, 1)
    ]
    assert listed == [
        ("(\u00e9\U0001f600)", "comment"), ("G", "keyword"), ("1", "keyword"),
        ("X", "property"), ("#5", "variable"),
    ]  # fmt: skip
