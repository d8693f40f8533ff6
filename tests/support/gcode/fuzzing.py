"""Random programs of the whole language; some make no sense, some are mutated."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from functools import lru_cache

from cnc.gcode import dialects
from tests.support.gcode.fuzz_grammar import DIALECTS, FLAVOURS, Parts
from tests.support.paths import ROOT

ALPHABET = "0123456789.+-GMXYZIJKRPFUWNSTLODE ()/;%#[]<>=\t*\0\u00e9@$"
LETTERS = "ABCDEFHIJKLPQRSTUVWXYZ"
ODD_NUMBERS = (
    "0",
    "1.",
    ".5",
    "-.25",
    "+3",
    "00012",
    "1 2 . 5",
    "-0",
    "999999999",
    "1e5",
    "",
    "-",
    "1.2.3",
    "0.0000001",
    "1000000001",
)
NAMES = (
    "foo",
    "_bar",
    "depth",
    "foo",
    "_bar",
    "depth",
    "_x",
    "_metric",
    "_feed",
    "f oo",
    "FOO",
    "_x",
)
NUMBERS = (
    1,
    2,
    1,
    2,
    1,
    2,
    3,
    5,
    30,
    31,
    33,
    100,
    500,
    600,
    5061,
    5161,
    5210,
    5220,
    5221,
    5230,
    5399,
    5400,
    5420,
    5421,
)
XYZ = ("x", "y", "z")
AXES = (*[XYZ] * 9, *[(*XYZ, "a")] * 3, *[(*XYZ, "a", "b", "c", "u", "v", "w")] * 3, ("x", "z"))
DEEPEST = 4
"""Blocks within each other."""
SHIPPED = sorted(ROOT.glob("programs/*.nc"))


@dataclass(frozen=True, slots=True)
class Program:
    """A program with the axes of its machine and its dialect."""

    lines: tuple[str, ...]
    axes: tuple[str, ...]
    dialect: str
    block_delete: bool = False

    def with_last(self, line: str) -> Program:
        """The same program with another last line."""
        return replace(self, lines=(*self.lines[:-1], line))


@lru_cache(maxsize=1)
def _shipped() -> list[str]:
    """Lines of the example programs."""
    return [
        line
        for file in SHIPPED
        for line in file.read_text(encoding="utf-8").split("\n")[:300]
        if line
    ]


@lru_cache(maxsize=len(dialects.with_codes()))
def _codes(dialect: str) -> list[str]:
    rules = dialects.load(dialect)
    return [code.written for code in sorted(rules.g)] + [f"M{code}" for code in sorted(rules.m)]


class Author:
    """Writes programs. Equal seeds give equal programs."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed).random
        self.labels = 0
        self.depth = 0
        self.dialect = "auto"
        self.axes: tuple[str, ...] = XYZ
        self.table = FLAVOURS["ngc"]

    def pick(self, among: tuple[str, ...] | list[str]) -> str:
        """A random element."""
        return among[int(self.random() * len(among))]

    def below(self, end: int) -> int:
        """A random whole number from 0 to below ``end``."""
        return int(self.random() * end)

    # Names without a rule in the grammar

    def _n(self) -> str:
        kind = self.random()
        if kind < 0.55:
            return str(self.below(19) - 9)
        if kind < 0.97:
            return f"{self.random() * 100 - 50:.{1 + self.below(4)}f}"
        return self.pick(ODD_NUMBERS)

    def _positive(self) -> str:
        return f"{self.random() * 99 + 0.1:.2f}" if self.random() < 0.98 else self._n()

    def _short(self) -> str:
        return f"{self.random() * 10 - 5:.3f}"

    def _big(self) -> str:
        return f"{self.random() * 50 + 20:.2f}"

    def _digit(self) -> str:
        return str(self.below(4)) if self.random() < 0.9 else str(self.below(12))

    def _par(self) -> str:
        return (
            str(NUMBERS[self.below(len(NUMBERS))])
            if self.random() < 0.97
            else str(self.below(9999))
        )

    def _name(self) -> str:
        return (
            self.pick(NAMES) if self.random() < 0.97 else self.pick(["none", "_value", "_tool", ""])
        )

    def _letter(self) -> str:
        return LETTERS[self.below(len(LETTERS))]

    def _anyaxis(self) -> str:
        return self.pick(self.axes).upper() if self.random() < 0.9 else "ABCUVWXYZ"[self.below(9)]

    def _code(self) -> str:
        if self.random() < 0.03:
            return f"{self.pick(['G', 'M'])}{self.below(130)}" + self.pick(["", "", ".1"])
        return self.pick(_codes(self.dialect))

    def _prog(self) -> str:
        return self.pick(["1001", "1002", "1003", "2001", "2002", "9"])

    def _file(self) -> str:
        return self.pick(["good", "broken", "deep", "again", "other", "no-such", "../good", "Good"])

    def _nurbs(self) -> str:
        """A G6.2 with knots that are mostly ascending."""
        order = 2 + self.below(4)
        count = order + self.below(4)
        knots = [0] * order + sorted(1 + self.below(8) for _ in range(count - order)) + [9] * order
        paper = self.random() < 0.5
        knot, weight, size = ("U", "W", f"K{order - 1}") if paper else ("K", "R", f"P{order}")
        points = ["X0 Y0", *(f"X{self._n()} Y{self._n()}" for _ in range(count - 1))]
        tails = ["", f" {weight}{self._positive()}"]
        lines = [
            f"{knot}{u} {point}{self.pick(tails)}" for u, point in zip(knots, points, strict=False)
        ]
        first = self.pick(["G0 X0 Y0\n", ""]) + f"G06.2 {size} {lines[0]} F{self._positive()}"
        return "\n".join([first, *lines[1:], *(f"{knot}{u}" for u in knots[count:])])

    def _curve(self) -> str:
        """G5, G5.1, G5.2 to G5.3 or BSPLINE, correct except for numbers."""
        plane, first, second, i, j = (
            ("G17", "X", "Y", "I", "J"),
            ("G18", "Z", "X", "K", "I"),
            ("G19", "Y", "Z", "J", "K"),
        )[self.below(3)]
        number, positive = self._n, self._positive
        kind, count = self.below(4), 2 + self.below(5)
        points = [f"{first}{number()} {second}{number()}" for _ in range(count)]
        feed = f" F{positive()}"
        if kind == 0:
            start = (
                f"{plane}\nG5 {points[0]} {i}{number()} {j}{number()} P{number()} Q{number()}{feed}"
            )
            return "\n".join(
                [
                    start,
                    *(f"G5 {point} P{number()} Q{number()}" for point in points[: self.below(3)]),
                ]
            )
        if kind == 1:
            return f"{plane} G5.1 {points[0]} {i}{number()} {j}{positive()}{feed}"
        if kind == 2:
            lines = [point + self.pick(["", f" P{positive()}"]) for point in points]
            return "\n".join(
                [plane, f"G5.2 P{positive()} L{2 + self.below(count)}{feed}", *lines, "G5.3"]
            )
        lines = [point + self.pick(["", f" PW={positive()}"]) for point in points]
        lines[2:] = [line + self.pick(["", f" PL={positive()}"]) for line in lines[2:]]
        return "\n".join([plane, f"BSPLINE SD={2 + self.below(2)}{feed}", *lines, "G0 X0"])

    def _new_label(self) -> str:
        self.labels += 1
        return str(100 + self.labels) if self.random() < 0.95 else str(self.labels)

    # Lines and programs

    def expand(self, name: str) -> str:
        """A random expansion of a name of the grammar."""
        rule = self.table.get(name)
        if rule is None:
            return str(getattr(self, f"_{name}")())
        self.depth += 1
        parts: Parts = rule[int(self.random() * len(rule))]
        if self.depth > DEEPEST * 3:
            parts = min(rule, key=len)
        written: list[str] = []
        labels: dict[str, str] = {}
        for part in parts:
            if isinstance(part, str):
                written.append(part)
            elif part[0] in "ABCD":
                if part[0] not in labels:
                    labels[part[0]] = self._new_label()
                written.append(labels[part[0]])
            elif not part[1] or self.random() < 0.5:
                written.append(self.expand(part[0]))
        self.depth -= 1
        return "".join(written)

    def mutate(self, line: str) -> str:
        """Make a few random typing errors."""
        for _ in range(1 + self.below(3)):
            at = self.below(len(line) + 1)
            match self.below(6):
                case 0:
                    line = line[:at] + self.pick(list(ALPHABET)) + line[at:]
                case 1:
                    line = line[:at] + line[at + 1 :]
                case 2:
                    line = line[:at] + self.pick(list(ALPHABET)) + line[at + 1 :]
                case 3:
                    line = line[at:] + line[:at]
                case 4:
                    line = line.swapcase()
                case _:
                    line = line[:at] + line[at : at + 2][::-1] + line[at + 2 :]
        return line

    def program(self) -> Program:
        """A random program; now and then it is written in another dialect than its own."""
        self.dialect, self.axes = self.pick(dialects.with_codes()), AXES[self.below(len(AXES))]
        written = self.pick(dialects.with_codes()) if self.random() < 0.05 else self.dialect
        flavour = dialects.load(written).flavour
        self.table, self.depth, self.labels = FLAVOURS[flavour] | DIALECTS[written], 0, 0
        texts = [self.expand("sub")] if self.random() < 0.05 else []
        if self.random() < 0.93:
            texts.append(self.expand("head"))
        texts += [self.expand("item") for _ in range(1 + self.below(5))]
        if self.random() < 0.05:
            shipped, first = _shipped(), self.below(1000)
            texts.insert(
                self.below(len(texts)), "\n".join(shipped[first : first + 1 + self.below(6)])
            )
        if self.random() < (0.8 if self.dialect == "linuxcnc" else 0.2):
            texts.append(self.expand("end"))
        if flavour == "macro-b" and self.random() < 0.5:
            texts += [f"O100{number}\n{self.expand('lines')}\nM99" for number in (1, 2)]
        lines = "\n".join(texts).split("\n")
        if self.random() < 0.25:
            at = self.below(len(lines))
            lines[at] = self.mutate(lines[at])
        if self.random() < 0.1:
            self.shuffle(lines)
        return Program(tuple(lines), self.axes, self.dialect, self.random() < 0.05)

    def shuffle(self, lines: list[str]) -> None:
        """Delete, swap or repeat a line."""
        one, other = self.below(len(lines)), self.below(len(lines))
        match self.below(3):
            case 0:
                if len(lines) > 1:
                    del lines[one]
            case 1:
                lines[one], lines[other] = lines[other], lines[one]
            case _:
                lines.insert(other, lines[one])
