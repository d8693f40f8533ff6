"""Random programs: no traceback, no hang, no word that was not understood.

The last is checked from outside. In an accepted line, every number is changed in turn: what the line does, or the state that it leaves
behind, has to change with it (or the line is refused). A code is taken for another one of its modal group: the same. A word that the
interpreter ignored would change nothing.
"""

from __future__ import annotations

import random
import time
from typing import Any

import numpy as np
import pytest

from cnc.canon import ArcFeed, Block, NurbsFeed, Polyline
from cnc.errors import GcodeError
from cnc.gcode import dialects
from cnc.gcode.interpreter import Interpreter
from cnc.gcode.parameters import Parameters
from cnc.gcode.parser import Syntax, parse_line
from cnc.gcode.statement import Statement
from cnc.gcode.words import Word
from fuzzing import Author
from gcode_cases import run
from support import share

AXES = [("x", "y", "z"), ("x", "y", "z", "a"), ("x", "y", "z", "a", "b", "c", "u", "v", "w"), ("x", "z")]

OTHER = {
    "G0": "G1", "G1": "G0", "G2": "G3", "G3": "G2", "G80": "G0", "G17": "G18", "G18": "G19", "G19": "G17", "G20": "G21", "G21": "G20",
    "G54": "G55", "G55": "G54", "G59.3": "G54", "G61": "G61.1", "G61.1": "G61", "G64": "G61", "G90": "G91", "G91": "G90",
    "G90.1": "G91.1", "G91.1": "G90.1", "G93": "G94", "G94": "G93", "M0": "M1", "M1": "M0", "M2": "M0", "M30": "M0",
    "M3": "M4", "M4": "M5", "M5": "M3", "M7": "M9", "M8": "M9", "M9": "M8",
    "G4": "", "G10": "", "G53": "", "G92": "", "M6": "", "G06.2": "", "G5": "G1", "G5.1": "", "G5.2": "", "G5.3": "",
}  # fmt: skip
"""Another code of the same group, or nothing. Left out: G40, G49 (nothing to cancel yet), G92.1 to G92.3 (alike where no shift is set)."""

WITHOUT_EFFECT = {"N", "O", "Q"}
"""Line and program numbers mean nothing; Q of G64 gives leave that is not taken."""


def sound(blocks: list[Block], axes: int) -> None:
    """What every list of blocks keeps, whatever the program was."""
    position = np.zeros(axes)
    for block in blocks:
        match block:
            case Polyline():
                assert np.isfinite(block.points).all()
                assert (np.isnan(block.feeds) | (block.feeds > 0)).all()
                assert len(block.points) == len(block.feeds) == len(block.lines)
                position = block.points[-1]
            case ArcFeed():
                assert np.isfinite([*block.center, *block.end, block.radius, block.turns, block.feed]).all()
                assert block.radius > 0
                assert block.feed > 0
                assert block.turns != 0
                position = block.end
            case NurbsFeed():
                assert len(block.knots) == len(block.control_points) + block.degree + 1
                assert (np.diff(block.knots) >= 0).all()
                assert (block.weights > 0).all()
                assert block.control_points[0].tolist() == position.tolist()
                position = block.control_points[-1]
            case _:
                pass


GATHERED = ("_order", "_degree", "points", "weights", "_knots", "_knot_lines", "_feed", "_unit_feed")
"""What a curve that is being collected has so far."""


def parsed(text: str, dialect: str) -> Statement:
    spoken = dialects.load(dialect)
    return parse_line(text, Syntax(spoken.flavour, siemens=spoken.siemens, dollar=spoken.dollar, dialect=dialect))


