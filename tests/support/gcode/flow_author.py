"""Random programs of loops, branches and calls, as O-words and as FANUC's macro B.

A small evaluator computes their moves. A program is a tree of tuples, so the evaluator has nothing
in common with an interpreter of lines. It uses Python's loops, exceptions to leave them, and
Python's recursion for calls. Numbers stay small and whole, so that floats are exact.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Any

Node = tuple[Any, ...]

STEPS, DEEPEST = 4000, 8
"""Limit of the evaluator. Programs beyond it are left out."""
NUMBERED = 5
"""Variables #1 to #5 are the arguments and locals of every subroutine."""


class _Break(Exception):
    def __init__(self, loop: int) -> None:
        self.loop = loop


class _Continue(_Break):
    pass


class _Return(Exception):
    pass


@dataclass
class Program:
    """Main program and subroutines by number; those in ``forward`` stand after the main program."""

    main: list[Node]
    subs: dict[int, list[Node]]
    behind: set[int] = field(default_factory=set)


class Author:
    """Writes programs with up to ``most_loops`` nested loops; ``repeats``: with repeat loops."""

    def __init__(self, seed: int, *, most_loops: int = 9, repeats: bool = True) -> None:
        self.rng = random.Random(seed)
        self.most_loops = most_loops
        self.repeats = repeats
        self.block = 0
        self.counter = 0
        self.size = 0

    def program(self) -> Program:
        rng = self.rng
        count = rng.choice([0, 0, 1, 2, 3])
        subs = {number: self.body(number, count, 0, []) for number in range(count)}
        main = self.body(None, count, 0, [])
        main.append(("move", ("number", 999)))
        return Program(main, subs, {number for number in subs if rng.random() < 0.3})

    def body(
        self, sub: int | None, subs: int, depth: int, loops: list[tuple[int, str]]
    ) -> list[Node]:
        found = []
        for _ in range(self.rng.randint(1, 4 if depth < 2 else 2)):
            found.append(self.node(sub, subs, depth, loops))
        return found

    def node(self, sub: int | None, subs: int, depth: int, loops: list[tuple[int, str]]) -> Node:
        rng = self.rng
        self.size += 1
        kinds = ["move"] * 4 + ["set"] * 3
        if depth < 4 and self.size < 60:
            kinds += ["if"] * 3
            if len(loops) < self.most_loops:
                kinds += ["while", "do"] + ["repeat"] * self.repeats
        if any(kind != "repeat" for _, kind in loops):
            kinds += ["leave"] * 2
        if callable_ := range(0 if sub is None else sub + 1, subs):
            kinds += ["call"] * 2
        if sub is not None:
            kinds += ["return", "again"]
        kind = rng.choice(kinds)
        match kind:
            case "move":
                return "move", self.value()
            case "set":
                return "set", rng.choice([1, 2, 3, 4, 101, 102]), self.value()
            case "if":
                branches = [
                    (self.condition(), self.body(sub, subs, depth + 1, loops))
                    for _ in range(rng.choice([1, 1, 2, 3]))
                ]
                otherwise = self.body(sub, subs, depth + 1, loops) if rng.random() < 0.5 else None
                self.block += 1
                return "if", self.block, branches, otherwise
            case "while" | "do":
                self.block += 1
                self.counter += 1
                label, counter = self.block, 110 + self.counter
                return (
                    kind,
                    label,
                    counter,
                    rng.randint(0, 3),
                    self.body(sub, subs, depth + 1, [*loops, (label, kind)]),
                )
            case "repeat":
                self.block += 1
                label = self.block
                return (
                    "repeat",
                    label,
                    rng.randint(-1, 3),
                    self.body(sub, subs, depth + 1, [*loops, (label, kind)]),
                )
            case "leave":
                label = rng.choice([label for label, kind in loops if kind != "repeat"])
                self.block += 1
                return (
                    "if",
                    self.block,
                    [(self.condition(), [(rng.choice(["break", "continue"]), label)])],
                    None,
                )
            case "call":
                arguments: list[Node] = [self.value() for _ in range(rng.randint(0, 4))]
                if len(arguments) == 4:
                    arguments.append(("number", rng.randint(0, 3)))
                return "call", rng.choice(list(callable_)), arguments
            case "again":
                # Calls itself with a smaller #1, at most a few times.
                self.block += 1
                less = ("sum", ("variable", 5), "-", ("number", 1))
                call: Node = (
                    "call",
                    sub,
                    [self.value(), self.value(), self.value(), self.value(), less],
                )
                return "if", self.block, [((("variable", 5), "GT", ("number", 0)), [call])], None
            case _:
                self.block += 1
                return "if", self.block, [(self.condition(), [("return", self.value())])], None

    def value(self) -> Node:
        rng = self.rng
        return rng.choice(
            [
                ("number", rng.randint(-9, 9)),
                ("variable", rng.choice([1, 2, 3, 101, 102])),
                (
                    "sum",
                    ("variable", rng.choice([1, 2, 3, 101, 102, 103])),
                    rng.choice("+-"),
                    ("number", rng.randint(1, 5)),
                ),
            ]
        )

    def condition(self) -> Node:
        return self.value(), self.rng.choice(["EQ", "NE", "GT", "GE", "LT", "LE"]), self.value()


