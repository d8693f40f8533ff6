"""Cycles of Klartext: the moves that Heidenhain's manual of cycles describes, by hand."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import block_summaries, error_of

HEAD = "BEGIN PGM A MM\nTOOL CALL S400 F300\nL Z+100 R0 FMAX M3"


def cycle(number: int, **values: float) -> str:
    """A CYCL DEF with a line for each parameter."""
    lines = [f"CYCL DEF {number} SOME NAME", *(f"{q}={v:+g} ;TEXT" for q, v in values.items())]
    return " ~\n".join(lines)


def summaries(source: str) -> list[str]:
    """The blocks behind the head, without those of the end."""
    found = block_summaries(f"{HEAD}\n{source}\nEND PGM A MM", dialect="heidenhain")
    assert found[:2] == ["spindle cw 400", "rapid 0 0 100"]
    last = found.index("end")
    return found[2 : last - (found[last - 1] == "spindle off 0")]


BORE = {"Q200": 2, "Q201": -15, "Q206": 250, "Q203": 10, "Q204": 20, "Q211": 0}
DRILL = BORE | {"Q202": 6, "Q210": 0}
UNIVERSAL = DRILL | {"Q212": 1, "Q213": 0, "Q205": 3, "Q208": 500}
PECK = BORE | {"Q202": 6, "Q212": 2, "Q205": 3, "Q258": 0.5, "Q259": 0.5, "Q257": 0, "Q208": 800}
TAP = {"Q200": 2, "Q201": -15, "Q203": 10, "Q204": 20}

CYCLES = {
    # strokes of 6: to 4, -2 and -5; out to 12 each time, then back to 2 above the depth reached
    (200, ()): [
        "rapid 0 0 12", "line 0 0 4 F250", "rapid 0 0 12", "rapid 0 0 6", "line 0 0 -2 F250",
        "rapid 0 0 12", "rapid 0 0 0", "line 0 0 -5 F250", "rapid 0 0 12", "rapid 0 0 30",
    ],
    (200, (("Q202", 20), ("Q211", 0.5), ("Q204", 0))): [
        "rapid 0 0 12", "line 0 0 -5 F250", "dwell 0.5", "rapid 0 0 12",
    ],
    (200, (("Q202", 8), ("Q210", 0.2))): [
        "rapid 0 0 12", "line 0 0 2 F250", "rapid 0 0 12", "dwell 0.2", "rapid 0 0 4",
        "line 0 0 -5 F250", "rapid 0 0 12", "rapid 0 0 30",
    ],
    # in at 250, out at Q208, or at Q206 if that is 0
    (201, (("Q208", 500), ("Q211", 1))): [
        "rapid 0 0 12", "line 0 0 -5 F250", "dwell 1", "line 0 0 12 F500", "rapid 0 0 30",
    ],
    (201, (("Q208", 0),)): [
        "rapid 0 0 12", "line 0 0 -5 F250", "line 0 0 12 F250", "rapid 0 0 30",
    ],
    # strokes of 6, 5 and 4; out at Q208
    (203, ()): [
        "rapid 0 0 12", "line 0 0 4 F250", "line 0 0 12 F500", "rapid 0 0 6", "line 0 0 -1 F250",
        "line 0 0 12 F500", "rapid 0 0 1", "line 0 0 -5 F250", "line 0 0 12 F500", "rapid 0 0 30",
    ],
    # strokes of 6, 4, 3 (not 2: at least Q205) and 2, from 0.5 above the depth reached
    (205, ()): [
        "rapid 0 0 12", "line 0 0 4 F250", "rapid 0 0 12", "rapid 0 0 4.5", "line 0 0 0 F250",
        "rapid 0 0 12", "rapid 0 0 0.5", "line 0 0 -3 F250", "rapid 0 0 12", "rapid 0 0 -2.5",
        "line 0 0 -5 F250", "line 0 0 12 F800", "rapid 0 0 30",
    ],
    # in, dwell, the spindle turns back, out, the spindle turns as before
    (206, ()): [
        "rapid 0 0 12", "line 0 0 -5 F250", "spindle ccw 400", "line 0 0 12 F250",
        "spindle cw 400", "rapid 0 0 30",
    ],
    # 400 turns of 1.25 mm: 500 mm/min; a left-hand thread turns the other way
    (207, (("Q239", 1.25),)): [
        "rapid 0 0 12", "line 0 0 -5 F500", "spindle ccw 400", "line 0 0 12 F500",
        "spindle off 0", "rapid 0 0 30",
    ],
    (207, (("Q239", -0.5),)): [
        "rapid 0 0 12", "spindle ccw 400", "line 0 0 -5 F200", "spindle cw 400",
        "line 0 0 12 F200", "spindle off 0", "rapid 0 0 30",
    ],
    # a depth of 0 makes no hole
    (200, (("Q201", 0),)): [],
}  # fmt: skip
OF = {200: DRILL, 201: BORE, 203: UNIVERSAL, 205: PECK, 206: BORE, 207: TAP}


@pytest.mark.parametrize("case", CYCLES)
def test_cycles(case: tuple[int, tuple[tuple[str, float], ...]]) -> None:
    number, changes = case
    source = f"{cycle(number, **OF[number] | dict(changes))}\nCYCL CALL"
    assert [row for row in summaries(source) if row != "spindle cw 400" or number == 206] == [
        row for row in CYCLES[case] if row != "spindle cw 400" or number == 206
    ]


def test_calls_by_m99_m89_and_cycl_call() -> None:
    flat = cycle(201, **BORE | {"Q208": 0, "Q204": 0})
    hole = ["rapid {} 0 12", "line {} 0 -5 F250", "line {} 0 12 F250"]
    once = [row.format(5) for row in hole]
    assert summaries(f"{flat}\nL X+5 FMAX M99\nL X+6 FMAX") == [
        "rapid 5 0 100", *once, "rapid 6 0 12",
    ]  # fmt: skip
    assert summaries(f"{flat}\nL X+5 FMAX\nCYCL CALL M8")[:2] == [
        "rapid 5 0 100",
        "coolant false true",
    ]
    modal = summaries(f"{flat}\nL X+5 FMAX M89\nL X+6 FMAX\nL X+7 FMAX M99\nL X+8 FMAX")
    assert [row for row in modal if "-5" in row or row.startswith("rapid 8")] == [
        "line 5 0 -5 F250", "line 6 0 -5 F250", "line 7 0 -5 F250", "rapid 8 0 12",
    ]  # fmt: skip


def test_a_cycle_on_one_line_and_the_feed_after_it() -> None:
    values = " ".join(f"{q}={v}" for q, v in (BORE | {"Q208": 0, "Q204": 0}).items())
    source = f"L X+1 F90\nCYCL DEF 201 REAMING {values}\nCYCL CALL\nL X+2"
    assert summaries(source)[-1] == "line 2 0 12 F90"


def test_parameters_are_read_when_the_cycle_is_called() -> None:
    source = f"{cycle(201, **BORE | {'Q208': 0, 'Q204': 0})}\nCYCL CALL\nQ201 = -16\nCYCL CALL"
    assert [row for row in summaries(source) if row.endswith("F250")] == [
        "line 0 0 -5 F250", "line 0 0 12 F250", "line 0 0 -6 F250", "line 0 0 12 F250",
    ]  # fmt: skip


FRAMES = {
    # TNC 640, cycle 7: absolute from the datum, incremental from the last shift
    "CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+60\nCYCL DEF 7.2 Y+40\nL X+1 Y+1 FMAX\n"
    "CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 IX-5\nL X+1 FMAX\nCYCL DEF 7.1 X+0 Y+0\nL X+1 Y+1 FMAX":
    ["rapid 61 41 100", "rapid 56 41 100", "rapid 1 1 100"],
    # cycle 8 mirrors about the datum, and reverses arcs
    "CYCL DEF 7.1 X+10\nCYCL DEF 8.0 MIRROR IMAGE\nCYCL DEF 8.1 X\nL X+2 Y+0 FMAX\nCC X+0 Y+0\n"
    "C X+0 Y+2 DR+ F9\nCYCL DEF 8.0 MIRROR IMAGE\nCYCL DEF 8.1\nL X+2 FMAX":
    ["rapid 8 0 100", "arc xy 10 0 10 2 100 2 -0.25 9", "rapid 12 2 100"],
    # cycle 10 turns about the datum
    "CYCL DEF 7.1 X+60 Y+40\nCYCL DEF 10.0 ROTATION\nCYCL DEF 10.1 ROT+35\n"
    "CYCL DEF 10.1 IROT+55\nL X+10 Y+0 FMAX\nL Y+5 FMAX\nCYCL DEF 10.1 ROT+0\nL X+1 Y+1 FMAX":
    ["rapid 60 50 100", "rapid 55 50 100", "rapid 61 41 100"],
}  # fmt: skip


@pytest.mark.parametrize("source", FRAMES)
def test_transformations(source: str) -> None:
    assert summaries(source) == FRAMES[source]


LESS = {key: value for key, value in DRILL.items() if key != "Q202"}
ERRORS = {
    "CYCL CALL": "cycle-not-active",
    "L X+1 FMAX M99": "cycle-not-active",
    "CYCL DEF 202 BORING": "code-not-supported",
    "CYCL DEF 208 BORE MILLING": "code-not-supported",
    "CYCL DEF 247 DATUM SETTING ~\nQ339=+1 ;DATUM NUMBER": "code-not-supported",
    "CYCL DEF 32.0 TOLERANCE": "code-not-supported",
    f"{cycle(200, **LESS)}\nCYCL CALL": "cycle-word-missing",
    # Q202 stays from the first cycle, but belongs to another definition
    f"{cycle(200, **DRILL)}\n{cycle(200, **LESS)}\nCYCL CALL": "cycle-word-missing",
    f"{cycle(200, **LESS)}\nL X+1 FMAX\nQ202 = 5\nCYCL CALL": "cycle-word-missing",
    f"{cycle(200, **DRILL | {'Q201': 5})}\nCYCL CALL": "cycle-retract-below-bottom",
    f"{cycle(200, **DRILL | {'Q202': 0})}\nCYCL CALL": "value-out-of-range",
    f"{cycle(200, **DRILL | {'Q202': 1e-4})}\nCYCL CALL": "cycle-too-long",
    f"{cycle(200, **DRILL | {'Q395': 1})}\nCYCL CALL": "code-not-supported",
    f"{cycle(203, **UNIVERSAL | {'Q213': 2})}\nCYCL CALL": "code-not-supported",
    f"{cycle(205, **PECK | {'Q259': 1})}\nCYCL CALL": "code-not-supported",
    f"{cycle(206, **BORE)}\nL M5\nCYCL CALL": "spindle-stopped",
    f"{cycle(207, **TAP, Q239=0)}\nCYCL CALL": "cycle-word-missing",
    f"TOOL DEF 1 R+2\nTOOL CALL 1 Z S9\n{cycle(200, **DRILL)}\nL X-9 F9 RL\nCYCL CALL":
    "compensation-active",
    "CYCL DEF 7.1 C+5": "code-not-supported",
    "CYCL DEF 10.1 ROT+5\nCYCL DEF 7.1 X+5": "code-not-supported",
    "CYCL DEF 10.1 ROT+5\nCYCL DEF 8.1 X": "code-not-supported",
    "CYCL DEF 8.1 X\nCYCL DEF 10.1 ROT+5": "code-not-supported",
    "CYCL DEF 8.1 ROT+5": "code-not-supported",
    "CYCL DEF 8.1 X+5": "code-not-supported",
    "CYCL DEF 7.1 X Y": "code-not-supported",
}  # fmt: skip


@pytest.mark.parametrize("source", ERRORS)
def test_what_cycles_refuse(source: str) -> None:
    found = error_of(f"{HEAD}\n{source}\nEND PGM A MM", dialect="heidenhain")
    assert found.code == ERRORS[source], found.render()


def test_cycles_in_inches_are_refused() -> None:
    source = f"BEGIN PGM A INCH\n{cycle(200, **DRILL)}\nEND PGM A INCH"
    assert error_of(source, dialect="heidenhain").code == "code-not-supported"
