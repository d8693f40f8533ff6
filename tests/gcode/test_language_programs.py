"""Every code of every dialect in a program with its expected blocks (language.txt)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.model import blocks as canon
from cnc.model.motion_commands import apart
from tests.support.gcode.gcode_cases import run
from tests.support.paths import GCODE

TOOLS = (
    ToolEntry(1, 1, {"X": 0.5, "Z": 40.0}, 6.0),
    ToolEntry(2, 2, {"Z": 100.0}),
    ToolEntry(3, 3, {}, 4.0),
)


@dataclass(frozen=True, slots=True)
class Case:
    """A program of the file.

    ``line`` is that of its heading. ``codes`` are the codes or words that it tests. It is run in
    ``dialects``, or in all that have its codes.
    """

    line: int
    codes: tuple[str, ...]
    dialects: tuple[str, ...]
    source: str
    blocks: tuple[str, ...]

    def in_dialects(self) -> list[str]:
        """The dialects that it is run in."""
        codes = {code for code in self.codes if re.match(r"[GM]\d", code)}
        return [name for name in self.dialects or dialects.with_codes() if codes <= _codes(name)]


@cache
def _codes(name: str) -> set[str]:
    """The codes of a dialect without leading zeros, with the meaning that others give them."""
    rules = dialects.load(name)
    other = rules.aliases.keys() | rules.spelled.keys()
    own = {code.written for code in rules.g if code / 10 not in other}
    if rules.cycles.plane_and_depth:
        own -= {"G81", "G82", "G83", "G85", "G89"}
    return own | {f"M{code}" for code in rules.m}


def _cases() -> Iterator[Case]:
    text = (GCODE / "language.txt").read_text(encoding="utf-8")
    for found in re.finditer(
        r"^== "
        r"(?P<codes>[^\[\n]+)(\[(?P<dialects>.*)\])?\n(?P<source>(?s:.*?))\n--\n(?P<blocks>(?s:.*?))\n(\n|\Z)",
        text,
        re.M,
    ):
        line = text.count("\n", 0, found.start()) + 1
        codes = tuple(re.sub(r"(?<=[GM])0(?=\d)", "", code) for code in found["codes"].split())
        yield Case(
            line,
            codes,
            tuple((found["dialects"] or "").split()),
            found["source"],
            tuple(found["blocks"].split("\n")),
        )


CASES = list(_cases())


def _number(value: float) -> str:
    return f"{round(value, 6) + 0.0:.10g}"


def _numbers(values: object, between: str = " ") -> str:
    return between.join(_number(value) for value in values)  # type: ignore[attr-defined]


def _switch(on: bool) -> str:
    return "on" if on else "off"


def written(block: canon.Block) -> list[str]:
    """A block in the form of the file, a Polyline as one line a move; feeds in mm/min."""
    match block:
        case canon.Polyline():
            ends = [
                (_numbers(end), feed * 60)
                for end, feed in zip(block.points.tolist(), block.feeds.tolist(), strict=True)
            ]
            return [
                f"rapid {end}" if math.isnan(feed) else f"line {end} F{_number(feed)}"
                for end, feed in ends
            ]
        case canon.ArcFeed():
            center, end = _numbers(block.center), _numbers(block.end.tolist())
            turns = f"r{_number(block.radius)} turns {_number(block.turns)}"
            return [
                f"arc {block.plane} about {center} {turns} to {end} F{_number(block.feed * 60)}"
            ]
        case canon.NurbsFeed():
            points = " ".join(_numbers(point, ",") for point in block.control_points.tolist())
            knots, weights = _numbers(block.knots.tolist()), _numbers(block.weights.tolist())
            return [
                f"nurbs degree {block.degree} knots {knots} points {points} weights {weights} "
                f"F{_number(block.feed * 60)}"
            ]
        case canon.PathMode():
            return [f"path {block.control} {_number(block.tolerance)}"]
        case canon.Dwell():
            return [f"dwell {_number(block.seconds)}"]
        case canon.Spindle(state="off"):
            return ["spindle off"]
        case canon.Spindle():
            surface = f" surface {_number(block.surface_speed)}" if block.surface_speed else ""
            return [f"spindle {block.state} {_number(block.rpm)}{surface}"]
        case canon.Orient():
            return [f"orient {_number(block.angle)} {block.direction} {_number(block.timeout)}"]
        case canon.SpindleSync():
            return [f"sync {_number(block.pitch)}"]
        case canon.Coolant():
            return [f"coolant {_switch(block.mist)} {_switch(block.flood)}"]
        case canon.Tool():
            return [f"tool {block.number}" + ("" if block.change else " loaded")]
        case canon.Stop():
            return ["stop" + " optional" * block.optional + " pallet" * block.pallet]
        case canon.End():
            return ["end"]
        case canon.Overrides():
            return [
                "overrides "
                + " ".join(
                    map(_switch, (block.feed, block.spindle, block.adaptive_feed, block.feed_stop))
                )
            ]
        case canon.DigitalOutput():
            return [
                f"output {block.number} {_switch(block.on)}" + " with-motion" * block.with_motion
            ]
        case canon.AnalogOutput():
            return [
                f"analog {block.number} {_number(block.value)}" + " with-motion" * block.with_motion
            ]
        case canon.WaitInput():
            return [
                f"wait {'analog' if block.analog else 'digital'} {block.number} {block.mode} "
                f"{_number(block.timeout)}"
            ]
        case canon.Message():
            return [f"message {block.text}"]
        case canon.BoardCommand():
            return [f"board {block.text}"]
        case canon.Probe():
            way, end = "towards" if block.towards else "away", _numbers(block.end.tolist())
            return [f"probe {way} {end} F{_number(block.feed * 60)}" + " must" * block.must]
        case _:
            raise AssertionError(block)


@pytest.mark.parametrize(
    "case", CASES, ids=[f"{case.line}-{'-'.join(case.codes)}" for case in CASES]
)
def test_the_program_has_the_expected_blocks(case: Case) -> None:
    source = case.source if re.search(r"^(M2|M30)$", case.source, re.M) else f"%\n{case.source}\n%"
    tools, folders = ToolTable(TOOLS), [GCODE / "subroutines"]
    for dialect in case.in_dialects():
        blocks = run(source, dialect=dialect, tools=tools, folders=folders)
        found = [line for block in apart(blocks) for line in written(block)]
        assert found == list(case.blocks), dialect


ROTARY = {"G7.1", "G43.4", "G43.5", "M428", "M429", "M430"}
"""Codes of machines with rotary axes, which have tests of their own."""
OF_LATHES = {"siemens": {"G33", "G34", "G35"}}
"""Codes that a mill refuses; the tests of the control's lathes have them."""


@pytest.mark.parametrize("dialect", dialects.with_codes())
def test_every_code_has_a_program(dialect: str) -> None:
    """Every legal code of a dialect is in a program that is run in that dialect."""
    shown = {code for case in CASES if dialect in case.in_dialects() for code in case.codes}
    assert _codes(dialect) - shown - ROTARY - OF_LATHES.get(dialect, set()) == set()


def test_programs_contain_the_codes_of_their_heading() -> None:
    for case in CASES:
        found = {
            re.sub(r"^([GM])0+(?=\d)", r"\1", code)
            for code in re.findall(r"[GM]\d+(?:\.\d)?", case.source)
        }
        codes = {code for code in case.codes if re.match(r"[GM]\d", code)}
        assert not codes or codes & found, case
        assert case.in_dialects(), case
