"""The work of ``cncrun format``; the command imports it when it is carried out."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from cnc.cli.checking import find_programs
from cnc.cli.options import CommonOptions
from cnc.cli.projects import options_of
from cnc.model.choices import DialectName, TextStyle
from cnc.model.diagnostics import EXIT_REJECTED, Diagnostic, UsageError, shown_name
from cnc.report.targets import BytesTarget
from cnc.session.rewriting import Result, in_form


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
                _write("-", result)
            elif result.changed and in_place:
                _write(file, result)
            if result.changed and (check or in_place) and not quiet:
                print(f"{'has another form' if check else 'written'}  {shown_name(file)}")
    return EXIT_REJECTED if check and changed else 0


def _write(name: str, result: Result) -> None:
    """Write the text to a file, which is replaced as a whole, or to standard output."""
    if name == "-":
        sys.stdout.flush()
        shutil.copyfileobj(result.file, sys.stdout.buffer)
        sys.stdout.buffer.flush()
        return
    mode = Path(name).stat().st_mode
    target = BytesTarget(name)
    try:
        while part := result.file.read(1 << 20):
            target.write(part)
        target.close()
        Path(name).chmod(mode)
    finally:
        target.discard()
