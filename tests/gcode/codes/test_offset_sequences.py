"""Random programs of offset codes against a second model.

The model uses a complex number for X and Y, and a zero point for Z.
"""

from __future__ import annotations

import cmath
import math
import random
from dataclasses import dataclass, field

import pytest

from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from tests.support.gcode.gcode_cases import rows, run
from tests.support.soak import share

TOOLS = {1: (0.5, -1.25, 40.0), 2: (0.0, 0.0, 100.0), 3: (-3.0, 2.0, 7.5)}


@dataclass
class Place:
    """X + iY and Z."""

    xy: complex = 0j
    z: float = 0.0

    def __add__(self, other: Place) -> Place:
        return Place(self.xy + other.xy, self.z + other.z)

    def __sub__(self, other: Place) -> Place:
        return Place(self.xy - other.xy, self.z - other.z)

    def turned(self, degrees: float) -> Place:
        return Place(self.xy * cmath.exp(1j * math.radians(degrees)), self.z)

    def given(self, words: dict[str, float]) -> Place:
        xy = complex(words.get("X", self.xy.real), words.get("Y", self.xy.imag))
        return Place(xy, words.get("Z", self.z))


@dataclass
class Model:
    """machine = tool + origin + R (program + shift)."""

    systems: int
    here: Place = field(default_factory=Place)
    tool: Place = field(default_factory=Place)
    shift: Place = field(default_factory=Place)
    kept: Place = field(default_factory=Place)
    current: int = 0
    origins: list[Place] = field(default_factory=list)
    angles: list[float] = field(default_factory=list)
    homes: dict[int, Place] = field(default_factory=lambda: {28: Place(), 30: Place()})

    def __post_init__(self) -> None:
        self.origins = [Place() for _ in range(self.systems)]
        self.angles = [0.0] * self.systems

    def program(self, system: int | None = None) -> Place:
        n = self.current if system is None else system
        return (self.here - self.tool - self.origins[n]).turned(-self.angles[n]) - self.shift

    def machine(self, program: Place) -> Place:
        return (
            self.tool
            + self.origins[self.current]
            + (program + self.shift).turned(self.angles[self.current])
        )

    def move(self, words: dict[str, float], absolute: bool) -> None:
        if absolute:
            self.here = self.machine(self.program().given(words))
        else:
            self.here += Place().given(words).turned(self.angles[self.current])


def text(words: dict[str, float]) -> str:
    return " ".join(f"{letter}{value!r}" for letter, value in words.items())


def words_of(rng: random.Random) -> dict[str, float]:
    letters = rng.sample("XYZ", rng.randint(1, 3))
    return {letter: round(rng.uniform(-100, 100), rng.randint(0, 4)) for letter in letters}


Line = tuple[str, bool]
"""A line of a program, and whether it moves."""
MOVES, SYSTEMS = ("G0", "G91", "G53", "G28.1"), ("L2", "R", "L20", "G5x")
SHIFTS = ("G92", "G92.1", "G92.2", "G92.3", "G52")


def line(rng: random.Random, model: Model, dialect: str) -> Line:
    """A random line, executed on the model."""
    words, full = words_of(rng), dialect == "linuxcnc"
    kind = rng.choice(
        ["G0", "G91", "G53", "L2", "L20", "G92", "G92.1", "G5x", "G28.1"]
        + ["R", "G52", "G92.2", "G92.3", "G43", "G43.1", "G43.2", "L10"] * full
    )
    system = rng.randrange(model.systems)
    if kind in MOVES:
        return move_line(kind, words, model), True
    if kind in SYSTEMS:
        return system_line(rng, kind, words, model, system), False
    if kind in SHIFTS:
        return shift_line(kind, words, model), False
    return tool_line(rng, kind, words, model), False


def move_line(kind: str, words: dict[str, float], model: Model) -> str:
    if kind in ("G0", "G91"):
        model.move(words, kind == "G0")
        return f"{'G90' if kind == 'G0' else 'G91'} G0 {text(words)}"
    if kind == "G53":
        model.here = model.here.given(words)
        return f"G90 G53 G0 {text(words)}"
    # G28 moves through a point; the axes are those of the program.
    model.homes[28] = model.here
    model.move(words, absolute=True)
    angle = model.angles[model.current]
    rest = (model.homes[28] - model.here).turned(-angle)
    keep = {"X": rest.xy.real, "Y": rest.xy.imag, "Z": rest.z}
    model.here += Place().given({letter: keep[letter] for letter in words}).turned(angle)
    return f"G28.1\nG90 G28 {text(words)}"


