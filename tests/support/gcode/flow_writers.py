"""Text of the random programs: O-words, and FANUC's macro B."""

from __future__ import annotations

import random

from tests.support.gcode.flow_author import Node, Program


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
