"""Random lines that are hard to scan, and their comparison with the grammar."""

from __future__ import annotations

import random

from cnc.gcode.reader.parser import Syntax, parse_line
from cnc.gcode.reader.statements import Statement
from tests.support.gcode.fuzzing import Author

SYNTAXES = [
    Syntax(flavour, siemens, dollar)
    for flavour in ("ngc", "macro-b", "none")
    for siemens in (0, 1)
    for dollar in (0, 1)
]  # type: ignore[arg-type]


def agree(line: str, found: Statement, syntax: Syntax) -> None:
    """Assert that the statements of scanner and grammar are equal."""
    expected = parse_line.__wrapped__(line, syntax)
    assert found == expected, line
    # Equal numbers may still differ in the sign of zero.
    assert [word.number.hex() for word in found.words] == [
        word.number.hex() for word in expected.words
    ], line


LETTERS = "XYZFGMNIJKRPSTHDABCUVWLQEOxyzgmno"

COMMENTS = [
    "",
    "note",
    "T1 D=5",
    "a, b",
    "msg, hi",
    " MSG ,hi",
    "debug,#1",
    "py",
    "Print,x",
    "log",
    "logclose",
    "probe x",
    "é",
    "a\tb",
]

ODD = [*"é\x00\x0b\x7f\u2028#=%/*$@.-+();1", "[1]", "#1", "O100", "SD=3"]


class Adversary:
    """Writes random lines that are difficult for a scanner."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.author = Author(seed)

    def digits(self, least: int, most: int) -> str:
        return "".join(self.rng.choice("0123456789") for _ in range(self.rng.randint(least, most)))

    def number(self) -> str:
        rng = self.rng
        match rng.randint(0, 14):
            case 0 | 1 | 2 | 9 | 10 | 11:
                return f"{rng.uniform(-500, 500):.{rng.randint(0, 6)}f}"
            case 3 | 4 | 12 | 13:
                return str(rng.randint(0, 100))
            case 5:
                return rng.choice(["", "-", "+"]) + self.digits(0, 9) + "." + self.digits(0, 17)
            case 6:
                return rng.choice(["", "-", "+"]) + self.digits(1, 20)
            case 7:
                return rng.choice(
                    [
                        "9007199254740992",
                        "9007199254740993",
                        "1000000000",
                        "1000000000.1",
                        "900719925.4740993",
                        "-0",
                        "-.0",
                    ]
                )
            case 8:
                return rng.choice(["", "-", "+"]) + repr(rng.random())
            case _:
                return rng.choice(
                    [
                        "1.",
                        ".5",
                        "-.25",
                        "+3",
                        "00012",
                        "1 2 . 5",
                        "- 5",
                        "1e5",
                        "",
                        "-",
                        "1.2.3",
                        ".",
                        "#1",
                        "[2*3]",
                    ]
                )

    def comment(self) -> str:
        rng = self.rng
        inside = rng.choice(COMMENTS)
        return (
            rng.choice([f"({inside})", f"({inside})", f"({inside}", f"{inside})", f"({inside}(x))"])
            if rng.random() < 0.9
            else ";" + inside
        )

    def line(self) -> str:
        rng = self.rng
        if rng.random() < 0.1:
            return rng.choice(self.author.program().lines or [""])
        parts = [rng.choice(["", "", "", "/", " ", "\t"])] if rng.random() < 0.3 else []
        if rng.random() < 0.3:
            parts.append(rng.choice("Nn") + str(rng.randint(0, 99999)))
        for _ in range(rng.randint(0, 6)):
            kind = rng.random()
            if kind < 0.8:
                parts.append(
                    rng.choice(LETTERS) + rng.choice(["", *[""] * 20, " "]) + self.number()
                )
            elif kind < 0.97:
                parts.append(self.comment())
            else:
                parts.append(rng.choice(ODD))
        line = rng.choice(["", " ", " ", "  ", "\t"]).join(parts)
        return self.author.mutate(line) if rng.random() < 0.1 else line

    def data(self, count: int) -> bytes:
        rng = self.rng
        pieces = []
        for _ in range(count):
            line = self.line().replace("\n", "").replace("\r", "")
            pieces += [
                line.encode(rng.choice(["utf-8", "utf-8", "latin-1"]), errors="replace"),
                rng.choice([b"\n", b"\n", b"\r\n", b"\r"]),
            ]
        return b"".join(pieces)


def decoded(line: bytes) -> str:
    try:
        return line.decode()
    except UnicodeDecodeError:
        return line.decode("latin-1")
