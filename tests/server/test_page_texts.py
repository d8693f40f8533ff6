"""The catalogues have each text of page and server once, with all values, and no others."""

import re
from typing import get_args, get_type_hints

import pytest

from cnc.boards.grbl.messages import INPUTS
from cnc.boards.grbl.settings import NAMES as SETTINGS
from cnc.boards.protocols import Condition
from cnc.checks.selection import findings
from cnc.checks.translations import LANGUAGES, findings_in
from cnc.gcode.reader import parser, syntax_errors
from cnc.machine.models import Axis, Machine, Program
from cnc.model.blocks import Spindle
from cnc.model.diagnostics import Severity
from cnc.operate.events import Activity, MachineState, Outcome
from cnc.operate.probing import Cycle, cycles, shipped_cycles
from cnc.server.measuring import SIMULATED
from cnc.simple_jobs.programs import described
from tests.support.paths import ROOT
from tests.support.server.page_texts import (
    catalogue,
    entries,
    said,
    sentences_of_server,
    templates,
    texts_of_files,
    titles_of_repairs,
)

NAMES = {"cncrun", "cncrun console"}
"""Names are the same in each language."""
SHOWN = {"hold request", "continuous", "top", "front", "side"}
SHOWN |= {"feed", "acceleration", "accel", "jerk", "normal accel", "velocity"}
"""Names that the page is given, and that no type lists."""


def cycles_of_shop() -> list[Cycle]:
    axes = {"x": Axis(steps_per_mm=100.0, max_velocity=100.0)}
    machine = Machine(axes=axes, program=Program(subroutines=(shipped_cycles(),)))
    return [each for each in cycles(machine) if each.name not in ("go_to", "trace_outline")]


def names_of_server() -> set[str]:
    states = {each for kind in (MachineState, Condition) for each in get_args(kind)}
    found = {each for each in states if isinstance(each, str)}
    found |= {each for kind in (Activity, Outcome, Severity) for each in get_args(kind)}
    for cycle in cycles_of_shop():
        found.add(cycle.title)
        for parameter in cycle.parameters:
            found |= {parameter.title, *(text for _, text in parameter.choices)}
    for job in described():
        found |= {job["title"], *(parameter["title"] for parameter in job["parameters"])}
    return found | SHOWN


@pytest.mark.parametrize("language", ["de"])
def test_the_catalogue_has_exactly_the_texts_of_the_page(language):
    entries, wanted = catalogue(language), (texts_of_files() | names_of_server()) - NAMES
    assert wanted - set(entries) == set()
    assert set(entries) - wanted == set()


@pytest.mark.parametrize("language", ["de"])
def test_each_text_has_the_values_of_the_english_one(language):
    for text, other in catalogue(language).items():
        assert other.strip(), text
        values = [sorted(re.findall(r"\{\d+\}", each)) for each in (text, other)]
        assert values[0] == values[1], text
        assert text.count("\n") == other.count("\n"), text


# Findings: their meanings and remedies.


def texts_of_findings() -> set[str]:
    return {text for each in findings().values() for text in (each.meaning, each.remedy)}


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_catalogue_has_exactly_the_texts_of_the_findings(language):
    translated = entries(ROOT / f"cnc/checks/{language}.po")
    assert texts_of_findings() - set(translated) == set()
    assert set(translated) - texts_of_findings() == set()
    assert [text for text, other in translated.items() if other in ("", text)] == []
    shown = findings_in(language)
    assert {code: (each.meaning, each.remedy) for code, each in shown.items()} == {
        code: (translated[each.meaning], translated[each.remedy])
        for code, each in findings().items()
    }


@pytest.mark.parametrize("language", LANGUAGES)
def test_each_text_of_a_finding_has_the_codes_and_numbers_of_the_english_one(language):
    for text, other in entries(ROOT / f"cnc/checks/{language}.po").items():
        for kept in (r"`[^`]*`", r"\d+", r"--[a-z-]+"):
            assert sorted(re.findall(kept, text)) == sorted(re.findall(kept, other)), text


# Sentences of the server: questions, results, names that it refuses, titles of repairs.

VARIABLES = {"title", "hint", "fix[0]"}
"""Variables in the place of titles: see ``said_by_server``."""


SAME = {"deg", "EQ", "Hz", "mm", "min", "ms", "us"}
"""Units and codes are the same in each language."""


def said_by_server() -> set[str]:
    titles = titles_of_repairs() - VARIABLES
    titles |= set(parser._TITLES.values()) | {"write a decimal point", "write {0}"}
    titles |= {f"write {syntax_errors._TYPOGRAPHIC[each]}" for each in syntax_errors._PLAIN}
    turns = set(get_args(get_type_hints(Spindle)["state"])) - {"off"}
    return (
        sentences_of_server() | titles | turns | {SIMULATED, *INPUTS.values(), *SETTINGS.values()}
    )


@pytest.mark.parametrize("language", LANGUAGES)
def test_each_sentence_of_the_server_is_translated_and_no_other(language):
    sentences, texts = catalogue(language, "server"), catalogue(language)
    lines = {line for text in said_by_server() for line in text.split("\n") if line}
    assert len(lines) > 70
    made = {line: said(re.sub(r"\{\d+\}", "7", line), sentences, texts) for line in lines}
    english = {line: set(re.findall("[A-Za-z]{2,}", " ".join(made[line].rest))) for line in lines}
    assert {line: words for line, words in english.items() if words - SAME} == {}
    assert set(sentences) - frozenset().union(*(each.used for each in made.values())) == set()


@pytest.mark.parametrize("language", LANGUAGES)
def test_each_sentence_has_the_values_of_the_english_one_in_their_order(language):
    for text, other in catalogue(language, "server").items():
        assert other.strip() and "\n" not in text + other, text
        values = re.findall(r"\{(\d+)\}", text)
        assert values == [str(k) for k in range(len(values))], text
        assert sorted(re.findall(r"\{(\d+)\}", other)) == values, text


@pytest.mark.parametrize(
    ("text", "german"),
    [
        ("put in tool 2: ball (tool table)", "Werkzeug 2 einsetzen: ball (Werkzeugtabelle)"),
        ("the program stops here: turn it, then go", "das Programm hält hier an: turn it, then go"),
        (
            "3 reversals at a slanted face, contacts within 0.0020 mm, 0.043 to 0.044 mm",
            "3 Umkehrungen an einer schrägen Fläche, Kontakte innerhalb von 0.0020 mm, "
            "0.043 bis 0.044 mm",
        ),
        (
            "steps lost at 250 mm/s; acceleration not reached",
            "Schritte verloren bei 250 mm/s; Beschleunigung nicht erreicht",
        ),
        ("limits of X: 100 mm/s, 500 mm/s²", "Grenzwerte von X: 100 mm/s, 500 mm/s²"),
        ("stay at X1.000: no line before gives a place there", None),
    ],
)
def test_a_sentence_is_translated_as_a_whole_or_in_its_parts(text, german):
    german = german or "auf X1.000 bleiben: keine Zeile davor gibt dort einen Ort an"
    assert said(text, catalogue("de", "server"), catalogue("de")).text == german


def test_templates_are_found_with_those_inside_their_values():
    module = "say(t`a ${f({b: t`c ${d}`})}\\n\\u201ce\\u201d ${g}`); const not = `t ${h}`; cut`i`;"
    assert templates(module) == ["a {0}\n\u201ce\u201d {1}", "c {0}"]
