"""Lines of Klartext: places of errors, whole programs, and random ones."""

from __future__ import annotations

from random import Random

import pytest

from cnc.gcode.core.call_stack import Limits
from cnc.gcode.core.program import interpret
from cnc.gcode.klartext.reader import parse
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import Coolant, End, NurbsFeed, Polyline, Spindle, Tool
from cnc.model.diagnostics import CncError, GcodeError
from tests.support.gcode.fuzz_runs import limited
from tests.support.gcode.gcode_cases import assert_error_at, run
from tests.support.paths import ROOT
from tests.support.soak import share

PROGRAM = ROOT / "programs" / "klartext.h"

MARKED = {
    # what the grammar does not have
    "L X+10 ¦G1": "klartext-word",
    "L X+10.5¦.2 F9": "klartext-word",
    "L ¦+10": "klartext-word",
    "L ¦X": "klartext-incomplete",
    "12 ¦FZ 0.1": "klartext-word",
    "CR X+10 Y+0 ¦DR+": "klartext-word",
    "BEGIN PGM ¦A": "klartext-incomplete",
    "L X+10 ¦é F9": "character-unknown",
    "L X+10 ¦(a) F9": "klartext-word",
    # functions that are not read
    "12 ¦APPR LT X+20 Y+20 LEN15 RR F100": "code-not-supported",
    "¦DEP LN LEN+20": "code-not-supported",
    "¦FPOL X+0 Y+0": "code-not-supported",
    "¦TCH  PROBE 0.0 REF. PLANE": "code-not-supported",
    "¦PLANE RESET STAY": "code-not-supported",
    "¦FUNCTION TCPM F TCP": "code-not-supported",
    "¦CALL PGM OTHER.H": "code-not-supported",
    "¦CTP PR+5 PA+9": "code-not-supported",
    # words that a block has, at a wrong place or with a wrong value
    "L X+1 ¦X+2 F9": "word-repeated",
    "L X+1 F9 ¦M140": "code-not-supported",
    "L X+1 F9 ¦B+3": "axis-missing",
    "CC X+1 Y+0\nCP ¦IPA-90 DR+ F9": "arc-angle",
    "CYCL DEF ¦208 BORE MILLING ~": "code-not-supported",
    "FN ¦2: Q1 = +1 + +1": "klartext-word",
    "¦Q150 = 3": "parameter-number",
    "Q1 = ¦Q2000": "parameter-number",
    "Q1 = 3 ¦/ 0": "division-by-zero",
    "Q1 = ¦-3^2": "expression-without-brackets",
    "Q1 = 2 * (3 + ¦4": "klartext-incomplete",
    "L X+¦12345678901": "number-too-large",
    "¦CC X+1": "code-not-supported",
    "¦CALL LBL 3": "label-missing",
    "TOOL CALL 1 ¦X S100": "code-not-supported",
}


@pytest.mark.parametrize("marked", MARKED)
def test_errors_name_their_place(marked: str) -> None:
    assert_error_at(MARKED[marked], marked, dialect="heidenhain")


def test_a_note_says_what_is_expected() -> None:
    with pytest.raises(GcodeError) as caught:
        parse("BEGIN PGM A CM")
    assert caught.value.diagnostic.hint == "expected here: MM or INCH"


def test_the_shipped_program() -> None:
    found = list(interpret(Text.of_file(PROGRAM), dialect="heidenhain"))
    assert isinstance(found[-1], End)
    assert [block.number for block in found if isinstance(block, Tool)] == [1, 2]
    assert [block for block in found if isinstance(block, Spindle)][-1].state == "off"
    assert not [block for block in found if isinstance(block, Coolant)][-1].flood
    assert len([block for block in found if isinstance(block, NurbsFeed)]) == 1
    depths = [
        point.tolist()
        for block in found
        if isinstance(block, Polyline)
        for point in block.points
        if point[2] == -12.0 + 5.0
    ]
    assert len(depths) == 6
    assert all(abs(complex(x - 35, y - 50)) == pytest.approx(15) for x, y, _ in depths)


