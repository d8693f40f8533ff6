"""Conversion of a program: written, read back, compared, and written anew where it differs."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import IO, Any

import numpy as np

from cnc.convert.curves import FitTo
from cnc.convert.proof import (
    Differs,
    distance,
    made_up_offsets,
    made_up_start,
    with_other_systems,
)
from cnc.convert.target import Target, without_comments
from cnc.convert.turning import SYSTEM, TARGETS
from cnc.convert.writer import Notes, Writer
from cnc.gcode import dialects
from cnc.gcode.core.line_trace import LineTrace
from cnc.gcode.reader.parser import Syntax
from cnc.gcode.reader.source_text import LineIndex, Text
from cnc.machine.models import Machine
from cnc.model.choices import Curves, DialectName, TargetName
from cnc.model.diagnostics import CncError, Diagnostic, GcodeError, UsageError, shown_name
from cnc.session.options import RunOptions
from cnc.session.program_reader import (
    ProgramReader,
    SavedState,
    Source,
    display_name,
    readable_file,
    with_source_lines,
)
from cnc.session.required_capabilities import reading_policy

_FLOW = re.compile(rb"#|\[|M *9[789]|G *6[567]|^[ \t]*o", re.IGNORECASE | re.MULTILINE)
"""Words of loops, branches, calls and parameters."""
MOST_TRIALS = 40
"""Trials after which a program is refused."""
READ_BYTES = 1 << 20
"""Bytes that are read at once to count the lines of a result."""
OPTIONS = RunOptions(tool_lengths="zero")


@dataclass(frozen=True)
class Converted:
    """A program of another control.

    Attributes:
        text: The program; empty if it was written into a file.
        source: Dialect of the program that was read.
        target: Dialect that it is written in.
        lines: Number of its lines.
        distance: Largest distance of moves from those of the program, mm.
        of_curves: Largest distance of curves written within the tolerance, mm.
        notes: What was kept, expanded, assumed.
    """

    text: bytes
    source: str
    target: str
    lines: int
    distance: float
    of_curves: float
    notes: Notes

    def as_json(self) -> dict[str, Any]:
        """Return the report for other programs."""
        return {
            "source": self.source,
            "target": self.target,
            "lines": self.lines,
            "kept": self.notes.kept,
            "expanded": self.notes.expanded,
            "distance_mm": self.distance,
            "curve_distance_mm": self.of_curves,
            "remarks": [
                {"kind": kind, "text": text, "lines": lines}
                for (kind, text), lines in self.notes.remarks.items()
            ],
        }

    def summary(self) -> Iterator[str]:
        """Yield the report as lines of text."""
        notes = self.notes
        yield f"{self.source} -> {self.target}: {notes.kept} lines kept, {notes.expanded} expanded"
        for (kind, text), lines in notes.remarks.items():
            shown = ", ".join(map(str, lines[:3])) + (", ..." if len(lines) > 3 else "")
            yield f"{kind}: {text} (line{'s' if len(lines) > 1 else ''} {shown})"
        yield f"read back: at most {1000.0 * self.distance:.3g} um from the program"
        if self.of_curves:
            yield f"curves: at most {1000.0 * self.of_curves:.3g} um from the program"


def convert(
    program: Source,
    machine: Machine,
    dialect: DialectName | None,
    to: TargetName,
    *,
    tolerance: float = 0.01,
    curves: Curves = "lines",
    into: IO[bytes] | None = None,
) -> Converted:
    """Return a program of another control, proved to move the machine alike.

    With ``into`` the memory does not grow with a program whose short moves stay lines.

    Args:
        program: The file, ``-`` for standard input, or its text.
        machine: The machine that both programs are for.
        dialect: How to read it; None for the machine file's choice.
        to: The control to write it for.
        tolerance: Largest distance of curves that are written anew, mm.
        curves: How short moves are written.
        into: Receives the program; None for the text of the result.

    Raises:
        UsageError: The file cannot be read.
        CncError: A fault of the program; ``convert-cannot`` for what the control does not have;
            ``convert-differs`` if no text of the same motion was found.
    """
    if machine.kind == "lathe" and to not in TARGETS:
        hint = f"convert it to {', '.join(TARGETS)}"
        message = f"programs of lathes are not converted to {to}"
        raise UsageError(Diagnostic("convert-lathe", message, hint=hint))
    if machine.kind == "lathe" and curves != "lines":
        message = "short moves in programs of lathes stay lines"
        raise UsageError(Diagnostic("convert-lathe", message, hint="leave out --curves"))
    name = display_name(program)
    with readable_file(program) as path, tempfile.NamedTemporaryFile(suffix=".nc") as file:
        conversion = _Conversion(
            name, path, machine, dialect, to, FitTo(tolerance, curves), Path(file.name)
        )
        try:
            converted = conversion.run()
        except CncError as error:
            raise with_source_lines([error], {name: path})[0] from None
        if into is None:
            return replace(converted, text=Path(file.name).read_bytes())
        shutil.copyfileobj(file, into)
        return converted


def _with_system(machine: Machine) -> Machine:
    """Return a lathe with the G-code system and the diameters that results are written for."""
    program = machine.program.model_copy(
        update={"g_code_system": SYSTEM, "least_increments": False}
    )
    return machine.model_copy(update={"program": program, "diameters": None})


class _Conversion:
    """The trials of one conversion."""

    def __init__(
        self,
        name: str,
        path: Path,
        machine: Machine,
        dialect: DialectName | None,
        to: TargetName,
        fit: FitTo,
        result: Path,
    ) -> None:
        self._name, self._path, self._machine, self._fit = name, path, machine, fit
        self._result_path = result
        self._dialect: DialectName = dialect or machine.program.dialect
        self._known: ProgramReader | None = None
        self._known = self._reader(path, self._dialect, 0, {})
        source = self._known.rules()
        is_lathe = machine.kind == "lathe"
        self._of_result = _with_system(machine) if is_lathe else machine
        rules = dialects.load(to, lathe=SYSTEM if is_lathe else None)
        self._target = Target(rules, source, is_lathe=is_lathe)
        self._to = to
        if fit.curves == "nurbs" and not self._target.spline:
            message = f"{to} has no NURBS"
            hint = "write arcs (--curves arcs); linuxcnc, fanuc and siemens have NURBS"
            raise UsageError(Diagnostic("convert-no-nurbs", message, hint=hint))

    def _reader(
        self, path: Path, dialect: DialectName, version: int, offsets: dict[int, float]
    ) -> ProgramReader:
        machine = self._of_result if path == self._result_path else self._machine
        saved = SavedState(machine)
        saved.adopt(offsets)
        reader = ProgramReader(
            self._name,
            path,
            machine,
            dialect,
            made_up_start(len(machine.axis_names), version),
            saved,
            lambda _: None,
            reading_policy(OPTIONS, machine, None),
        )
        if self._known is not None and path == self._path:
            reader.recognition, reader.evidence = self._known.recognition, self._known.evidence
        return reader

    def _take_warning(self, warning: Diagnostic) -> None:
        """Refuse a lathe's nose compensation with a radius of 0: the result would be without it."""
        if warning.code == "compensation-radius-zero" and self._target.is_lathe:
            message = "the radius of the nose is 0: the program would lose its compensation"
            hint = "enter the tools in a tool table (tool_table under [program])"
            raise GcodeError(replace(warning, code="convert-cannot", message=message, hint=hint))

    def run(self) -> Converted:
        """Write and prove until both programs are the same."""
        if self._target.same_flow and (whole := self._as_it_stands()) is not None:
            return whole
        for _ in range(MOST_TRIALS):
            writer = self._written()
            try:
                kept, of_curves = self._proved(writer)
            except Differs as difference:
                self._take_back(difference.line, difference.source, difference.what)
                continue
            except GcodeError as error:
                self._take_back(error.diagnostic.line, 0, error.diagnostic.message)
                continue
            if of_curves > self._fit.tolerance:
                raise self._differs(0, f"curves are {of_curves:.4g} mm apart")
            self._note_others(writer)
            return self._result(kept, of_curves, writer.notes)
        raise self._differs(0, "no text was found that moves the machine alike")

    def _written(self, sought: int = 0) -> Writer:
        """Write the result; return the writer, which has found a line of the result."""
        reader = self._reader(self._path, self._dialect, 0, made_up_offsets(0))
        names = self._machine.axis_names
        with self._result_path.open("wb") as file:
            writer = Writer(self._target, names, reader.start, self._fit, file, sought)
            writer.take(reader.traced_blocks(LineTrace(writer.bulk), self._take_warning))
        return writer

    def _as_it_stands(self) -> Converted | None:
        """Return a program with loops and calls line by line, if all lines mean the same.

        None for a program without them, or if the control would do something else.
        """
        text = Text.of_file(self._path, self._name)
        if not any(text.first_lines_with(_FLOW)):
            return None
        source, notes = self._target.source, Notes()
        syntax = Syntax(source.flavour, lenient=source.lenient, dialect=source.name)
        listing = LineIndex(text, syntax)
        line = 1
        with self._result_path.open("wb") as file:
            while (window := listing.window(line)) is not None:
                for index in range(window.count):
                    try:
                        statement = listing.statement(window, index)
                    except CncError:
                        return None
                    if statement is None or not self._target.can_keep_flow(statement):
                        return None
                file.write(self._target.spelled(window.data))
                line += window.count
            notes.kept = line - 1
            notes.add("kept", "loops, branches, calls and computed words as they stand", 1)
            names = self._machine.axis_names
            writer = Writer(self._target, names, np.zeros(0), self._fit, file)
        try:
            apart, _ = self._proved(writer)
        except (Differs, GcodeError):
            return None
        return self._result(apart, 0.0, notes)

    def _result(self, apart: float, of_curves: float, notes: Notes) -> Converted:
        with self._result_path.open("rb") as file:
            lines = sum(part.count(b"\n") for part in iter(lambda: file.read(READ_BYTES), b""))
        return Converted(b"", self._target.source.name, self._to, lines, apart, of_curves, notes)

    def _note_others(self, writer: Writer) -> None:
        """Note the lines with code that were not executed, and so are left out."""
        after = 0
        lines = Text.of_file(self._path, self._name)
        gaps = []
        for first, last in sorted(writer.executed):
            if first > after + 1:
                gaps.append(range(after + 1, first))
            after = max(after, last)
        while (window := lines.window(after + 1)) is not None:
            end = window.first + window.count
            gaps.append(range(after + 1, end))
            after = end - 1
        for line in chain.from_iterable(gaps):
            found = lines.window(line)
            text = "" if found is None else without_comments(found.text(line - found.first))
            if text.strip(" \t%\0\x1a"):
                writer.notes.add("left out", "lines that are never executed", line)

    def _proved(self, writer: Writer) -> tuple[float, float]:
        """Return the largest distances of moves and curves; raise if both programs differ."""
        offsets = made_up_offsets(1)
        others = with_other_systems(offsets, writer.systems, self._target.source.systems)
        program = self._reader(self._path, self._dialect, 1, offsets)
        result = self._reader(self._result_path, self._to, 1, others)
        return distance(
            program.blocks(),
            result.blocks(),
            program.start,
            self._machine.axis_names,
            writer.regions,
            self._target,
        )

    def _take_back(self, line: int, source: int, what: str) -> None:
        """Let the lines around one of the result be written anew in the next trial.

        Raises:
            CncError: ``convert-differs`` if they were.
        """
        # The writer keeps no list of its lines: it writes them once more up to this one.
        writer = self._written(line)
        written, before = writer.at_sought, writer.kept_before
        target = self._target
        if written is None or written.form is None or line == 0:
            if before is not None and before.form and before.form not in target.refused and line:
                target.refused.add(before.form)
                return
            if target.takes_runs:
                target.takes_runs = False
                return
            raise self._differs(source or (0 if written is None else written.line), what)
        if written.form == ():
            if not target.takes_runs:
                raise self._differs(written.line, what)
            target.takes_runs = False
        elif written.is_open and target.compensates:
            target.compensates = False
        elif written.form in target.refused:
            raise self._differs(written.line, what)
        else:
            target.refused.add(written.form)

    def _differs(self, line: int, what: str) -> CncError:
        message = f"{shown_name(self._name)} is not written for {self._to}: {what}"
        hint = "give positions and levels from the work zero (G90) before this line"
        return CncError(Diagnostic("convert-differs", message, self._name, line, hint=hint))
