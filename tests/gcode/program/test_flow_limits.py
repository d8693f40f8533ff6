"""Control flow of RS274/NGC: windows, limits, block delete, progress, calls."""

from __future__ import annotations

from typing import Any

import pytest

from cnc.gcode.core import program
from cnc.gcode.core.call_stack import Limits, Listing
from cnc.gcode.core.program import interpret
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import Polyline
from tests.support.gcode.flow_moves import xs
from tests.support.gcode.gcode_cases import error_of, rows, run


def test_blocks_of_repeated_lines_have_line_numbers() -> None:
    (block,) = run("o1 repeat [2]\nG0 X1\nG0 X2\no1 endrepeat\nG0 X3")
    assert isinstance(block, Polyline)
    assert block.lines.tolist() == [2, 3, 2, 3, 5]


def test_a_message_in_a_control_line_is_given_when_it_is_executed() -> None:
    found = rows(
        run(
            "o1 if [0] (msg, one)\n(msg, two)\no1 else\no1 endif\no2 repeat [2] (msg, three)\n"
            "o2 endrepeat"
        )
    )
    assert list(found) == [("message", "one"), ("message", "three")]


@pytest.mark.parametrize(("on", "moves"), [(False, [1, 1, 2]), (True, [2])])
def test_block_delete_applies_to_control_lines(on: bool, moves: list[float]) -> None:
    assert xs("/ o1 repeat [2]\n/G0 X1\n / o1 endrepeat\nG0 X2", block_delete=on) == moves


def test_block_delete_hides_subroutines_and_faulty_lines() -> None:
    assert xs(
        "/o1 sub\n/G0 X1\n/o1 endsub\n/ ???\no1 call\nM2\no1 sub\nG0 X2\no1 endsub",
        block_delete=True,
    ) == [2]


def test_linuxcnc_accepts_both_forms_of_end() -> None:
    assert xs("G0 X1\nM2", dialect="linuxcnc") == [1]
    assert xs("%\nG0 X1\n%", dialect="linuxcnc") == [1]
    assert xs("G0 X1\nM30\n", dialect="linuxcnc") == [1]


def test_progress_is_reported_in_executed_lines() -> None:
    reported: list[int] = []
    xs("o1 repeat [5000]\nG0 X1\no1 endrepeat", on_line=reported.append)
    assert reported[-1] == 10_001
    assert len(reported) > 8
    assert reported == sorted(reported)


def test_blocks_of_an_endless_program_are_yielded() -> None:
    blocks = interpret(
        Text.of_lines(["o1 while [1]", "G0 X1", "M0", "o1 endwhile"], "endless.nc"), axes=("x",)
    )
    first = [next(blocks) for _ in range(100)]
    assert [type(block).__name__ for block in first] == ["Polyline", "Stop"] * 50


def test_the_body_of_a_loop_is_parsed_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    whole = Listing.statement

    def counting(self: Listing, window: object, index: int) -> object:
        read.append(index)
        return whole(self, window, index)  # type: ignore[arg-type]

    monkeypatch.setattr(Listing, "statement", counting)
    xs("o1 repeat [100]\n#1=[#1+1]\nG0 X#1\no1 endrepeat")
    assert sorted(set(read)) == [0, 1, 2, 3]
    assert len(read) <= 8


def test_a_loop_longer_than_a_window() -> None:
    lines = 40_000
    source = "\n".join(
        [
            "o1 repeat [2]",
            *(f"G0 X{n % 1000}" for n in range(lines)),
            "o1 endrepeat",
            "o2 call",
            "M2",
            "o2 sub",
            "G0 X1",
            "o2 endsub",
        ]
    )
    assert xs(source) == [n % 1000 for n in range(lines)] * 2 + [1]


@pytest.mark.parametrize("moves", [2, 3, 10, 500])
def test_lines_within_the_limit_are_accepted(moves: int) -> None:
    """In the second round the moves and the end of the loop are executed again."""
    source = "\n".join(
        [
            "o1 repeat [2]",
            *(f"G0 X{n}" for n in range(moves)),
            "o1 endrepeat",
            "G0 X1\nG0 X2\nG0 X3\nG0 X4\nG0 X5",
        ]
    )
    assert len(xs(source, limits=Limits(repeated_lines=moves + 1))) == 2 * moves + 5
    assert error_of(source, limits=Limits(repeated_lines=moves)).code == "loop-endless"


def test_a_jump_into_a_run_of_moves() -> None:
    source = (
        "GOTO 3\n"
        + "\n".join(f"N{n} G1 X{n} F100" for n in range(10))
        + "\n#1 = #1 + 1\nIF [#1 LT 2] GOTO 8\nM30"
    )
    assert xs(source, dialect="fanuc") == [3, 4, 5, 6, 7, 8, 9, 8, 9]


def test_calls_up_to_the_depth_limit() -> None:
    source = (
        "o1 sub\no2 if [#1 GT 1]\no1 call [#1 - 1]\no2 endif\nG0 X#1\no1 endsub\no1 call [{}]\nM2"
    )
    assert xs(source.format(100)) == list(range(1, 101))
    assert xs(source.format(500), limits=Limits(depth=500))[-1] == 500


@pytest.mark.parametrize(
    ("dialect", "source"),
    [
        ("auto", "#1=5\no1 sub\nM2\no1 endsub\no1 call [7]"),
        ("auto", "#1=5\nM98 P1\nM2\nO1\no2 call [7]\nM99\no2 sub\nM2\no2 endsub"),
        ("fanuc", "#1=5\nM98 P1\nM2\nO1\nG65 P2 A7\nM99\nO2\nM30"),
    ],
)
def test_an_end_in_a_call_restores_the_main_programs_parameters(dialect: str, source: str) -> None:
    parameters = Parameters(macro=dialect == "fanuc")
    xs(source, dialect=dialect, parameters=parameters)
    assert parameters.locals == {1: 5}
    with pytest.raises(IndexError):
        parameters.pop()


def test_calls_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """A program may have a million calls. Only the line of the definition has a kept step."""
    made: list[Listing] = []

    class Watched(Listing):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            made.append(self)

    monkeypatch.setattr(program, "Listing", Watched)
    run("o1 sub\nG0 X[#1]\no1 endsub\n" + "".join(f"o1 call [{number}]\n" for number in range(50)))
    assert made[0].steps.keys() == {1}