def effect(lines: list[str], axes: tuple[str, ...], dialect: str) -> Any:
    """The blocks of a program and everything that it leaves behind; None where it is refused."""
    spoken = dialects.load(dialect)
    # Every system has an origin of its own, so that it matters which one is in use.
    origins = {5221 + 20 * system + axis: 0.5 + system for system in range(9) for axis in range(9)}
    known = Parameters(origins, macro=spoken.flavour == "macro-b")
    program = Interpreter("fuzz", axes, spoken, [0.123] * len(axes), known, None)
    try:
        for number, text in enumerate(lines, 1):
            program.execute(parsed(text, dialect), number)
    except GcodeError:
        return None
    curve = program.motion.collector
    if curve is None:
        program.end_of_file()
    inside = [getattr(curve, name, None) for name in GATHERED], [place and place.word.number for place in getattr(curve, "_intervals", ())]
    coordinates = program.coordinates
    offsets = known.values, known.locals, coordinates.zero, coordinates.rotation, coordinates.tool_offset
    return repr((program.out.ready, program.modal, program.motion.position, offsets, inside))


def changed(text: str, word: Word, new: str) -> str:
    return text[: word.column - 1] + new + text[word.column - 1 + word.length :]


def every_word_matters(lines: list[str], axes: tuple[str, ...], dialect: str) -> int:
    """Check the last of some accepted lines; the number of words that were changed."""
    before = effect(lines, axes, dialect)
    assert before is not None
    count = 0
    for word in parsed(lines[-1], dialect).words:
        if word.letter in WITHOUT_EFFECT:
            continue
        if word.letter in "GM":
            code = f"{word.letter}{word.number:g}" if word.number != 6.2 else "G06.2"
            if code not in OTHER:
                continue
            new = OTHER[code]
        else:
            new = f"{word.letter}{word.number + 4:.6f}"
        count += 1
        other = [*lines[:-1], changed(lines[-1], word, new)]
        assert effect(other, axes, dialect) != before, (lines, word)
    return count


def check(lines: list[str], rng: random.Random) -> tuple[bool, int]:
    """Run one program; whether it was accepted, and how many words were tried."""
    axes, dialect = rng.choice(AXES), rng.choice(dialects.NAMES)
    if dialects.load(dialect).program_end:
        lines = [*lines, "M2"]
    begin = time.process_time()
    error = None
    try:
        sound(run("\n".join(lines), axes=axes, dialect=dialect), len(axes))
    except GcodeError as refused:
        error = refused.diagnostic
        assert 1 <= error.line <= len(lines), error
        text = lines[error.line - 1]
        assert 1 <= error.column <= len(text), (error, lines)
        assert error.text == text.removesuffix("\r")
        assert error.message
    assert time.process_time() - begin < 2.0, lines
    if rng.random() < 0.8:
        return error is None, 0
    accepted = lines[: error.line - 1] if error else lines
    for number, text in enumerate(accepted, 1):
        statement = parsed(text, dialect)
        if statement.percent or any(word.letter == "M" and word.number in (2, 30) for word in statement.words):
            accepted = accepted[:number] if not statement.percent else accepted[: number - 1]
            break
    if not accepted or effect(accepted, axes, dialect) is None:
        return error is None, 0
    return error is None, every_word_matters(accepted, axes, dialect)


@pytest.mark.timeout(3600)
def test_random_programs() -> None:
    amount = share(100_000, 3_000)
    rng = random.Random(20_02)
    accepted = words = 0
    for seed in range(amount):
        good, tried = check(Author(seed).program(), rng)
        accepted += good
        words += tried
    assert accepted > amount * 0.1, "a fuzz that only meets errors tests little"
    assert words > amount * 0.2


def test_random_bytes() -> None:
    rng = random.Random(7)
    for _ in range(share(20_000, 500)):
        below = [rng.choice([127, 0x250, 0xD800]) for _ in range(rng.randint(1, 60))]
        text = "".join(chr(rng.randrange(32, limit)) for limit in below) + rng.choice(["", "\0", "\x1a", "\x7f"])
        check([text.replace("\n", " ")], rng)


def test_the_check_would_notice_an_ignored_word(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check of the checker: an interpreter that drops R words must be found out."""
    from cnc.gcode import interpreter

    whole = interpreter.Interpreter._in_order

    def careless(self: Any, words: Any, codes: Any) -> None:
        words.rest.pop("R", None)
        whole(self, words, codes)

    every_word_matters(["G0 X1"], AXES[0], "auto")
    monkeypatch.setattr(interpreter.Interpreter, "_in_order", careless)
    with pytest.raises(AssertionError):
        every_word_matters(["G0 X1 R5"], AXES[0], "auto")
