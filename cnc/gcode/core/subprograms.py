"""Subroutines of O-words: sub, call, return, endsub, and files of subroutines.

Source: LinuxCNC, "O codes".
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cnc.gcode.core.call_stack import ControlStep, Flow, Frame, Listing, Maker, Step, Subroutine
from cnc.gcode.core.control_flow import ControlLine, shown
from cnc.gcode.kernels.rules import JUMP
from cnc.gcode.reader.parameters import LOCAL, Parameters, Variables
from cnc.gcode.reader.parser import Syntax
from cnc.gcode.reader.source_text import Place, Text
from cnc.gcode.reader.statements import Control, Value
from cnc.gcode.reader.words import Word, fault
from cnc.model.diagnostics import CncError, UsageError

MAX_LABEL = 999_999_999
"""Highest label that a call may compute."""

_FILE_NAME = re.compile(r"[a-z0-9_-]+")
_SUFFIXES = (".ngc", ".nc", ".spf", ".mpf")


class Library:
    """Files of subroutines in given folders. Each file is read once."""

    def __init__(
        self, folders: Sequence[Path], syntax: Syntax, *, block_delete: frozenset[int] | bool
    ) -> None:
        self.folders = folders
        self._syntax = syntax
        self._block_delete = block_delete
        self._listings: dict[Path, Listing] = {}

    def find(self, label: str, at: Place) -> Listing | None:
        """Find the file of a subroutine.

        Args:
            label: A name in angle brackets, or a number.
            at: The place of the call, for errors.

        Returns:
            The text of the file, or None if there is none.

        Raises:
            GcodeError: ``sub-file-outside``, or the file cannot be read.
        """
        name = label.strip("<>")
        if not _FILE_NAME.fullmatch(name):
            if any(part in name for part in ("/", "\\", "..")):
                raise _outside(f"o<{name}>: the name of a subroutine cannot be a path", at)
            return None
        for folder in self.folders:
            for file in file_names(name):
                # False, too, for a folder that cannot be read and for a name that is too long.
                if os.path.isfile(folder / file):
                    return self._listing(folder, file, at)
        return None

    def _listing(self, folder: Path, file: str, at: Place) -> Listing:
        path = folder / file
        real = path.resolve()
        if not real.is_relative_to(folder.resolve()):
            raise _outside(f"{path} is a link to a file outside of its folder", at)
        return self.open(path, at)

    def open(self, path: Path, at: Place) -> Listing:
        """Return the text of a file.

        Args:
            path: The file.
            at: The place of the call, for errors.

        Raises:
            GcodeError: The file cannot be read.
        """
        real = path.resolve()
        if real not in self._listings:
            try:
                text = Text.of_file(real, os.fspath(path))
            except UsageError as error:
                diagnostic = error.diagnostic
                raise fault(
                    diagnostic.code, diagnostic.message, column=at.column, length=at.length
                ) from None
            syntax = self._syntax_of(text)
            self._listings[real] = Listing(text, syntax, block_delete=self._block_delete)
        return self._listings[real]

    def _syntax_of(self, text: Text) -> Syntax:
        """Return the syntax of a file; variables of SINUMERIK that it defines are its own."""
        if self._syntax.flavour != "siemens":
            return self._syntax
        own = defined_variables(text)
        names = {variable.name for variable in own}
        others = (variable for variable in self._syntax.variables if variable.name not in names)
        return replace(self._syntax, variables=(*own, *others))


def defined_variables(text: Text, parameters: Parameters | None = None) -> Variables:
    """Return the variables that a program of SINUMERIK defines.

    Args:
        text: The program.
        parameters: Those of the program, to which its arrays are bound; None for a subprogram.
    """
    from cnc.gcode.sinumerik import variables  # for its programs only

    lines = text.first_lines_with(variables.DEFINING)
    found = variables.defined_variables(lines, in_subprogram=parameters is None)
    if parameters is not None:
        variables.bind_arrays(parameters, found)
    return found


def file_names(name: str) -> list[str]:
    """Return the names of files that a subroutine may have."""
    stems = [name]
    if name.isdigit():
        stems += [f"o{name}", f"o{name:0>4}"] if len(name) < 4 else [f"o{name}"]
    names = [stem + suffix for stem in stems for suffix in _SUFFIXES]
    return [*names, *(f"{stem}.spf".upper() for stem in stems)]


def _outside(message: str, at: Place) -> CncError:
    hint = "put subroutines into the program's folder or a configured folder"
    return fault("sub-file-outside", message, column=at.column, length=at.length, hint=hint)


def define(listing: Listing, line: int, control: Control) -> Subroutine:
    """Read the subroutine that begins at a line, and add it to those of its text.

    Raises:
        CncError: Its label is computed or repeated, or it has no end.
    """
    if not isinstance(control.label, str):
        hint = "only a call may compute its label"
        message = "the label of sub must be a number or a name"
        raise listing.control_fault(line, control, "label-computed", message, hint)
    subroutine = Subroutine(listing, control.label, line, _line_of_endsub(listing, line, control))
    defined = listing.subs.setdefault(subroutine.label, subroutine)
    if defined is not subroutine:
        message = f"{subroutine.name} is defined in line {defined.first} already"
        raise listing.control_fault(line, control, "sub-repeated", message, "use another label")
    # The definition itself is passed.
    listing.steps[line] = ControlLine(line, JUMP, subroutine.last + 1)
    return subroutine


def _line_of_endsub(listing: Listing, first: int, control: Control) -> int:
    name = f"o{control.label}"
    missing = f"{name} endsub is missing"
    for line, other in listing.control_lines(first + 1):
        message = f"{shown(other)} inside {name} sub of line {first}"
        match other.keyword:
            case "sub":
                hint = "define it outside of the other subroutine"
                raise listing.control_fault(line, other, "sub-nested", message, hint)
            case "endsub":
                if other.label == control.label:
                    return line
                hint = f"write {name} endsub"
                raise listing.control_fault(line, other, "sub-not-open", message, hint)
            case "program":
                missing += f" before {shown(other)} in line {line}, which begins a program"
                break
    raise listing.control_fault(
        first, control, "sub-not-closed", f"{name} sub is not closed", missing
    )


def sub_at(flow: Flow, line: int, control: Control) -> Step:
    """Return the step of ``o1 sub``, which passes the definition."""
    define(flow.listing, line, control)
    return flow.listing.steps[line]


class Call(ControlStep):
    """``o1 call [..] [..]``."""

    __slots__ = ("subroutine",)

    def __init__(self, flow: Flow, line: int, control: Control) -> None:
        super().__init__(flow, line, control)
        self.subroutine: Subroutine | None = None
        if len(control.values) > LOCAL:
            message = f"{len(control.values)} arguments: a call takes at most {LOCAL}"
            raise fault("call-arguments", message, column=control.column, length=control.length)

    def run(self, flow: Flow, line: int) -> int:
        """Compute the arguments, then enter the subroutine."""
        parameters = flow.parameters
        arguments = [value(parameters) for value in self.control.values]
        subroutine = self.subroutine
        if subroutine is None:
            label = self.control.label
            if isinstance(label, str):
                subroutine = self.subroutine = self._look_up(flow, label)
            else:
                subroutine = self._look_up(flow, self._computed_label(label, parameters))
        flow.value = None
        listing, first = subroutine.listing, subroutine.first
        frame = Frame("sub", subroutine.name, listing, first, flow.listing, self.at, line + 1)
        return flow.enter(frame, arguments)

    def _computed_label(self, label: Value, parameters: Parameters) -> str:
        number = label(parameters)
        if not 0 <= number <= MAX_LABEL or number != int(number):
            raise self._fault(
                "label-bad",
                f"the label o[..] is {number:g}",
                f"a label is a whole number from 0 to {MAX_LABEL}",
            )
        return str(int(number))

    def _look_up(self, flow: Flow, label: str) -> Subroutine:
        """Find a subroutine in this text, in the main program, or in a file of its own."""
        texts = (flow.listing, flow.main)
        # Definitions that were passed already come first.
        for listing in texts:
            if subroutine := listing.subs.get(label):
                return subroutine
        for listing in texts:
            if subroutine := self._in(listing, label):
                return subroutine
        file = flow.library.find(label, self.at)
        if file is None:
            raise self._unknown(flow, label)
        if subroutine := self._in(file, label):
            return subroutine
        raise self._fault(
            "sub-file-empty",
            f"{file.name} has no o{label} sub",
            "the label of the subroutine must be the name of the file",
        )

    def _in(self, listing: Listing, label: str) -> Subroutine | None:
        if found := listing.subs.get(label):  # of a file that an earlier call has read
            return found
        definitions = listing.definitions()
        line = definitions.subs.get(label)
        if line is None:
            return None
        subroutine = define(listing, line, listing.control(line))
        if repeated := definitions.repeated_subs.get(label):
            define(listing, repeated, listing.control(repeated))
        return subroutine

    def _unknown(self, flow: Flow, label: str) -> CncError:
        texts = (flow.listing, flow.main)
        if label.isdigit() and any(int(label) in text.definitions().programs for text in texts):
            return self._fault(
                "call-style-mixed",
                f"O{label} is a program, not a subroutine",
                f"call it with M98 P{label}",
            )
        labels = {labels for text in texts for labels in text.definitions().subs}
        near = difflib.get_close_matches(label, labels, 1)
        file_name = file_names(label.strip("<>"))[0]
        hint = (
            f"did you mean o{near[0]}?"
            if near
            else f"there is no o{label} sub in this file, and no {file_name} in the folders"
        )
        return self._fault("sub-unknown", f"there is no subroutine o{label}", hint)

    def _fault(self, code: str, message: str, hint: str) -> CncError:
        return fault(code, message, column=self.at.column, length=self.at.length, hint=hint)


class Return(ControlStep):
    """``o1 return [..]`` and ``o1 endsub [..]``.

    A return leaves the subroutine around it, whatever its label, as in LinuxCNC.
    """

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Return to the caller."""
        frame, control = flow.frame, self.control
        label = control.label if isinstance(control.label, str) else "[..]"
        if frame.kind != "sub":
            message = f"{shown(control)} outside of a subroutine"
            raise flow.listing.fault(self.at, "sub-not-open", message)
        if control.keyword == "endsub" and frame.name != f"o{label}":
            message = f"{shown(control)} in subroutine {frame.name} of line {frame.scope}"
            hint = f"write {frame.name} {control.keyword}"
            raise flow.listing.fault(self.at, "sub-not-open", message, hint)
        flow.value = control.values[0](flow.parameters) if control.values else None
        return flow.leave()


MAKERS: dict[str, Maker] = {
    "sub": sub_at,
    "endsub": Return,
    "return": Return,
    "call": Call,
}
"""Functions that make the step of a control line, by keyword."""


# Calls of programs that are not at hand: a check continues without them, a run does not begin.


def skips_missing(flow: Flow, name: str, word: Word, line: int) -> bool:
    """Return whether the call of a missing program is skipped, and report it once a program.

    Args:
        flow: The flow of control.
        name: The name of the program, as messages call it.
        word: The place of the call.
        line: The line of the call.
    """
    interpreter = flow.interpreter
    if interpreter.policy.missing_programs == "error":
        return False
    if name not in flow.missing:
        flow.missing.add(name)
        interpreter.here.line = line
        message = (
            f"there is no program {name} here: its moves are not checked, and the lines behind "
            "the call are checked as if it did nothing"
        )
        hint = "a run needs it: put its file beside the program or name its folder"
        interpreter.here.report_warning("subprogram-missing", message, word, hint)
    return True
