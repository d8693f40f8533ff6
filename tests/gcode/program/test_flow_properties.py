"""Random programs of loops, branches and calls make the moves of an independent evaluator.

Damaged programs are refused at one of their lines.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from cnc.gcode.core.call_stack import Limits
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.flow_author import Author, Evaluator, Program
from tests.support.gcode.flow_moves import xs
from tests.support.gcode.flow_writers import MacroB, OWords
from tests.support.gcode.gcode_cases import run
from tests.support.soak import share
from tests.support.work import at_most

AMOUNT = share(10_000, 20)
DAMAGED = share(10_000, 12)
LIMITS = Limits(repeated_lines=share(20_000, 4_000), depth=20)
WORK = 100 * LIMITS.repeated_lines
"""Calls of functions that a program may need: a hundred for each line that is executed."""


def programs(
    amount: int, *, most_loops: int = 9, repeats: bool = True
) -> Iterator[tuple[int, Program, list[float]]]:
    """Yield seed, program and its moves."""
    count = moves_in_all = 0
    for seed in range(amount):
        program = Author(seed, most_loops=most_loops, repeats=repeats).program()
        try:
            moves = Evaluator(program).run()
        except OverflowError:
            continue
        yield seed, program, moves
        count, moves_in_all = count + 1, moves_in_all + len(moves)
    assert count > amount * 0.8
    assert moves_in_all > amount * 3, "programs that make no moves test little"


@pytest.mark.timeout(3600)
def test_o_words() -> None:
    for seed, program, moves in programs(AMOUNT):
        lines = OWords(program, seed).text()
        assert xs("\n".join(lines), dialect="linuxcnc") == moves, lines


@pytest.mark.timeout(3600)
def test_macro_b() -> None:
    for seed, program, moves in programs(AMOUNT, most_loops=3, repeats=False):
        lines = MacroB(program, seed).text()
        assert xs("\n".join(lines), dialect="fanuc") == moves, lines


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("dialect", ["auto", "fanuc"])
def test_damaged_programs_are_refused_with_a_place(dialect: str) -> None:
    """Lines are lost, doubled or swapped: no traceback, no hang, an error with a place."""
    refused = 0
    for seed in range(DAMAGED):
        rng = random.Random(seed)
        if dialect == "auto":
            lines = OWords(Author(seed).program(), seed).text()
        else:
            lines = MacroB(Author(seed, most_loops=3, repeats=False).program(), seed).text()
        for _ in range(rng.randint(1, 3)):
            first, second = rng.randrange(len(lines)), rng.randrange(len(lines))
            match rng.randrange(4):
                case 0:
                    del lines[first]
                case 1:
                    lines.insert(second, lines[first])
                case 2:
                    lines[first], lines[second] = lines[second], lines[first]
                case _:
                    lines[first] = lines[first].replace("0", "1", 1)
            lines = lines or ["M2"]
        try:
            with at_most(WORK):
                run("\n".join(lines), dialect=dialect, limits=LIMITS)
        except GcodeError as error:
            refused += 1
            found = error.diagnostic
            assert 1 <= found.line <= len(lines), found
            assert found.text == lines[found.line - 1], found
            assert 1 <= found.column <= len(found.text), found
    assert DAMAGED * 0.1 < refused < DAMAGED


NGC_SOUP = [
    *(
        f"o{{}} {word}"
        for word in (
            "sub",
            "endsub",
            "call",
            "return",
            "else",
            "endif",
            "do",
            "endwhile",
            "endrepeat",
            "break",
            "continue",
        )
    ),
    *(
        f"o{{}} {word} [{value}]"
        for word in ("if", "elseif", "while", "repeat")
        for value in ("0", "1", "#1 LT 2", "3")
    ),
    *(
        "o{} call [#1 + 1]",
        "o{} return [#1]",
        "o[#1] call",
        "O{}",
        "M98 P{}",
        "M98 P{} L2",
        "M99",
        "M2",
        "%",
        "#1 = [#1 + 1]",
        "#1 = 0",
    ),
    *("G0 X#1", "G1 X1 F100", "/o{} if [1]", "(o{} endif)", "", "N{} G0 X2", "M73", "M70", "M72"),
]
MACRO_SOUP = [
    *(
        "DO{}",
        "END{}",
        "WHILE [#1 LT 2] DO{}",
        "WHILE [#1 EQ #0] DO{}",
        "GOTO {}",
        "N{}",
        "N{} G0 X#1",
        "IF [#1 LT 2] GOTO {}",
        "GOTO #1",
    ),
    *(
        "IF [#1 EQ #0] THEN #1 = 1",
        "#1 = #1 + 1",
        "#1 = #0",
        "O{}",
        "M98 P{}",
        "M98 P2000{}",
        "M99",
        "M99 P{}",
        "G65 P{} A2 B#1",
        "G65 P{} L2",
    ),
    *("M30", "%", "G0 X#1", "", "/GOTO {}", "G1 X1 F100"),
]


@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("dialect", "words"),
    [*share([("auto", NGC_SOUP)], []), ("linuxcnc", NGC_SOUP), ("fanuc", MACRO_SOUP)],
)
def test_random_sequences_of_control_lines(dialect: str, words: list[str]) -> None:
    """Lines in random order: each program ends or is refused at one of its lines."""
    ended = 0
    amount = share(30_000, 320)
    for seed in range(amount):
        rng = random.Random(seed)
        lines = [rng.choice(words).format(rng.randint(1, 3)) for _ in range(rng.randint(1, 12))]
        options = {"dialect": dialect, "limits": LIMITS, "block_delete": rng.random() < 0.5}
        try:
            with at_most(WORK):
                run("\n".join(lines), **options)
            ended += 1
        except GcodeError as error:
            found = error.diagnostic
            assert 1 <= found.line <= len(lines), (found, lines)
            assert found.text == lines[found.line - 1], found
            assert min(1, len(found.text)) <= found.column <= len(found.text), (found, lines)
    assert ended > amount * 0.01
