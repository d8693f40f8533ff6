"""The work of ``format``, ``convert``, ``diff``, ``tools`` and ``check --fix``.

It is imported when it is carried out.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import IO, TextIO

from cnc.checks.tool_list import ToolList
from cnc.cli.checking import end, find_programs
from cnc.cli.options import CheckOptions, CommonOptions, ConvertOptions, FixOptions
from cnc.cli.progress import ProgressDisplay
from cnc.cli.projects import options_of
from cnc.compare.programs import compare
from cnc.convert.programs import convert
from cnc.gcode.reader.source_text import Text
from cnc.model.choices import DialectName, TextStyle
from cnc.model.diagnostics import EXIT_REJECTED, Diagnostic, UsageError, printable, shown_name
from cnc.model.operator_control import Control
from cnc.report.summary import write_object
from cnc.report.targets import BytesTarget, TextTarget
from cnc.session.program_reader import display_name, readable_file
from cnc.session.repairs import Applied, repaired
from cnc.session.rewriting import in_form


def format_programs(
    names: Sequence[str],
    machine_file: str | None,
    dialect: DialectName | None,
    style: TextStyle | None,
    *,
    check: bool,
    in_place: bool,
    quiet: bool,
) -> int:
    """Write programs in one form, or check that they have it; return the exit code.

    Raises:
        UsageError: the programs cannot be read, or the options do not fit together.
        GcodeError: a program has a fault. It is left as it is, and so are those behind it.
    """
    files = find_programs(names)
    if check and in_place:
        message, hint = "--check writes nothing, --in-place writes", "give one of them"
        raise UsageError(Diagnostic("usage", message, hint=hint))
    if len(files) > 1 and not (check or in_place):
        message = f"{len(files)} programs cannot be written to standard output"
        hint = "--in-place writes each to its file, --check names those that would change"
        raise UsageError(Diagnostic("one-program-only", message, hint=hint))
    if in_place and "-" in files:
        message = "standard input cannot be written in place"
        raise UsageError(Diagnostic("usage", message, hint="leave out --in-place"))
    given = CommonOptions(machine=machine_file, dialect=dialect)
    changed = 0
    for file in files:
        chosen = options_of(file, given)
        machine = chosen.machine
        form = style or chosen.style
        with in_form(file, machine, chosen.common.dialect, form) as result:
            changed += result.changed
            if not (check or in_place):
                _write("-", result.file)
            elif result.changed and in_place:
                _write(file, result.file)
            if result.changed and (check or in_place) and not quiet:
                print(f"{'has another form' if check else 'written'}  {shown_name(file)}")
    return EXIT_REJECTED if check and changed else 0


def convert_program(
    program: str,
    file: str,
    options: ConvertOptions,
    machine: str | None,
    dialect: DialectName | None,
    json: str | None,
    *,
    quiet: bool,
) -> int:
    """Write a program for another control, and its report; return the exit code.

    Args:
        program: The program.
        file: The file to write; ``-`` for standard output.
        options: The control, and how curves are written.
        machine: The machine file.
        dialect: How to read the program.
        json: File of the report; None for none.
        quiet: Whether the report is not printed.

    Raises:
        UsageError: A file cannot be read or written.
        CncError: As :func:`cnc.convert.programs.convert`.
    """
    chosen = options_of(program, CommonOptions(machine=machine, dialect=dialect))
    with tempfile.TemporaryFile() as text:
        result = convert(
            program,
            chosen.machine,
            chosen.common.dialect,
            options.to,
            tolerance=options.tolerance,
            curves=options.curves,
            into=text,
        )
        text.seek(0)
        _write(file, text)
    if json is not None:
        write_object(json, result.as_json())
    if not quiet:
        print(*map(printable, result.summary()), sep="\n", file=sys.stderr)
    return 0


def repair_programs(
    names: Sequence[str],
    common: CommonOptions,
    options: CheckOptions,
    fixes: FixOptions,
    stream: TextIO,
) -> int:
    """Repair programs, and print each repair with its lines; return the exit code of ``--diff``.

    Args:
        names: Programs, folders and patterns.
        common: Options of the check.
        options: Further ones.
        fixes: Which repairs are made, and whether they are only shown.
        stream: Where they are printed.

    Raises:
        UsageError: A program cannot be read or written, or is standard input.
    """
    files = find_programs(names)
    if "-" in files:
        message, hint = "standard input cannot be repaired in its place", "name a file"
        raise UsageError(Diagnostic("usage", message, hint=hint))
    count = 0
    for file in files:
        chosen = options_of(file, common, options)
        with readable_file(file) as path:
            text = path.read_bytes()
        run_options = chosen.check.run_options(chosen.common)
        result = repaired(file, text, chosen.machine, run_options, unsafe=fixes.unsafe_fixes)
        count += len(result.applied)
        if not common.terminal.quiet:
            for repair in result.applied:
                print(*_shown(repair), sep="\n", file=stream)
        if result.new != result.text and not fixes.diff:
            _write(file, BytesIO(result.new))
    if not common.terminal.quiet and count:
        what = "repair" if count == 1 else "repairs"
        print(f"{count} {what} {'to make' if fixes.diff else 'made'}", file=stream)
    return EXIT_REJECTED if count else 0


def _shown(repair: Applied) -> Iterator[str]:
    """Yield a repair as text: its finding, and each line before and behind it."""
    finding = repair.finding
    assert finding.fix is not None
    yield f"{finding.location()}: {finding.code}: {printable(finding.fix.title)}"
    for line in repair.lines:
        yield f"  - {printable(line.old)}"
        yield from (f"  + {printable(text)}" for text in line.new.split("\n"))


def _write(name: str, text: IO[bytes]) -> None:
    """Write a text to a file, which is replaced as a whole, or to standard output."""
    if name == "-":
        sys.stdout.flush()
        shutil.copyfileobj(text, sys.stdout.buffer)
        sys.stdout.buffer.flush()
        return
    path = Path(name)
    mode = path.stat().st_mode if path.is_file() else None
    target = BytesTarget(name)
    try:
        while part := text.read(1 << 20):
            target.write(part)
        target.close()
        if mode is not None:
            path.chmod(mode)
    finally:
        target.discard()


def compare_programs(
    names: tuple[str, str],
    machine: str | None,
    dialect: DialectName | None,
    json: str | None,
    *,
    quiet: bool,
) -> int:
    """Compare two programs; write and print the result; return the exit code.

    Raises:
        UsageError: ``usage`` where their project files name different machines.
    """
    common = CommonOptions(machine=machine, dialect=dialect)
    first, second = (options_of(name, common) for name in names)
    if first.machine.file != second.machine.file:
        message = f"the programs belong to two machines: {first.machine.file} and "
        message += str(second.machine.file)
        hint = "name the machine to compare them on with --machine"
        raise UsageError(Diagnostic("usage", message, hint=hint))
    with ProgressDisplay(Control(), quiet=quiet) as display:
        comparison = compare(
            *names,
            (first.machine, second.machine),
            (first.common.run_options(), second.common.run_options()),
            display.callbacks(),
        )
    if all(report.ok and report.stopped_at_line is None for report in comparison.reports):
        if json is not None:
            write_object(json, comparison.as_json())
        if not quiet:
            print(*comparison.lines(), sep="\n", file=sys.stderr if json == "-" else sys.stdout)
    return end(comparison.reports, quiet=quiet)


def write_tool_table(program: str, file: str | None) -> None:
    """Write the skeleton of a program's tool table to a file; None prints it.

    Raises:
        UsageError: ``no-tools``, or the program cannot be read, or the file not written.
    """
    with readable_file(program) as path:
        name = display_name(program)
        tools = ToolList.of(Text.of_file(path, name).all_lines())
    if not tools.tools:
        message, hint = "the program has no T word", "a program without tools needs no table"
        raise UsageError(Diagnostic("no-tools", message, name, hint=hint))
    text = "".join(line + "\n" for line in tools.skeleton(name))
    if file is None:
        print(text, end="")
        return
    target = TextTarget(file)
    try:
        target.write(text)
        target.close()
    finally:
        target.discard()