def system_line(
    rng: random.Random, kind: str, words: dict[str, float], model: Model, system: int
) -> str:
    if kind == "L2":
        model.origins[system] = model.origins[system].given(words)
        return f"G10 L2 P{system + 1} {text(words)}"
    if kind == "R":
        model.angles[system] = rng.choice([0.0, 90.0, 30.0, -12.5])
        return f"G10 L2 P{system + 1} R{model.angles[system]}"
    if kind == "L20":
        wanted = model.program(system).given(words)
        model.origins[system] = (
            model.here - model.tool - (wanted + model.shift).turned(model.angles[system])
        )
        return f"G10 L20 P{system + 1} {text(words)}"
    model.current = system
    return ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")[system]


def shift_line(kind: str, words: dict[str, float], model: Model) -> str:
    if kind == "G92":
        model.shift = model.kept = model.shift + model.program() - model.program().given(words)
        return f"G92 {text(words)}"
    if kind == "G52":
        model.shift = model.kept = model.shift.given(words)
        return f"G52 {text(words)}"
    if kind == "G92.1":
        model.shift, model.kept = Place(), Place()
    elif kind == "G92.2":
        model.shift = Place()
    else:
        model.shift = model.kept
    return kind


def tool_line(rng: random.Random, kind: str, words: dict[str, float], model: Model) -> str:
    if kind == "G43.1":
        model.tool = model.tool.given(words)
        return f"G43.1 {text(words)}"
    tool = rng.choice(list(TOOLS))
    place = Place(complex(*TOOLS[tool][:2]), TOOLS[tool][2])
    if kind == "L10":
        # The offset that gives the position these coordinates, in effect; then the table is as it
        # was before.
        angle = model.angles[model.current]
        bare = model.here - model.origins[model.current]
        wanted = (bare.turned(-angle) - model.shift).given(words)
        before = place.turned(-angle)
        needed = bare.turned(-angle) - model.shift - wanted
        changed = {"X": needed.xy.real, "Y": needed.xy.imag, "Z": needed.z}
        model.tool = before.given({letter: changed[letter] for letter in words}).turned(angle)
        x, y, z = TOOLS[tool]
        return f"G10 L10 P{tool} {text(words)}\nG43 H{tool}\nG10 L1 P{tool} X{x} Y{y} Z{z}"
    model.tool = place if kind == "G43" else model.tool + place
    return f"{kind} H{tool}"


@pytest.mark.parametrize("dialect", ["linuxcnc", "grbl"])
@pytest.mark.parametrize("seed", range(share(2000, 10)))
def test_a_random_program_ends_where_the_model_does(seed: int, dialect: str) -> None:
    rng = random.Random(f"{dialect} {seed}")
    model = Model(9 if dialect == "linuxcnc" else 6)
    source, expected = ["G21 G90"], []
    for _ in range(40):
        written, moves = line(rng, model, dialect)
        source.append(written)
        if moves:
            expected.append(model.here)
    tools = ToolTable(
        ToolEntry(n, n, dict(zip("XYZ", offsets, strict=True))) for n, offsets in TOOLS.items()
    )
    found = [
        row[1:]
        for row in rows(run("\n".join([*source, "M2"]), dialect=dialect, tools=tools))
        if row[0] == "rapid"
    ]
    # Of a move by G28 only the end is compared.
    via = [n for n, written in enumerate(source[1:]) if written.startswith("G28.1")]
    moving = [n for n, written in enumerate(source[1:]) if "G0" in written or "G28" in written]
    ends, at = [], 0
    for n in moving:
        at += 2 if n in via else 1
        ends.append(found[at - 1])
    assert len(ends) == len(expected)
    for end, place in zip(ends, expected, strict=True):
        assert end == pytest.approx((place.xy.real, place.xy.imag, place.z), rel=1e-12, abs=1e-9), (
            "\n".join(source)
        )


@pytest.mark.parametrize("seed", range(share(500, 7)))
def test_offset_codes_never_move(seed: int) -> None:
    """Whatever they say: no block, and an empty increment ends where the machine stood, to the
    bit.
    """
    rng = random.Random(seed)
    model = Model(9)
    lines = [
        written for written, moves in (line(rng, model, "linuxcnc") for _ in range(40)) if not moves
    ]
    tools = ToolTable(
        ToolEntry(n, n, dict(zip("XYZ", offsets, strict=True))) for n, offsets in TOOLS.items()
    )
    source = "\n".join(["G53 G0 X1.1 Y2.2 Z3.3", *lines, "G91 X0 Y0 Z0", "M2"])
    found = list(rows(run(source, dialect="linuxcnc", tools=tools)))
    assert found == [*[("rapid", 1.1, 2.2, 3.3)] * 2, ("end",)]
