"""Where a program is: the calls that it is in, what they return to, and the limits that keep it
from going on for ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from cnc.gcode.program.listing import Listing, Mark, Step
from cnc.model.blocks import CallBoundary
from cnc.model.diagnostics import CncError

if TYPE_CHECKING:
    from cnc.gcode.program.interpreter import Interpreter
    from cnc.gcode.program.subprograms import Library


@dataclass(frozen=True, slots=True)
class Limits:
    """``repeated_lines``: lines that loops and calls may execute again in a program; ``depth``:
    calls within each other.
    """

    repeated_lines: int = 2_000_000
    depth: int = 100


@dataclass(slots=True, eq=False)
class Frame:
    """A call, or the main program.

    ``kind``: an O-word's sub, M98's program, G65's macro. ``begin`` is the line where its body
    begins, ``scope`` the line of its name (0: none), which tells its labels from those of others.
    ``caller`` and ``at``: where the call stands; ``back``: the line to go on at. ``left`` is how
    often it is still to be repeated, ``counts`` holds what is left of its repeat loops.
    """

    kind: Literal["main", "sub", "program", "macro"]
    name: str
    listing: Listing
    begin: int
    scope: int
    caller: Listing
    at: Mark
    back: int
    left: int = 0
    repeated: bool = False
    since: int = 0
    counts: dict[Step, int] = field(default_factory=dict)


class Flow:
    """The flow of control. ``mark_calls``: whether the calls of the main program stand among its
    blocks.

    ``executed`` is the number of lines executed so far, kept up to date for steps; ``new`` how many
    of them for the first time.
    """

    def __init__(
        self,
        interpreter: Interpreter,
        listing: Listing,
        library: Library,
        limits: Limits,
        *,
        mark_calls: bool = False,
    ) -> None:
        self.interpreter = interpreter
        self.parameters = interpreter.parameters
        self.library = library
        self.limits = limits
        self.main = self.listing = listing
        self._mark_calls = mark_calls
        self.frame = Frame("main", "", listing, 1, 0, listing, Mark(0), 0)
        self.frames: list[Frame] = []
        self.executed = self.new = 0
        self.value: float | None = None
        self.percent = False
        self.main_border = 0
        self.parameters.bind("_value", lambda: 0.0 if self.value is None else self.value)
        self.parameters.bind("_value_returned", lambda: 0.0 if self.value is None else 1.0)
        self._look_at(listing)

    def enter(self, frame: Frame, arguments: Sequence[float] | None = None) -> int:
        """Go into a call; the line to go on at. With ``arguments`` it has parameters of its own."""
        if len(self.frames) >= self.limits.depth:
            hint = "what calls itself needs a condition that ends it, or raise program.max_call_depth in the machine file"
            message = f"{frame.name} is called within {self.limits.depth} other calls"
            raise frame.caller.fault(frame.at, "call-too-deep", message, hint)
        self._mark(frame, inside=True)
        self.frames.append(self.frame)
        self.frame = frame
        frame.since = self.executed
        parameters = self.parameters
        if arguments is not None:
            parameters.push(arguments)
        elif not parameters.macro:
            # M98 in RS274/NGC: names of its own, but the caller's numbers. FANUC's has no names,
            # and shares its numbers too.
            numbers = parameters.locals
            parameters.push(())
            parameters.locals = numbers
        self.interpreter.entered()
        self._look_at(frame.listing)
        return frame.begin

    def leave(self) -> int:
        """Go back to the caller; the line to go on at."""
        left = self._pop()
        self.interpreter.left()
        self._mark(left, inside=False)
        self._look_at(left.caller)
        return left.back

    def _mark(self, frame: Frame, *, inside: bool) -> None:
        if self._mark_calls and not self.frames:
            self.interpreter.out.put(CallBoundary(self.main.name, frame.at.line, inside))

    def unwind(self) -> None:
        """The program has ended, perhaps in a call: the parameters are those of the main program
        again.
        """
        while self.frames:
            self._pop()

    def _pop(self) -> Frame:
        left = self.frame
        self.frame = self.frames.pop()
        if left.kind != "program" or not self.parameters.macro:
            self.parameters.pop()
        return left

    def endless(self, line: int) -> CncError:
        """The error for too many lines executed again, at the loop or the call that is to blame."""
        listing, at, name = self._to_blame(line)
        many = f"{self.limits.repeated_lines:,}".replace(",", " ")
        message = f"{name} does not come to an end: more than {many} lines were executed again"
        hint = "mend the condition that ends it, or raise program.max_repeated_lines in the machine file"
        return listing.fault(at, "loop-endless", message, hint)

    def _to_blame(self, line: int) -> tuple[Listing, Mark, str]:
        """The innermost loop or call whose lines took half of what is allowed."""
        suspects: list[tuple[int, Listing, Mark, str]] = []
        listing = self.listing
        for frame in [self.frame, *reversed(self.frames)]:
            around = [loop for loop in listing.loops if loop.first <= line <= loop.last]
            around.sort(key=lambda loop: loop.last - loop.first)
            suspects += [(loop.since, listing, loop.at, loop.name) for loop in around]
            if frame.repeated:
                suspects.append((frame.since, frame.caller, frame.at, f"the call of {frame.name}"))
            line, listing = frame.at.line, frame.caller
        if not suspects:  # calls that branch again and again
            outermost = [*self.frames, self.frame][min(1, len(self.frames))]
            return outermost.caller, outermost.at, f"the call of {outermost.name}"
        enough = self.executed - self.limits.repeated_lines // 2
        return next(
            (each for each in suspects if each[0] <= enough),
            min(suspects, key=lambda each: each[0]),
        )[1:]

    def _look_at(self, listing: Listing) -> None:
        interpreter = self.interpreter
        if interpreter.here.file != listing.name:
            interpreter.out.flush()
        self.listing = listing
        here = interpreter.here
        here.file, here.text_of, here.words_of = listing.name, listing.source, listing.words
