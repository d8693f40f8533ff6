"""Every line of a program is read by the grammar of its language."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cnc.gcode import dialects
from cnc.gcode.dialects.recognition import recognise
from cnc.gcode.reader.lines import read_line
from cnc.gcode.reader.parser import Syntax
from cnc.gcode.reader.source_text import Text
from tests.support.corpus import STYLES, programs
from tests.support.paths import ROOT

PROGRAMS = sorted(
    file for file in (ROOT / "programs").rglob("*") if file.suffix in {".nc", ".ngc", ".h"}
)


def unread(lines: list[str], dialect: str) -> list[str]:
    """Return the lines at which the grammar of a dialect stops."""
    rules = dialects.load(dialect)
    name = Syntax(rules.flavour, dialect=dialect).language.grammar
    return [line for line in lines if read_line(line, name).results.status[0]]


@pytest.mark.parametrize("file", PROGRAMS, ids=[file.name for file in PROGRAMS])
def test_the_grammar_reads_every_line_of_a_shipped_program(file: Path) -> None:
    lines = list(Text.of_file(file).all_lines())
    dialect = recognise(lines, file=file.name).dialect
    assert len(lines) > 5
    assert unread(lines, "linuxcnc" if dialect == "auto" else dialect) == []


REPAIRED = {
    "nested comment": re.compile(r"\([^()]*\("),
    "block delete between words": re.compile(r"[0-9.] /[A-Z]"),
    "simulation of a training mill": re.compile(r"\[?(BILLET|TOOLDEF|EDGEMOVE)"),
    "for the board, or the start of a tape": re.compile(r"[ \t]*[$%:]"),
}
"""Lines that are no G-code of their language, and are repaired or named before the grammar."""


@pytest.mark.parametrize("style", STYLES)
def test_the_grammar_reads_the_lines_of_a_cam_system(style: str) -> None:
    for _, _, text in programs(2, [style]):
        dialect = recognise(text.splitlines()).dialect
        for line in unread(text.splitlines(), "linuxcnc" if dialect == "auto" else dialect):
            assert any(pattern.search(line) for pattern in REPAIRED.values()), line
