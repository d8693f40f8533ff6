"""The state of control flow: steps of lines, calls within each other, limits of repetition.

A line becomes a *step* when it is reached for the first time. A :class:`Listing` holds the steps of
one text. A :class:`Frame` is a call (or the main program); :class:`Flow` is the stack of frames.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

from cnc.gcode.core.coordinates import ProgramFrame
from cnc.gcode.core.interpreter import Interpreter
from cnc.gcode.reader.parser import Syntax
from cnc.gcode.reader.source_text import LineIndex, Place, Text, Window
from cnc.gcode.reader.statements import Control, Statement
from cnc.model.blocks import CallBoundary
from cnc.model.diagnostics import CncError

State = TypeVar("State")

KEPT_PAGES = 4
"""Pages of a text whose steps are kept."""


class Step(Protocol):
    """The effect of a line on the flow of control."""

    def run(self, flow: Flow, line: int) -> int:
        """Execute the step that stands at ``line``; return the number of the next line."""


Maker = Callable[["Flow", int, Control], Step]
"""Makes the step of a control line, whose number is given."""


class ControlStep:
    """The step of a control line.

    Attributes:
        at: Its place.
        control: Its control part.
    """

    __slots__ = ("at", "control")

    def __init__(self, _: Flow, line: int, control: Control) -> None:
        self.at = Place(line, control.column, control.length)
        self.control = control


@dataclass(slots=True, eq=False)
class Loop:
    """Lines that may be executed again.

    Attributes:
        name: The loop as messages call it.
        at: The place that an error about the loop points at.
        first: First line of the loop.
        last: Last line of the loop.
        since: Number of executed lines when the loop was entered.
    """

    name: str
    at: Place
    first: int
    last: int
    since: int = 0


@dataclass(slots=True, eq=False)
class Section:
    """Lines that a REPEAT of SINUMERIK executes again.

    Attributes:
        listing: Their text.
        depth: Number of calls around them.
        first: The first of them.
        last: The last of them.
        after: The line after REPEAT.
        repeats_left: Number of executions to come after this one.
    """

    listing: Listing
    depth: int
    first: int
    last: int
    after: int
    repeats_left: int


class Files(Protocol):
    """Files of subroutines, for the call at a place. Each method may raise GcodeError."""

    def find(self, label: str, at: Place) -> Listing | None:
        """Return the file of a label, or None if there is none."""

    def open(self, path: Path, at: Place) -> Listing:
        """Return the file at a path."""


class Nothing:
    """An empty line, a deleted one, or the end of a block."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Continue with the next line."""
        return line + 1


NOTHING = Nothing()


class Page:
    """A window of text with a step for each line: None until the line is reached."""

    __slots__ = ("count", "first", "steps", "window")

    def __init__(self, window: Window) -> None:
        self.window = window
        self.first, self.count = window.first, window.count
        self.steps: list[Step | Statement | None] = [None] * window.count


@dataclass(slots=True, eq=False)
class Subroutine:
    """A subroutine of O-words: its label, the line of its sub and that of its endsub."""

    listing: Listing
    label: str
    first: int
    last: int

    @property
    def name(self) -> str:
        """The subroutine as messages call it."""
        return f"o{self.label}"


