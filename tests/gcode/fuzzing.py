"""Random programs: lines from a loose grammar of words, some whole and sensible, some mutated."""

from __future__ import annotations

import random

CODES = [
    "G0", "G1", "G2", "G3", "G4", "G10", "G17", "G18", "G19", "G20", "G21", "G40", "G49", "G53", "G54", "G55",
    "G59.3", "G61", "G61.1", "G64", "G80", "G90", "G91", "G90.1", "G91.1", "G92", "G92.1", "G92.2", "G92.3", "G93", "G94", "G06.2",
    "G5", "G5.1", "G5.2", "G5.3", "G43", "G81", "G123", "M0", "M1", "M2", "M30", "M3", "M4", "M5", "M6", "M7", "M8", "M9", "M98",
]  # fmt: skip
LETTERS = "ABCDEFHIJKLNOPQRSTUVWXYZ"
ALPHABET = "0123456789.+-GMXYZIJKRPFUWNSTL ()/;%#[]\t*E\0\u00e9@$"


class Author:
    """Writes programs; equal seeds, equal programs."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)

    def number(self) -> str:
        rng = self.rng
        kind = rng.random()
        if kind < 0.5:
            return str(rng.randint(-9, 9))
        if kind < 0.9:
            return f"{rng.uniform(-50, 50):.{rng.randint(1, 4)}f}"
        return rng.choice(["0", "1.", ".5", "-.25", "+3", "00012", "1 2 . 5", "-0", "999999999", "1e5", "", "-", "1.2.3"])

    def positive(self) -> str:
        return f"{self.rng.uniform(0.1, 99):.2f}"

    def axes(self, letters: str = "XYZ") -> str:
        chosen = [letter for letter in letters if self.rng.random() < 0.6] or ["X"]
        return " ".join(letter + self.number() for letter in chosen)

    def move(self) -> str:
        rng = self.rng
        return rng.choice(["", "G0 ", "G1 ", "G53 G0 ", "G91 ", "G90 "]) + self.axes() + rng.choice(["", "", f" F{self.positive()}"])

    def arc(self) -> str:
        rng = self.rng
        code, plane = rng.choice(["G2", "G3", ""]), rng.choice(["", "", "G17 ", "G18 ", "G19 "])
        first, second = rng.choice(["IJ", "IK", "JK"])
        center = f"{first}{self.positive()} {second}{self.positive()}"
        short, long = f"{self.axes('XY')} R{self.positive()}", f"{self.axes('XZ')} R-{self.positive()}"
        body = rng.choice([center, f"{center} Z{self.number()}", short, long])
        return f"{plane}{code} {body}{rng.choice(['', '', f' P{rng.randint(1, 4)}'])} F{self.positive()}"

    def setup(self) -> str:
        rng = self.rng
        return rng.choice(
            [
                f"G10 L{rng.choice(['2', '20', '1'])} P{rng.randint(0, 10)} {self.axes()}",
                f"G92 {self.axes()}",
                f"G4 P{self.number()}",
                f"G64 P{self.positive()} Q{self.positive()}",
                f"S{self.positive()} M{rng.choice('345')}",
                f"T{rng.randint(0, 99)} M6",
                f"(MSG, {self.number()})",
                f"F{self.positive()}",
                " ".join(rng.sample(CODES, rng.randint(1, 3))),
                "%",
                f"/ {self.move()}",
                f"N{rng.randint(0, 99)} {self.move()} (note) ; more",
                f"G93 G1 {self.axes()} F{self.positive()}",
            ]
        )

    def soup(self) -> str:
        """Any codes and any words."""
        rng = self.rng
        words = rng.sample(CODES, rng.randint(0, 3)) + [rng.choice(LETTERS) + self.number() for _ in range(rng.randint(0, 5))]
        rng.shuffle(words)
        return rng.choice(["", " "]).join(words)

    def nurbs(self) -> list[str]:
        rng = self.rng
        order = rng.randint(2, 5)
        count = order + rng.randint(0, 3)
        knots = [0] * order + sorted(rng.randint(1, 8) for _ in range(count - order)) + [9] * order
        paper = rng.random() < 0.5
        knot, weight, size = ("U", "W", f"K{order - 1}") if paper else ("K", "R", f"P{order}")
        points = ["X0 Y0", *(f"X{self.number()} Y{self.number()}" for _ in range(count - 1))]
        lines = [f"{knot}{u} {point}" + rng.choice(["", f" {weight}{self.positive()}"]) for u, point in zip(knots, points, strict=False)]
        tail = [f"{knot}{u}" for u in knots[count:]]
        return ["G0 X0 Y0", f"G06.2 {size} {lines[0]} F{self.positive()}", *lines[1:], *tail]

    def spline(self) -> list[str]:
        """G5, G5.1, G5.2 to G5.3, or BSPLINE."""
        rng, number = self.rng, self.number
        plane, first, second, i, j = rng.choice([("G17", "X", "Y", "I", "J"), ("G18", "Z", "X", "K", "I"), ("G19", "Y", "Z", "J", "K")])
        feed = f" F{self.positive()}"

        def point() -> str:
            return f"{first}{number()} {second}{number()}"

        kind = rng.randint(0, 3)
        if kind == 0:
            start = f"G5 {point()} {i}{number()} {j}{number()} P{number()} Q{number()}{feed}"
            return [plane, start, *(f"G5 {point()} P{number()} Q{number()}" for _ in range(rng.randint(0, 2)))]
        if kind == 1:
            return [f"{plane} G5.1 {point()} {i}{number()} {j}{self.positive()}{feed}"]
        count = rng.randint(2, 6)
        if kind == 2:
            lines = [point() + rng.choice(["", f" P{self.positive()}"]) for _ in range(count)]
            return [f"G5.2 P{self.positive()} L{rng.randint(2, count + 1)}{feed}", *lines, "G5.3"]
        lines = [point() + rng.choice(["", f" PW={self.positive()}"]) for _ in range(count)]
        lines[2:] = [line + rng.choice(["", f" PL={self.positive()}"]) for line in lines[2:]]
        return [f"BSPLINE SD={rng.randint(2, 3)}{feed}", *lines, "G0 X0"]

    def mutate(self, line: str) -> str:
        rng = self.rng
        for _ in range(rng.randint(1, 3)):
            at = rng.randint(0, len(line))
            match rng.randint(0, 4):
                case 0:
                    line = line[:at] + rng.choice(ALPHABET) + line[at:]
                case 1:
                    line = line[:at] + line[at + 1 :]
                case 2:
                    line = line[:at] + rng.choice(ALPHABET) + line[at + 1 :]
                case 3:
                    line = line[at:] + line[:at]
                case _:
                    line = line.swapcase() if rng.random() < 0.5 else line[:at] + " " + line[at:]
        return line

    def program(self) -> list[str]:
        rng = self.rng
        lines = ["G1 F100"] if rng.random() < 0.8 else []
        for _ in range(rng.randint(1, 5)):
            kind = rng.random()
            if kind < 0.35:
                lines.append(self.move())
            elif kind < 0.55:
                lines.append(self.arc())
            elif kind < 0.8:
                lines.append(self.setup())
            elif kind < 0.87:
                lines += self.nurbs()
            elif kind < 0.94:
                lines += self.spline()
            else:
                lines.append(self.soup())
        if rng.random() < 0.4:
            at = rng.randrange(len(lines))
            lines[at] = self.mutate(lines[at])
        if rng.random() < 0.1:
            del lines[rng.randrange(len(lines))]
        return lines
