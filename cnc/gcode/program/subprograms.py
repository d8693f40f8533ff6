"""Subroutines of O-words, sub and call and return, and the files that they may stand in. Source:
LinuxCNC, "O codes".
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from cnc.gcode.program.call_stack import Flow, Frame
from cnc.gcode.program.control_flow import shown
from cnc.gcode.program.listing import Listing, Mark, Step
from cnc.gcode.syntax.parameters import LOCAL, Parameters
from cnc.gcode.syntax.parser import Syntax
from cnc.gcode.syntax.source_text import Text
from cnc.gcode.syntax.statement import Control, Value
from cnc.gcode.syntax.words import fault
from cnc.model.diagnostics import CncError, UsageError

MAX_LABEL = 999_999_999
"""Highest label that a call may compute."""

_FILE_NAME = re.compile(r"[a-z0-9_-]+")
_SUFFIXES = (".ngc", ".nc")


class Library:
    """Files of subroutines: found by name in given folders, read once."""

    def __init__(self, folders: Sequence[Path], syntax: Syntax, *, block_delete: bool) -> None:
        self.folders = folders
        self._syntax = syntax
        self._block_delete = block_delete
        self._listings: dict[Path, Listing] = {}

    def find(self, label: str, at: Mark) -> Listing | None:
        """The file of a name (``<name>``) or a number. Raises GcodeError for a name that would lead
        out of the folders.
        """
        name = label.strip("<>")
        if not _FILE_NAME.fullmatch(name):
            if any(part in name for part in ("/", "\\", "..")):
                raise _outside(f"o<{name}>: a subroutine's name is no path", at)
            return None
        for folder in self.folders:
            for file in _file_names(name):
                if os.path.isfile(
                    folder / file
                ):  # False, too, for a folder that can't be read and a name too long for a file
                    return self._listing(folder, file, at)
        return None

    def _listing(self, folder: Path, file: str, at: Mark) -> Listing:
        path = folder / file
        real = path.resolve()
        if not real.is_relative_to(folder.resolve()):
            raise _outside(f"{path} leads to a file outside of its folder", at)
        if real not in self._listings:
            try:
                text = Text.of_file(real, os.fspath(path))
            except UsageError as error:
                found = error.diagnostic
                raise fault(found.code, found.message, column=at.column, length=at.length) from None
            self._listings[real] = Listing(text, self._syntax, block_delete=self._block_delete)
        return self._listings[real]


def _file_names(name: str) -> list[str]:
    stems = [name]
    if name.isdigit():
        stems += [f"o{name}", f"o{name:0>4}"] if len(name) < 4 else [f"o{name}"]
    return [stem + suffix for stem in stems for suffix in _SUFFIXES]


def _outside(message: str, at: Mark) -> CncError:
    hint = "subroutines are found in the program's folder and in configured folders only"
    return fault("sub-file-outside", message, column=at.column, length=at.length, hint=hint)


class Definition:
    """A subroutine as it is reached in the program: it is passed by. ``end`` is the line of its
    endsub.
    """

    __slots__ = ("end", "label", "line", "listing", "name")

    def __init__(self, listing: Listing, line: int, control: Control) -> None:
        """Read its control lines up to its end."""
        if not isinstance(control.label, str):
            hint = "only a call may compute its label"
            raise listing.wrong(
                line, control, "label-computed", "the label of sub must be written as it is", hint
            )
        self.listing, self.line, self.label = listing, line, control.label
        self.name = f"o{self.label}"
        self.end = self._end(control)

    def _end(self, control: Control) -> int:
        for line, other in self.listing.control_lines(self.line + 1):
            match other.keyword:
                case "sub":
                    hint = "a subroutine can't be defined inside another"
                    message = f"{shown(other)} inside {self.name} sub of line {self.line}"
                    raise self.listing.wrong(line, other, "sub-nested", message, hint)
                case "endsub":
                    if other.label == self.label:
                        return line
                    message = f"{shown(other)} inside {self.name} sub of line {self.line}"
                    raise self.listing.wrong(
                        line, other, "sub-not-open", message, f"write {self.name} endsub"
                    )
                case "program":
                    break
        message = f"{self.name} sub is not closed"
        raise self.listing.wrong(
            self.line, control, "sub-not-closed", message, f"{self.name} endsub is missing"
        )

    def run(self, flow: Flow, line: int) -> int:
        """Pass it by."""
        return self.end + 1


def definition_at(listing: Listing, line: int, control: Control) -> Definition:
    """The subroutine that begins at a line. Refuses a second one of its name in the same file."""
    definition = Definition(listing, line, control)
    other = listing.subs.setdefault(definition.label, definition)
    if other is not definition:
        message = f"{definition.name} is defined in line {other.line} already"
        raise listing.wrong(line, control, "sub-repeated", message, "take another label")
    listing.steps[line] = definition
    return definition


def sub_at(flow: Flow, line: int, control: Control) -> Step:
    """The step of ``o1 sub``."""
    return definition_at(flow.listing, line, control)


class Call:
    """``o1 call [..] [..]``."""

    __slots__ = ("at", "control", "definition", "label")

    def __init__(self, line: int, control: Control) -> None:
        self.at = Mark(line, control.column, control.length)
        self.control, self.label = control, control.label
        self.definition: Definition | None = None
        if len(control.values) > LOCAL:
            message = f"{len(control.values)} arguments: a call takes {LOCAL} at most"
            raise fault("call-arguments", message, column=control.column, length=control.length)

    def run(self, flow: Flow, line: int) -> int:
        """Into the subroutine. Its arguments are computed first."""
        parameters = flow.parameters
        arguments = [value(parameters) for value in self.control.values]
        definition = self.definition
        if definition is None:
            label = self.label
            if isinstance(label, str):
                definition = self.definition = self._look_up(flow, label)
            else:
                definition = self._look_up(flow, self._number(label, parameters))
        flow.value = None
        listing = definition.listing
        frame = Frame(
            "sub",
            definition.name,
            listing,
            definition.line + 1,
            definition.line,
            flow.listing,
            self.at,
            line + 1,
        )
        return flow.enter(frame, arguments)

    def _number(self, label: Value, parameters: Parameters) -> str:
        number = label(parameters)
        if not 0 <= number <= MAX_LABEL or number != int(number):
            raise self._fault(
                "label-bad",
                f"o[..] comes to {number:g}, which is no label",
                "labels are whole numbers from 0",
            )
        return str(int(number))

    def _look_up(self, flow: Flow, label: str) -> Definition:
        """In this file or the main program, where what was passed already comes first, or in a file
        of its own.
        """
        here = (flow.listing, flow.main)
        for listing in here:
            if found := listing.subs.get(label):
                return found
        for listing in here:
            if found := self._in(listing, label):
                return found
        file = flow.library.find(label, self.at)
        if file is not None:
            if found := self._in(file, label):
                return found
            raise self._fault(
                "sub-file-empty",
                f"{file.name} has no o{label} sub",
                "the subroutine's label is the file's name",
            )
        if label.isdigit() and any(int(label) in listing.places().programs for listing in here):
            raise self._fault(
                "call-style-mixed",
                f"O{label} is a program, not a sub",
                f"call it with M98 P{label}",
            )
        near = difflib.get_close_matches(
            label, {*flow.listing.places().subs, *flow.main.places().subs}, 1
        )
        file_name = _file_names(label.strip("<>"))[0]
        hint = (
            f"did you mean o{near[0]}?"
            if near
            else f"o{label} sub is not in this file, and {file_name} in no folder of subroutines"
        )
        raise self._fault("sub-unknown", f"there is no subroutine o{label}", hint)

    def _in(self, listing: Listing, label: str) -> Definition | None:
        if found := listing.subs.get(label):  # of a file: another call was here before
            return found
        places = listing.places()
        line = places.subs.get(label)
        if line is None:
            return None
        definition = definition_at(listing, line, listing.control(line))
        if again := places.subs_again.get(label):
            definition_at(listing, again, listing.control(again))
        return definition

    def _fault(self, code: str, message: str, hint: str) -> CncError:
        return fault(code, message, column=self.at.column, length=self.at.length, hint=hint)


def call_at(flow: Flow, line: int, control: Control) -> Step:
    """The step of ``o1 call``."""
    return Call(line, control)


class Return:
    """``o1 return [..]`` and ``o1 endsub [..]``; a return leaves the subroutine that it stands in,
    whatever its label (LinuxCNC's way).
    """

    __slots__ = ("control",)

    def __init__(self, control: Control) -> None:
        self.control = control

    def run(self, flow: Flow, line: int) -> int:
        """Back to the caller."""
        frame, control = flow.frame, self.control
        label = control.label if isinstance(control.label, str) else "[..]"
        if frame.kind != "sub":
            raise fault(
                "sub-not-open",
                f"{shown(control)} outside of a subroutine",
                column=control.column,
                length=control.length,
            )
        if control.keyword == "endsub" and frame.name != f"o{label}":
            message = f"{shown(control)} in subroutine {frame.name} of line {frame.scope}"
            hint = f"write {frame.name} {control.keyword}"
            raise fault(
                "sub-not-open", message, column=control.column, length=control.length, hint=hint
            )
        value = control.values[0](flow.parameters) if control.values else None
        flow.value = value
        return flow.leave()


def return_at(flow: Flow, line: int, control: Control) -> Step:
    """The step of ``o1 return`` and ``o1 endsub``."""
    return Return(control)


MAKERS: dict[str, Callable[[Flow, int, Control], Step]] = {
    "sub": sub_at,
    "endsub": return_at,
    "return": return_at,
    "call": call_at,
}
"""What makes the step of a control line, by its keyword."""
