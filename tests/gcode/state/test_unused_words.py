"""Notes on unused F, S and T words, on every path that reads lines."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.gcode.core.program import interpret
from cnc.gcode.reader.source_text import Text

SHADOWED, NOTHING = "word-shadowed", "word-without-effect"
PADDING = "\n".join(["G0 X1", "G0 X2"] * 4)
"""A run of straight moves that is long enough for the lane of arrays."""


def found(text: str, dialect: str = "linuxcnc") -> list[tuple[str, int, int, str]]:
    reported = []
    for _ in interpret(Text.of_lines(text.split("\n"), "p"), dialect=dialect, warn=reported.append):
        pass
    return [
        (each.code, each.line, each.column, each.message.split()[0])
        for each in reported
        if each.severity == "note"
    ]


@pytest.mark.parametrize("padding", ["", PADDING])
@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("F500\nG1 X5\nF600\nG1 X6\nM2", []),
        ("F500\nF600\nG1 X6\nM2", [(SHADOWED, 1, 1, "F500")]),
        ("F500\nF500\nG1 X6\nM2", []),
        ("G0 X5 F500\nG1 X6 F600\nM2", [(SHADOWED, 1, 7, "F500")]),
        ("G0 X5 F500\nG1 X6\nG0 X7 F600\nM2", [(NOTHING, 3, 7, "F600")]),
        ("F500\nG0 X5\nG0 X6\nM2", [(NOTHING, 1, 1, "F500")]),
        ("F500\nG2 I3\nM2", []),
        ("F500\nG81 Z-1 R1\nM2", []),
        ("F500\nG93\nG1 X5 F2\nM2", []),
        ("F500\nG38.3 X9\nM2", []),
        ("F500\nG5.2 X1 Y1 L3\nX2 Y2\nX3 Y0\nG5.3\nM2", []),
        ("o1 sub\nF500\nG1 X5\nG1 X0\no1 endsub\no1 call\no1 call\nM2", []),
        ("#1=3\no1 while [#1]\nG1 X#1 F[#1*100]\n#1=[#1-1]\no1 endwhile\nM2", []),
        (
            "#1=3\no1 while [#1]\nG0 X#1 F[#1*100]\n#1=[#1-1]\no1 endwhile\nM2",
            [(NOTHING, 3, 8, "F[#1*100]")],
        ),
        ("S100\nS200\nM3\nM2", [(SHADOWED, 1, 1, "S100")]),
        ("S100\nM3\nS200\nS300\nM2", []),
        ("S100 M3\nM5\nS200\nM2", [(NOTHING, 3, 1, "S200")]),
        ("S0 M5\nM2", []),
        ("S100 G97\nM3\nM2", []),
        ("T1 M6\nT2\nM6\nM2", []),
        ("T1\nT2 M6\nM2", [(SHADOWED, 1, 1, "T1")]),
        ("T1\nT1 M6\nT3\nM2", []),
        ("M70\nF500\nM72\nF600\nG1 X5\nM2", []),
    ],
)
def test_unused_words_are_reported(text, wanted, padding):
    lines = padding.count("\n") + 1 if padding else 0
    before = f"{padding}\n{text}" if padding else text
    assert found(before) == [
        (code, line + lines, column, word) for code, line, column, word in wanted
    ]


def test_the_end_of_the_file_ends_the_program():
    assert found("%\nF500\nG0 X5\n%") == [(NOTHING, 2, 1, "F500")]
    assert found("F500\nG0 X5", "grbl") == [(NOTHING, 1, 1, "F500")]


def test_a_dialect_without_tool_changes_has_no_use_for_t():
    assert found("T1\nT2\nM2", "grbl") == []


def test_a_note_names_the_replacement():
    reported = []
    for _ in interpret(
        Text.of_lines(["(F7) F500 (F8)", "G0 X1 F 6 0", "G1 X2", "M2"], "p"), warn=reported.append
    ):
        pass
    (note,) = reported
    assert note.message == "F500 has no effect: F60 in line 2 replaces it before a feed move"
    assert (note.file, note.line, note.column, note.length, note.text) == (
        "p",
        1,
        6,
        4,
        "(F7) F500 (F8)",
    )


WORDS = st.lists(
    st.sampled_from(
        ["F100", "F200", "G0 X{0} F100", "G0 X{0} F300", "G1 X{0}", "G1 X{0} F200", "G0 X{0}", ""]
    ),
    max_size=30,
)


@given(WORDS)
def test_the_array_path_reports_the_same_as_line_by_line(words):
    """A comment that is a message makes every line the grammar's."""
    lines = ["F1 G1 X100", *(word.format(index) for index, word in enumerate(words)), "M2"]
    slowly = [f"{line} (msg, x)" for line in lines]
    assert found("\n".join(lines)) == found("\n".join(slowly))


@given(WORDS)
def test_against_a_model(words):
    """What is reported, by going through the lines with a pencil."""
    lines = ["G1 X100 F1", *(word.format(index) for index, word in enumerate(words))]
    waiting, wanted = None, []
    for number, line in enumerate(lines, 1):
        value = line.partition("F")[2]
        if value:
            if waiting is None:
                waiting = number, value
            elif waiting[1] != value:
                wanted.append((SHADOWED, waiting[0], f"F{waiting[1]}"))
                waiting = number, value
        if line.startswith("G1"):
            waiting = None
    if waiting:
        wanted.append((NOTHING, waiting[0], f"F{waiting[1]}"))
    assert [
        (code, line, word) for code, line, _, word in found("\n".join([*lines, "M2"]))
    ] == wanted
