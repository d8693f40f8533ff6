"""Random series of holes against a second implementation of the canned cycles."""

from __future__ import annotations

from collections.abc import Iterator

from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.gcode.core.cycle_runner import Cut, Pause, Rapid, steps
from cnc.gcode.kernels.cycles import Hole, HoleSettings
from cnc.gcode.reader.words import G
from tests.support.gcode.gcode_cases import (
    assert_rows_equal,
    error_of,
    rows,
    run,
)
from tests.support.soak import share

NEEDED = {"G81": "ZR", "G82": "ZRP", "G83": "ZRQ", "G85": "ZR"}


@st.composite
def series(draw: st.DrawFn) -> list[tuple[str, str, str, dict[str, int]]]:
    """Lines of distance mode, retract mode, code and words; most of them have what their cycle
    needs.
    """
    program, current = [], ""
    for _ in range(draw(st.integers(1, 6))):
        code = draw(st.sampled_from(["", "", *NEEDED])) or ("" if current else "G81")
        begins = code not in ("", current)
        current = code or current
        words = {letter: draw(st.integers(-9, 9)) for letter in "XY" if draw(st.integers(0, 2))}
        for letter in NEEDED[current]:
            if draw(st.integers(0, 14)) if begins else not draw(st.integers(0, 4)):
                words[letter] = draw(
                    st.integers(-9, 2)
                    if letter == "Z"
                    else st.integers(-2, 9)
                    if letter == "R"
                    else st.integers(1, 4)
                )
        if not draw(st.integers(0, 3)):
            words["L"] = draw(st.integers(1, 3))
        program.append(
            (
                draw(st.sampled_from(["", "", "", "G90", "G91"])),
                draw(st.sampled_from(["", "", "G98", "G99"])),
                code,
                words,
            )
        )
    return program


def model(
    program: list[tuple[str, str, str, dict[str, int]]],
) -> Iterator[tuple[str, list[Hole], dict[str, int]]]:
    """Cycle, holes and words in effect of each line: the rules a second time, in the simplest way.
    ValueError at a wrong line.
    """
    x = y = 0.0
    level, absolute, initial, current = 5.0, True, True, ""
    known: dict[str, int] = {}
    for distance, retract, code, words in program:
        absolute = {"G90": True, "G91": False}.get(distance, absolute)
        initial = {"G98": True, "G99": False}.get(retract, initial)
        known = {} if code not in ("", current) else known
        current = code or current
        if not {"X", "Y", "Z"} & words.keys():
            if code or words:
                raise ValueError
            yield current, [], known
            continue
        known |= {letter: value for letter, value in words.items() if letter in NEEDED[current]}
        if known.keys() != set(NEEDED[current]):
            raise ValueError
        top = known["R"] + (0 if absolute else level)
        bottom = known["Z"] + (0 if absolute else top)
        if bottom > top:
            raise ValueError
        made = []
        for _ in range(words.get("L", 1)):
            x = words.get("X", x) if absolute else x + words.get("X", 0)
            y = words.get("Y", y) if absolute else y + words.get("Y", 0)
            made.append(Hole(x, y, bottom, top, max(level, top) if initial else top))
        yield current, made, known


@settings(max_examples=share(20000, 20), deadline=None)
@given(series())
def test_series_against_a_second_implementation(
    program: list[tuple[str, str, str, dict[str, int]]],
) -> None:
    text = "F600 G98\nG0 Z5\n"
    for *codes, words in program:
        text += " ".join([*codes, *(f"{letter}{value}" for letter, value in words.items())]) + "\n"
    expected: list[tuple[object, ...]] = [("rapid", 0.0, 0.0, 5.0)]
    place = (0.0, 0.0, 5.0)
    line = 2
    try:
        for cycle, holes, known in model(program):
            line += 1
            settings = HoleSettings(
                feed=10.0, dwell=known.get("P", 0), peck=known.get("Q", 0), clearance=0.254
            )
            for step in steps(G(int(cycle[1:]) * 10), place, holes, settings, "cw"):
                if isinstance(step, Pause):
                    expected.append(("dwell", step.seconds))
                elif isinstance(step, Rapid | Cut):
                    expected.append(
                        ("line", *step.to, 600.0) if isinstance(step, Cut) else ("rapid", *step.to)
                    )
                    place = step.to
    except ValueError:
        assert error_of(text, dialect="paper").line == line + 1
    else:
        assert_rows_equal(list(rows(run(text, dialect="paper"))), expected)