class Evaluator:
    """The moves of a program. #103 is the value of the last call."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.shared: dict[int, float] = {}
        self.moves: list[float] = []
        self.steps = self.depth = 0

    def run(self) -> list[float]:
        self.body(self.program.main, {})
        return self.moves

    def value(self, node: Node, own: dict[int, float]) -> float:
        match node:
            case ("number", number):
                return number
            case ("variable", index):
                return (own if index <= NUMBERED else self.shared).get(index, 0)
            case (_, left, "+", right):
                return self.value(left, own) + self.value(right, own)
            case (_, left, _, right):
                return self.value(left, own) - self.value(right, own)
        raise AssertionError(node)

    def holds(self, condition: Node, own: dict[int, float]) -> bool:
        a, b = self.value(condition[0], own), self.value(condition[2], own)
        return {"EQ": a == b, "NE": a != b, "GT": a > b, "GE": a >= b, "LT": a < b, "LE": a <= b}[
            condition[1]
        ]

    def body(self, nodes: list[Node], own: dict[int, float]) -> None:
        for node in nodes:
            self.node(node, own)

    def node(self, node: Node, own: dict[int, float]) -> None:
        self.steps += 1
        if self.steps > STEPS:
            raise OverflowError
        match node:
            case ("move", value):
                self.moves.append(self.value(value, own))
            case ("set", index, value):
                (own if index <= NUMBERED else self.shared)[index] = self.value(value, own)
            case ("if", _, branches, otherwise):
                for condition, body in branches:
                    if self.holds(condition, own):
                        self.body(body, own)
                        return
                self.body(otherwise or [], own)
            case ("while", label, counter, times, body):
                self.shared[counter] = 0
                while self.shared[counter] < times:
                    if not self.round(label, counter, body, own):
                        break
            case ("do", label, counter, times, body):
                self.shared[counter] = 0
                while self.round(label, counter, body, own) and self.shared[counter] < times:
                    pass
            case ("repeat", label, times, body):
                for _ in range(times):
                    self.body(body, own)
            case ("break", label):
                raise _Break(label)
            case ("continue", label):
                raise _Continue(label)
            case ("call", sub, arguments):
                inner = {
                    index + 1: self.value(argument, own) for index, argument in enumerate(arguments)
                }
                self.depth += 1
                if self.depth > DEEPEST:
                    raise OverflowError
                try:
                    self.body(self.program.subs[sub], inner)
                    self.shared[103] = 0
                except _Return as back:
                    self.shared[103] = back.args[0]
                self.depth -= 1
            case ("return", value):
                raise _Return(self.value(value, own))

    def round(self, label: int, counter: int, body: list[Node], own: dict[int, float]) -> bool:
        """Execute one round of a loop; return whether the loop continues."""
        self.shared[counter] += 1
        try:
            self.body(body, own)
        except _Continue as left:
            if left.loop != label:
                raise
        except _Break as left:
            if left.loop != label:
                raise
            return False
        return True


def expression(node: Node) -> str:
    match node:
        case ("number", number):
            return str(number)
        case ("variable", index):
            return f"#{index}"
        case (_, left, sign, right):
            return f"[{expression(left)} {sign} {expression(right)}]"
    raise AssertionError(node)


def bracket(node: Node) -> str:
    return f"[{' '.join(expression(part) if isinstance(part, tuple) else part for part in node)}]"


class OWords:
    """A program in RS274/NGC. Labels are numbers or names; #103 is set from ``#<_value>``."""

    def __init__(self, program: Program, seed: int) -> None:
        self.program = program
        self.rng = random.Random(seed)
        self.lines: list[str] = []
        self.names: dict[int, str] = {}

    def text(self) -> list[str]:
        order = sorted(self.program.subs, key=lambda _: self.rng.random())
        for sub in order:
            if sub not in self.program.behind:
                self.sub(sub)
        self.body(self.program.main)
        self.lines.append("M2")
        for sub in order:
            if sub in self.program.behind:
                self.sub(sub)
        return [self.varied(line) for line in self.lines]

    def varied(self, line: str) -> str:
        kind = self.rng.randrange(12)
        if kind == 0:
            return line.upper()
        if kind == 1:
            return line.replace(" ", "")
        if kind == 2:
            return "  " + line.replace(" ", "  ")
        return line

    def label(self, block: int) -> str:
        if block not in self.names:
            self.names[block] = (
                f"o{block}"
                if self.rng.random() < 0.7
                else f"o<block {'abcdefghij'[block % 10]}{block}>"
            )
        return self.names[block]

    def sub(self, number: int) -> None:
        self.lines.append(f"o<sub{number}> sub")
        self.body(self.program.subs[number])
        self.lines.append(f"o<sub{number}> endsub")

    def body(self, nodes: list[Node]) -> None:
        for node in nodes:
            self.node(node)
            if self.rng.random() < 0.1:
                self.lines.append(self.rng.choice(["", "(o9 if [1])", "; o9 endif", "   "]))

    def node(self, node: Node) -> None:
        out = self.lines.append
        match node:
            case ("move", value):
                out(f"G0 X{expression(value)}")
            case ("set", index, value):
                out(f"#{index} = {expression(value)}")
            case ("if", block, branches, otherwise):
                label = self.label(block)
                for index, (condition, body) in enumerate(branches):
                    out(f"{label} {'elseif' if index else 'if'} {bracket(condition)}")
                    self.body(body)
                if otherwise is not None:
                    out(f"{label} else")
                    self.body(otherwise)
                out(f"{label} endif")
            case ("while", block, counter, times, body):
                out(f"#{counter} = 0")
                out(f"{self.label(block)} while [#{counter} LT {times}]")
                out(f"#{counter} = [#{counter} + 1]")
                self.body(body)
                out(f"{self.label(block)} endwhile")
            case ("do", block, counter, times, body):
                out(f"#{counter} = 0")
                out(f"{self.label(block)} do")
                out(f"#{counter} = [#{counter} + 1]")
                self.body(body)
                out(f"{self.label(block)} while [#{counter} LT {times}]")
            case ("repeat", block, times, body):
                out(f"{self.label(block)} repeat [{times}]")
                self.body(body)
                out(f"{self.label(block)} endrepeat")
            case ("break" | "continue" as word, block):
                out(f"{self.label(block)} {word}")
            case ("call", sub, arguments):
                out(
                    f"o<sub{sub}> call "
                    f"{' '.join(f'[{expression(argument)}]' for argument in arguments)}"
                )
                out("#103 = #<_value>")
            case ("return", value):
                out(f"o<sub{self.current()}> return [{expression(value)}]")

    def current(self) -> str:
        """Number of the subroutine that is being written."""
        first = next(line for line in reversed(self.lines) if line.endswith(" sub"))
        return first.removeprefix("o<sub").removesuffix("> sub")


