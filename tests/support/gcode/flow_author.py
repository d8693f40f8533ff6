"""Random programs of loops, branches and calls, and their moves.

A small evaluator computes the moves. A program is a tree of tuples, so the evaluator has nothing
in common with an interpreter of lines. It uses Python's loops, exceptions to leave them, and
Python's recursion for calls. Numbers stay small and whole, so that floats are exact.
:mod:`tests.support.gcode.flow_writers` writes the programs as text.
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
