"""The order in which the lines of a program are carried out: loops, jumps, calls."""

from __future__ import annotations

import re

from tests.support.plain_reader.lines import NotRead, Variables, closing, code, value, words
from tests.support.plain_reader.moves import Moved, Mover

_LOCAL = re.compile(r"<_|^[1-9]\d{2,}$|^R")
_MACRO_LETTERS = dict(zip("ABCDEFHIJKMQRSTUVWXYZ", (
    1, 2, 3, 7, 8, 9, 11, 4, 5, 6, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26,
), strict=True))  # fmt: skip
_ASSIGNMENT = re.compile(r"#(<\w+>|\d+)=|\bR(\d+)=")


def read_plainly(lines: list[str], dialect: str) -> list[Moved]:
    """Return the moves of a program.

    Raises:
        NotRead: The program has something that this reader has no meaning for.
    """
    return Flow(lines, dialect).run()


class Flow:
    """The line that comes next, the calls that are open, and the variables."""

    def __init__(self, lines: list[str], dialect: str) -> None:
        self.siemens = dialect == "siemens"
        self.lines = [code(line.replace("\0", ""), siemens=self.siemens) for line in lines]
        self.numbers = [re.match(r"\s*[/\s]*N(\d+)", line.upper()) for line in lines]
        self.mover = Mover(dialect=dialect)
        self.variables: Variables = {}
        self.calls: list[tuple[int, Variables, int, int]] = []
        self.at = 0
        self.seen_percent = False

    def run(self) -> list[Moved]:
        for _ in range(200_000):
            if not 0 <= self.at < len(self.lines):
                return self.mover.moved
            line = self.at
            self.at += 1
            if self.carry_out(line):
                return self.mover.moved
        raise NotRead("an endless loop")

    def carry_out(self, index: int) -> bool:
        """Carry out a line; return whether the program ends there."""
        text = self.lines[index].lstrip("/")
        if text.startswith("%"):
            ends, self.seen_percent = self.seen_percent, True
            return ends and not self.siemens
        if not text or text.startswith(("$", "[BILLET", "[TOOLDEF", ":", "MSG")):
            return False
        if self.siemens and self._siemens(index, text):
            return False
        if re.match(r"O(<|\d)", text) and not re.fullmatch(r"O\d+.*", text):
            return self._o_word(index, text)
        if re.match(r"O\d+[A-Z]", text):
            return self._o_word(index, text)
        if text.startswith("O"):
            return False
        if self._macro(index, text):
            return False
        if text.startswith("#3000="):
            return True
        if _ASSIGNMENT.match(text):
            self._assign(text)
            return False
        if not self.siemens:
            text = re.sub(r"/(?=[A-Z])", "", text)
        return self._words(index, words(text, self.variables))

    def _words(self, index: int, found: list[tuple[str, float]]) -> bool:
        given = dict(found)
        codes = {number for letter, number in found if letter == "M"}
        goes_on = [word for word in found if word[0] not in "NO"]
        if ("G", 65.0) in found:
            arguments = {
                str(_MACRO_LETTERS[letter]): number
                for letter, number in found
                if letter in _MACRO_LETTERS
            }
            self._call(self._program(int(given["P"])), int(given.get("L", 1)), arguments)
            return False
        if 98 in codes:
            repeats = int(given.get("L", 1))
            if "P" not in given:
                self._call(self._block(int(given["Q"])), repeats, None)
                return False
            number = int(given["P"])
            if number > 9999 and self.mover.dialect == "fanuc":
                number, repeats = number % 10000, number // 10000
            self._call(self._program(number), repeats, None)
            return False
        if 97 in codes:
            self._call(self._block(int(given["P"])), int(given.get("L", 1)), None)
            return False
        if codes & {99, 17} and (99 in codes or self.siemens):
            return self._return()
        if "SUPA" in given:
            goes_on = [("G", 53.0), *(w for w in goes_on if w[0] not in ("SUPA", "D"))]
        self.mover.line(index + 1, goes_on)
        self._remember()
        return bool(codes & {2, 30})

    def _remember(self) -> None:
        for axis, number in enumerate(self.mover.programmed):
            self.variables[str(5041 + axis)] = number / self.mover.unit
            self.variables[str(5061 + axis)] = number / self.mover.unit
            origin = self.mover.systems.get(1, [0.0, 0.0, 0.0])
            self.variables[str(5221 + axis)] = origin[axis] / self.mover.unit

    def _assign(self, text: str) -> None:
        places = [*_ASSIGNMENT.finditer(text)]
        if not self.siemens and len(places) > 1:
            raise NotRead(text)
        ends = [place.start() for place in places[1:]] + [len(text)]
        for place, end in zip(places, ends, strict=True):
            name = place[1] or f"R{place[2]}"
            self.variables[name] = value(text[place.end() : end], self.variables)

    # Calls

    def _program(self, number: int) -> int:
        for index, line in enumerate(self.lines):
            if re.fullmatch(rf"[O:]0*{number}\s*", line):
                return index + 1
        raise NotRead(f"O{number}")

    def _block(self, number: int) -> int:
        for index, found in enumerate(self.numbers):
            if found and int(found[1]) == number:
                return index
        raise NotRead(f"N{number}")

    def _call(self, place: int, repeats: int, arguments: Variables | None) -> None:
        if repeats < 1:
            return
        self.calls.append((self.at, self.variables, place, repeats))
        if arguments is not None:
            common = {k: v for k, v in self.variables.items() if _LOCAL.search(k)}
            self.variables = common | arguments
        self.at = place

    def _return(self) -> bool:
        if not self.calls:
            return True
        back, variables, place, repeats = self.calls.pop()
        variables.update({k: v for k, v in self.variables.items() if _LOCAL.search(k)})
        if repeats > 1:
            self.calls.append((back, variables, place, repeats - 1))
            self.at = place
            return False
        self.at, self.variables = back, variables
        return False

    # Blocks of macro B, of LinuxCNC and of SINUMERIK

    def _macro(self, index: int, text: str) -> bool:
        if text.startswith("WHILE["):
            end = closing(text, 5)
            name = text[end + 1 :].removeprefix("DO")
            if not value(text[5 : end + 1], self.variables):
                self.at = self.lines.index(f"END{name}", index) + 1
            return True
        if found := re.fullmatch(r"END([123])", text):
            starts = [at for at in range(index) if self.lines[at].endswith(f"DO{found[1]}")]
            self.at = starts[-1]
            return True
        if text.startswith("IF["):
            end = closing(text, 2)
            then = text[end + 1 :]
            if value(text[2 : end + 1], self.variables):
                if then.startswith("GOTO"):
                    self.at = self._block(int(then[4:]))
                else:
                    self._assign(then.removeprefix("THEN"))
            return True
        if text.startswith("GOTO"):
            self.at = self._block(int(text[4:]))
            return True
        return False

    def _o_word(self, index: int, text: str) -> bool:
        found = re.match(r"O(<\w+>|\d+)(\w+)", text)
        if found is None:
            raise NotRead(text)
        label, keyword = found[1], found[2]
        rest = text[found.end() :]
        if keyword == "SUB":
            self.at = self._o_line(label, "ENDSUB", index) + 1
        elif keyword == "CALL":
            arguments: Variables = {}
            while rest:
                end = closing(rest, 0)
                arguments[str(len(arguments) + 1)] = value(rest[: end + 1], self.variables)
                rest = rest[end + 1 :]
            self._call(self._o_line(label, "SUB", 0) + 1, 1, arguments)
        elif keyword == "ENDSUB":
            return self._return()
        elif keyword == "WHILE":
            if not value(rest, self.variables):
                self.at = self._o_line(label, "ENDWHILE", index) + 1
        elif keyword == "ENDWHILE":
            self.at = self._o_line(label, "WHILE", 0)
        else:
            raise NotRead(text)
        return False

    def _o_line(self, label: str, keyword: str, after: int) -> int:
        for index in range(after, len(self.lines)):
            if re.match(rf"O{re.escape(label)}{keyword}\b", self.lines[index].replace("[", " [")):
                return index
        raise NotRead(f"O{label} {keyword}")

    def _siemens(self, index: int, text: str) -> bool:
        """Carry out what SINUMERIK has in words of its own; return whether the line was such."""
        if text.startswith("WHILE "):
            if not value(text[6:], self.variables):
                self.at = self.lines.index("ENDWHILE", index) + 1
            return True
        if text == "ENDWHILE":
            self.at = max(at for at in range(index) if self.lines[at].startswith("WHILE "))
            return True
        if found := re.fullmatch(r"L(\d+)(?:\s*P(\d+))?", text):
            name = f"%_N_L{found[1]}_SPF"
            self._call(self.lines.index(name) + 1, int(found[2] or 1), None)
            return True
        if text.startswith("MCALL"):
            self.mover.siemens_cycle = self._heights(text[5:].strip())
            return True
        if text.startswith("G4 "):
            return True
        return text.startswith(("CYCLE832", "T="))

    def _heights(self, call: str) -> tuple[float, float, float] | None:
        """Return start, depth and end of a drilling cycle; None without one."""
        if not call:
            return None
        found = re.fullmatch(r"CYCLE8[1-5]\((.*)\)", call)
        if found is None:
            raise NotRead(call)
        out, reference, clearance, depth = (float(each) for each in found[1].split(",")[:4])
        return reference + clearance, depth, out