class MacroB:
    """A program in FANUC's macro B: branches by GOTO, loops by WHILE, calls by G65. A program
    returns its value in #103.
    """

    def __init__(self, program: Program, seed: int) -> None:
        self.program = program
        self.rng = random.Random(seed)
        self.lines: list[str] = []
        self.blocks = 0
        self.loops: list[int] = []
        self.ends: dict[int, tuple[int, int]] = {}

    def text(self) -> list[str]:
        self.lines.append("O1000")
        self.lines.append("#101=0 #102=0 #103=0 #1=0 #2=0 #3=0 #5=0")
        self.body(self.program.main)
        self.lines.append("M30")
        for sub, body in self.program.subs.items():
            self.lines.append(f"O{2000 + sub}")
            for index in (1, 2, 3, 5):
                self.lines.append(f"IF [#{index} EQ #0] THEN #{index} = 0")
            self.body(body)
            self.lines.append("#103 = 0")
            self.lines.append("M99")
        return self.lines

    def new(self) -> int:
        self.blocks += 1
        return self.blocks

    def body(self, nodes: list[Node]) -> None:
        for node in nodes:
            self.node(node)

    def node(self, node: Node) -> None:
        out = self.lines.append
        match node:
            case ("move", value):
                out(f"G0 X{expression(value)}")
            case ("set", index, value):
                out(f"#{index} = {expression(value)}")
            case ("if", _, branches, otherwise):
                end = self.new()
                for condition, body in branches:
                    then, following = self.new(), self.new()
                    out(f"IF {bracket(condition)} GOTO {then}")
                    out(f"GOTO {following}")
                    out(f"N{then}")
                    self.body(body)
                    out(f"GOTO {end}")
                    out(f"N{following}")
                self.body(otherwise or [])
                out(f"N{end}")
            case ("while" | "do" as kind, label, counter, times, body):
                number = self.rng.choice(
                    [number for number in (1, 2, 3) if number not in self.loops]
                )
                self.ends[label] = again, behind = self.new(), self.new()
                self.loops.append(number)
                if kind == "while":
                    out(f"#{counter} = 0")
                    out(f"WHILE [#{counter} LT {times}] DO{number}")
                else:
                    out(f"#{counter} = 0")
                    out(f"DO {number}")
                out(f"#{counter} = #{counter} + 1")
                self.body(body)
                out(f"N{again}")
                if kind == "do":
                    out(f"IF [#{counter} GE {times}] GOTO {behind}")
                out(f"END{number}")
                out(f"N{behind}")
                self.loops.pop()
            case ("break", label):
                out(f"GOTO {self.ends[label][1]}")
            case ("continue", label):
                out(f"GOTO {self.ends[label][0]}")
            case ("call", sub, arguments):
                # #4 is not reached by a letter of the first list that is not I.
                written = "".join(
                    f" {letter}{expression(argument)}"
                    for letter, argument in zip("ABCIJ", arguments, strict=False)
                )
                out(f"G65 P{2000 + sub}{written}")
            case ("return", value):
                out(f"#103 = {expression(value)}")
                out("M99")
