"""Probing: blocks, parameters with and without a board, and errors."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from cnc.gcode.core.program import interpret
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import Block, Probe
from cnc.model.diagnostics import Diagnostic, GcodeError
from tests.support.gcode.gcode_cases import (
    assert_error_at,
    block_summaries,
    end_of,
    error_of,
    rows,
    run,
)

BEGIN = "G21 F600\nG0 X1 Y2 Z3\n"
STARTED = ["rapid 1 2 3"]

PROBES: dict[str, tuple[str, list[str]]] = {
    "G38.2": ("G38.2 Z-1", ["probe 1 2 -1 F600 true true"]),
    "G38.3": ("G38.3 Z-1", ["probe 1 2 -1 F600 true false"]),
    "G38.4": ("G38.4 Z-1", ["probe 1 2 -1 F600 false true"]),
    "G38.5": ("G38.5 X-1 F60", ["probe -1 2 3 F60 false false"]),
    "it goes on from the end": (
        "G38.2 Z-1\nG91\nG0 Z1",
        ["probe 1 2 -1 F600 true true", "rapid 1 2 0"],
    ),
    "it stays in effect": (
        "G38.3 Z-1\nX0",
        ["probe 1 2 -1 F600 true false", "probe 0 2 -1 F600 true false"],
    ),
    "under G91 and G20": ("G91 G20\nG38.2 Z-0.1", ["probe 1 2 0.46 F600 true true"]),
    "under G93": ("G93\nG38.2 Z-1 F30", ["probe 1 2 -1 F120 true true"]),
    "in a rotated system": ("G10 L2 P1 R90\nG38.2 X4", ["probe 1 4 3 F600 true true"]),
    "contact in program coordinates": (
        "G10 L2 P1 X10 R90\nG38.2 X4\n#1=#5061 #2=#5062 #3=#5063 #4=#5070\nG53 G0 X#1 Y#2 Z[#3+#4]",
        ["probe 1 4 3 F600 true true", "rapid 4 9 4"],
    ),
    "contact in the units of the program": (
        "G20\nG38.2 Z0\nG1 X#5063 Y#5061 F10",
        ["probe 1 2 0 F600 true true", "line 0 1 0 F254"],
    ),
}


@pytest.mark.parametrize("name", PROBES)
def test_probing_without_a_board(name: str) -> None:
    source, expected = PROBES[name]
    assert block_summaries(BEGIN + source) == STARTED + expected


def answered(source: str, *values: float) -> Iterator[Block]:
    """The blocks of a program, each probe answered as it comes by."""
    for block in interpret(Text.of_lines((BEGIN + source).split("\n"), "test.nc")):
        if isinstance(block, Probe):
            block.answer.values = values
        yield block


def test_the_program_continues_from_the_contact() -> None:
    found = list(
        rows(list(answered("G38.2 Z-1\nG91\nG0 Z1\nG90\nG0 X#5063 Y#5070", 1.0, 1.0, 2.0, 0.25)))
    )
    assert found[2:] == [("rapid", 1.0, 2.0, 1.25), ("rapid", 0.25, 1.0, 1.25)]


def test_a_failed_probe_sets_its_parameter() -> None:
    found = list(rows(list(answered("G38.3 Z-1\nG0 X[#5070+7] Y#5063", 0.0, 1.0, 2.0, -1.0))))
    assert found[2:] == [("rapid", 7.0, -1.0, -1.0)]


@pytest.mark.parametrize("code", ["G38.3", "G38.5"])
def test_a_probe_of_length_0_makes_no_contact(code: str) -> None:
    found = list(rows(run(f"{BEGIN}#5070=1\n{code} Z3\nG0 X[#5070+7] Y#5063")))
    assert found[1:] == [("rapid", 7.0, 3.0, 3.0)]


WRONG: dict[str, tuple[str, str]] = {
    "no axis": ("axis-words-missing", "¦G38.2"),
    "no way": ("probe-length", "¦G38.2 Z3"),
    "no way under G91": ("probe-length", "G91 ¦G38.4 Z0"),
    "a rotary axis": ("axis-not-allowed", "G38.2 ¦A3"),
    "a rotary axis beside": ("axis-not-allowed", "G38.2 Z-1 ¦A3"),
    "G95": ("probe-feed-mode", "S100 M3 G95 F1\n¦G38.2 Z-1"),
    "G93 without F": ("feed-missing", "G93\n¦G38.2 Z-1"),
    "cutter compensation": ("compensation-active", "G41.1 D1\nG1 X40\n¦G38.2 X50"),
    "machine coordinates": ("machine-coordinates-motion", "¦G53 G38.2 Z-1"),
    "no such probe": ("code-unknown", "¦G38.1 Z-1"),
    "no such probe either": ("code-unknown", "¦G38.6 Z-1"),
    "P": ("word-unused", "G38.2 Z-1 ¦P1"),
}


@pytest.mark.parametrize("name", WRONG)
def test_errors_are_reported_at_the_word(name: str) -> None:
    code, source = WRONG[name]
    assert_error_at(code, BEGIN + source, axes=("x", "y", "z", "a"))


def test_no_feed() -> None:
    assert error_of("G38.2 Z-1").code == "feed-missing"


HAAS = "G0 Z9.\nG31 Z-5. F60.{}\nG0 Z9.{}\nM30"


@pytest.mark.parametrize(
    ("lines", "answer", "place"),
    [
        ((" M79", ""), 1.0, None),
        ((" M79", ""), 0.0, (2, 15)),
        (("", " M79"), 1.0, None),
        (("", " M79"), 0.0, (3, 8)),
        (("", "\nM79"), 0.0, (4, 1)),
        ((" M78", ""), 1.0, (2, 15)),
        ((" M78", ""), 0.0, None),
        (("", "\nM78"), 1.0, (4, 1)),
        (("", "\nM78"), 0.0, None),
        ((" M78", "\nM79"), 0.0, (4, 1)),
    ],
)
def test_alarms_of_haas_at_a_skip(
    lines: tuple[str, str], answer: float, place: tuple[int, int] | None
) -> None:
    text = Text.of_lines(HAAS.format(*lines).split("\n"), "test.nc")
    found = None
    try:
        for block in interpret(text, dialect="haas"):
            if isinstance(block, Probe):
                block.answer.values = (answer, 0.0, 0.0, -1.0)
    except GcodeError as error:
        found = error.diagnostic
    assert place == (found and (found.line, found.column))
    assert found is None or (found.code, found.file) == ("probe-alarm", "test.nc")


@pytest.mark.parametrize("code", ["M78", "M79"])
def test_an_assumed_answer_raises_no_alarm_of_haas(code: str) -> None:
    found = rows(run(HAAS.format(f" {code}", f"\n{code}"), dialect="haas"))
    assert list(found)[-2] == ("rapid", 0.0, 0.0, 9.0)


def test_alarms_of_haas_without_a_board() -> None:
    found = error_of("G0 Z9.\nM79", dialect="haas")
    assert (found.code, found.line) == ("probe-alarm", 2)
    assert end_of("G0 Z9.\nM78", dialect="haas") == [0.0, 0.0, 9.0]
    assert error_of("G31 Z-5. F60. M78 M79", dialect="haas").code == "modal-conflict"


def test_an_alarm_that_a_guessed_contact_leads_to_is_a_warning() -> None:
    """A check assumes contact at the end of the move, so it may reach #3000 where no run does."""
    found: list[Diagnostic] = []
    program = "G0 Z9.\nG31 Z-5. F60.\nIF [#5063 LT -4.] THEN #3000=1\nG0 X1."
    assert end_of(program, dialect="fanuc", warn=found.append) == [1.0, 0.0, -5.0]
    assert [each.code for each in found] == ["abort-possible"]
    assert error_of("G0 Z9.\n#3000=1", dialect="fanuc").code == "macro-alarm"