class Listing(LineIndex):
    """A text with the steps of its lines.

    Attributes:
        steps: Steps that outlast their page, by line.
        labels: Line of each block label, by scope and label.
        loops: Loops found so far.
        subs: Subroutines found so far, by label.
        last_executed: The highest line that was ever executed.
        section_ends: Lines after the sections that SINUMERIK's REPEAT executes, with the function
            that puts the repetition before the step of the line.
    """

    def __init__(
        self, text: Text, syntax: Syntax, *, block_delete: frozenset[int] | bool = False
    ) -> None:
        super().__init__(text, syntax, block_delete=block_delete)
        self.steps: dict[int, Step] = {}
        self.labels: dict[tuple[int, str], int] = {}
        self.loops: list[Loop] = []
        self.subs: dict[str, Subroutine] = {}
        self.last_executed = 0
        self.section_ends: dict[int, Callable[[Step], Step]] = {}
        self._pages: OrderedDict[int, Page] = OrderedDict()

    def page(self, line: int) -> Page | None:
        """Return the page that holds a line (from 1); None past the end."""
        window = self.window(line)
        if window is None:
            return None
        page = self._pages.get(window.first)
        if page is None:
            page = self._pages[window.first] = Page(window)
            if len(self._pages) > KEPT_PAGES:
                self._pages.popitem(last=False)
        self._pages.move_to_end(window.first)
        return page

    def forget_steps(self) -> None:
        """Make the steps of all lines again when they are reached."""
        for page in self._pages.values():
            page.steps[:] = [None] * page.count


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits that end endless programs.

    Attributes:
        repeated_lines: Lines of a program that loops and calls may execute again.
        depth: Calls within each other.
    """

    repeated_lines: int = 2_000_000
    depth: int = 100


@dataclass(slots=True, eq=False)
class Frame:
    """A call, or the main program.

    Attributes:
        kind: The subroutine of an O-word, the program of M98, or the macro of G65.
        name: The callee as messages call it.
        listing: The text of the callee.
        scope: Line of the callee's name (0: none). It separates its labels from those of others.
        caller: The text of the call.
        at: The place of the call.
        return_line: The line of the caller to continue at.
        rounds: Number of executions from this one on.
        is_repeated: Whether the call asked for more than one execution.
        since: Number of executed lines when the call was made.
        counts: Rounds left, by repeat loop.
        ends_with_file: Whether the end of the file returns to the caller.
    """

    kind: Literal["main", "sub", "program", "macro"]
    name: str
    listing: Listing
    scope: int
    caller: Listing
    at: Place
    return_line: int
    rounds: int = 1
    since: int = 0
    counts: dict[object, int] = field(default_factory=dict)
    ends_with_file: bool = False
    is_repeated: bool = field(init=False)

    def __post_init__(self) -> None:
        self.is_repeated = self.rounds > 1

    @property
    def first(self) -> int:
        """First line of the body."""
        return self.scope + 1


class Flow:
    """The flow of control.

    Attributes:
        interpreter: Executes statements.
        parameters: The parameters of the program.
        library: The files of subroutines.
        limits: The limits of repetition.
        main: The text of the main program.
        listing: The text that is being executed.
        frame: The current call.
        frames: The calls around the current one, outermost first.
        executed: Number of lines executed so far, up to date whenever a step runs.
        new: Number of lines executed for the first time.
        update_loops: Brings the entries of loops up to date before they are compared.
        value: Value of the last return, None if it had none.
        percent: Whether a ``%`` was read.
        main_border: Line of the O number of the main program; 0 for none.
        modal: Calls the macro of G66 after a line; None if there is none.
        missing: Names of programs that a check has skipped.
        entered: Lines of the O numbers of the programs in the main text that were called.
        program_frame: SINUMERIK's programmable frame.
        sections: Repeated sections that are being executed, outermost first.
        has_modal: Whether a G66 was executed, so that each line may be followed by a call.
    """

    def __init__(
        self,
        interpreter: Interpreter,
        listing: Listing,
        library: Files,
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
        self.frame = Frame("main", "", listing, 0, listing, Place(0), 0)
        self.frames: list[Frame] = []
        self.executed = self.new = 0
        self.update_loops: Callable[[], None] = lambda: None
        self.value: float | None = None
        self.percent = False
        self.main_border = 0
        self.modal: Callable[[int], int] | None = None
        self.missing: set[str] = set()
        self.entered: set[int] = set()
        self.program_frame = ProgramFrame()
        self.sections: list[Section] = []
        self.has_modal = False
        self._modal_depth = 0
        self._states: dict[type[Any], Any] = {}
        self.parameters.bind("_value", lambda: 0.0 if self.value is None else self.value)
        self.parameters.bind("_value_returned", lambda: 0.0 if self.value is None else 1.0)
        self._set_listing(listing)

    def enter(self, frame: Frame, arguments: Sequence[float] | None = None) -> int:
        """Enter a call.

        Args:
            frame: The call.
            arguments: Values of the first local parameters; None for a call without parameters of
                its own.

        Returns:
            The line to continue at.

        Raises:
            CncError: ``call-too-deep``.
        """
        if len(self.frames) >= self.limits.depth:
            hint = (
                "give the call a condition that ends it, "
                "or raise program.max_call_depth in the machine file"
            )
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
            # M98 in RS274/NGC has its own names, but the caller's numbers. FANUC's has no names,
            # and shares its numbers too.
            numbers = parameters.locals
            parameters.push(())
            parameters.locals = numbers
        self.interpreter.entered()
        self._set_listing(frame.listing)
        return frame.first

    def state(self, kind: type[State]) -> State | None:
        """Return the state of a language, by its class; None before it is kept."""
        return self._states.get(kind)

    def keep(self, state: object) -> None:
        """Keep the state of a language, one of each class."""
        self._states[type(state)] = state

    def forget(self, kind: type[Any]) -> None:
        """End a state."""
        del self._states[kind]

    def begin_modal(self, call: Callable[[int], int]) -> None:
        """Begin to call a macro after each move of this program, and not of those it calls."""
        self.modal, self._modal_depth = call, len(self.frames)
        if not self.has_modal:
            self.has_modal = True
            for listing in {self.main, self.listing}:
                listing.forget_steps()

    def call_after(self, line: int) -> int:
        """Make the modal call after the move of a line; return the line to continue at."""
        if self.modal is None or len(self.frames) != self._modal_depth:
            return line + 1
        return self.modal(line)

    def enter_again(self, frame: Frame) -> None:
        """Enter a subroutine of this text that compiled code has entered already."""
        self.frames.append(self.frame)
        self.frame = frame
        frame.since = self.executed
        self.parameters.push(())
        self.interpreter.entered()

    @property
    def marks_calls(self) -> bool:
        """Whether a call made here is marked among the blocks."""
        return self._mark_calls and not self.frames

    def finish(self) -> int:
        """End an execution of a call; return the line to continue at: its first for the next."""
        frame = self.frame
        if frame.rounds > 1:
            frame.rounds -= 1
            frame.counts.clear()
            return frame.first
        return self.leave()

    def leave(self) -> int:
        """Return to the caller; return the line to continue at."""
        left = self._pop()
        self.interpreter.left()
        self._mark(left, inside=False)
        self._set_listing(left.caller)
        return left.return_line

    def unwind(self) -> None:
        """Restore the parameters of the main program when the program ends inside a call."""
        while self.frames:
            self._pop()

    def endless(self, line: int, *, is_certain: bool) -> CncError:
        """Return the error for an endless program, at the loop or call that caused it.

        Args:
            line: The next line.
            is_certain: Whether its state came back; else too many lines were repeated.
        """
        self.update_loops()
        listing, at, name = self._cause_of_repetition(line)
        if is_certain:
            message = f"{name} does not end: no variable, position or tool changes any more"
            hint = "correct the condition that ends it, or write M30 in its place"
            return listing.fault(at, "loop-endless", message, hint)
        many = f"{self.limits.repeated_lines:,}".replace(",", " ")
        message = f"{name} does not end: more than {many} lines were executed again"
        hint = (
            "correct the condition that ends it, "
            "or raise program.max_repeated_lines in the machine file"
        )
        return listing.fault(at, "loop-endless", message, hint)

    def _cause_of_repetition(self, line: int) -> tuple[Listing, Place, str]:
        """Return the innermost loop or call that took half of the repeated lines."""
        suspects: list[tuple[int, Listing, Place, str]] = []
        listing = self.listing
        for frame in [self.frame, *reversed(self.frames)]:
            around = [loop for loop in listing.loops if loop.first <= line <= loop.last]
            around.sort(key=lambda loop: loop.last - loop.first)
            suspects += [(loop.since, listing, loop.at, loop.name) for loop in around]
            if frame.is_repeated:
                suspects.append((frame.since, frame.caller, frame.at, f"the call of {frame.name}"))
            line, listing = frame.at.line, frame.caller
        if not suspects:  # calls that branch again and again
            outermost = [*self.frames, self.frame][min(1, len(self.frames))]
            return outermost.caller, outermost.at, f"the call of {outermost.name}"
        enough = self.executed - (self.executed - self.new) // 2
        return next(
            (suspect for suspect in suspects if suspect[0] <= enough),
            min(suspects, key=lambda suspect: suspect[0]),
        )[1:]

    def _mark(self, frame: Frame, *, inside: bool) -> None:
        """Put a mark among the blocks where the main program calls or is returned to."""
        if self._mark_calls and not self.frames:
            self.interpreter.out.put(CallBoundary(self.main.name, frame.at.line, inside))

    def _pop(self) -> Frame:
        left = self.frame
        self.frame = self.frames.pop()
        if left.kind != "program" or not self.parameters.macro:
            self.parameters.pop()
        return left

    def _set_listing(self, listing: Listing) -> None:
        """Continue in a listing; errors and blocks then name its file."""
        interpreter = self.interpreter
        if interpreter.here.file != listing.name:
            interpreter.out.flush()
        self.listing = listing
        here = interpreter.here
        here.file, here.text_of, here.words_of = listing.name, listing.source, listing.words