WORDS = (
    "BEGIN PGM A MM", "END PGM A MM", "BLK FORM 0.1 Z X+0", "L", "C", "CR", "CT", "CC", "LP", "CP",
    "RND", "CHF", "SPL", "TOOL CALL", "TOOL DEF", "CYCL DEF", "CYCL CALL", "LBL", "CALL LBL", "REP",
    "FN", "IF", "GOTO", "EQU", "STOP", "X+1", "Y-2", "IZ+0.5", "IX-1", "A+3", "C+90", "PR+5",
    "PA+30", "IPA+450", "DR+", "DR-", "R+5", "R-3", "R0", "RL", "RR", "F100", "FMAX", "F AUTO",
    "M3", "M5", "M99", "M89", "M30", "M91", "K3X+1", "K1Y-2", "S100", "DL+0", "200", "207", "7.1",
    "8.1", "10.1", "ROT+30", "Q1", "Q200=2", "Q201=-5", "=", "+", "-", "*", "/", "^", "(", ")",
    "SIN", "INT", "ATAN", "5", "1.5", "~", ";", '"a"', ":", "DIV",
)  # fmt: skip

STARTS = (
    "L X+{} Y+{} F{}", "L IX+{} R0 FMAX M99", "CC X+{} Y+{}", "CC", "C X+{} Y+{} DR+ F{}",
    "CR X+{} Y+{} R+{} DR- F{}", "CT X+{} Y-{} F{}", "LP PR+{} PA+{} F{}", "CP IPA+{} DR+ F{}",
    "RND R{}", "CHF {}", "L X-{} RL F{}", "L Y-{} R0 F{}", "SPL X+{} K1X-{} F{}", "LBL 1", "LBL 0",
    "CALL LBL 1", "CALL LBL 1 REP {}", "Q1 = Q1 + {}", "FN 0: Q1 = +{}", "L X+Q1 FMAX",
    "CYCL DEF 7.1 X+{}", "CYCL DEF 8.1 X", "CYCL DEF 8.1", "CYCL DEF 10.1 ROT+{}", "CYCL CALL",
    "CYCL DEF 201 A ~", "Q200=1 Q201=-{} Q206=9 Q211=0 Q208=0 Q203=0 Q204=0", "STOP",
    "TOOL DEF 1 L+{} R+{}", "TOOL CALL 1 Z S{} F{}", "L M3", "L M89", "; text",
    "FN 12: IF +Q1 LT +{} GOTO LBL 1",
)  # fmt: skip


def test_random_programs_end_with_blocks_or_an_error() -> None:
    rng, good, wrong = Random(11), 0, 0
    for _ in range(share(6_000, 400)):
        lines = ["BEGIN PGM A MM", "TOOL DEF 1 R+0.5", "TOOL CALL 1 Z S100 F100"]
        for _ in range(rng.randint(1, 10)):
            if rng.random() < 0.03:
                line = " ".join(rng.choice(WORDS) for _ in range(rng.randint(1, 6)))
            else:
                line = rng.choice(STARTS)
                while "{}" in line:
                    line = line.replace("{}", str(rng.choice((0, 1, 2, 3.5, 10, 360))), 1)
            lines.append(line)
        source = "\n".join([*lines, "END PGM A MM"])
        try:
            with limited(5.0):
                run(source, dialect="heidenhain", limits=Limits(repeated_lines=300, depth=10))
            good += 1
        except CncError as error:
            found = error.diagnostic
            assert found.code != "internal-error"
            assert 1 <= found.line <= len(lines) + 1, (found.render(), source)
            assert 1 <= found.column <= len(found.text) + 1, (found.render(), source)
            wrong += 1
    assert min(good, wrong) > (good + wrong) / 20


def test_random_lines_never_give_a_traceback() -> None:
    rng = Random(12)
    characters = 'LCXYZIRFMQDEPABSNTK0123456789+-.=*/^()"~:;, \t#é\x01'
    for _ in range(share(100_000, 4_000)):
        if rng.random() < 0.5:
            line = "".join(rng.choice(characters) for _ in range(rng.randint(0, 25)))
        else:
            line = " ".join(rng.choice(WORDS) for _ in range(rng.randint(1, 8)))
        found = None
        try:
            parse(line)
        except GcodeError as error:
            found = error.diagnostic
        assert found is None or 1 <= found.column <= len(line) + 1, line
