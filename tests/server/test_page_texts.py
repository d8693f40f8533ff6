"""The catalogue of the page has each of its texts once, with all values, and no others."""

import re
from typing import get_args

import pytest

from cnc.boards.protocols import Condition
from cnc.machine.models import Axis, Machine, Program
from cnc.model.diagnostics import Severity
from cnc.operate.events import Activity, MachineState, Outcome
from cnc.operate.probing import Cycle, cycles, shipped_cycles
from cnc.simple_jobs.programs import described
from tests.support.server.page_texts import catalogue, templates, texts_of_files

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


def test_templates_are_found_with_those_inside_their_values():
    module = "say(t`a ${f({b: t`c ${d}`})}\\n\\u201ce\\u201d ${g}`); const not = `t ${h}`; cut`i`;"
    assert templates(module) == ["a {0}\n\u201ce\u201d {1}", "c {0}"]
