"""The programs that `check` accepts, and the check of one or many."""

from __future__ import annotations

import glob
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from cyclopts import CycloptsError, UnusedCliTokensError

from cnc.cli.options import CheckOptions, CommonOptions, library
from cnc.cli.progress import ProgressDisplay, print_compiling
from cnc.model.diagnostics import (
    EXIT_REJECTED,
    EXIT_STOPPED,
    SEVERITIES,
    CncError,
    Diagnostic,
    Severity,
    UsageError,
    shown_name,
)
from cnc.model.operator_control import Control

if TYPE_CHECKING:
    from cnc.report.result import Report


log = logging.getLogger(__name__)

SUFFIXES = (".nc", ".ngc", ".gcode", ".gc", ".cnc", ".tap", ".mpf")
"""Suffixes of programs in a folder."""


def check_one(
    file: str, common: CommonOptions, options: CheckOptions, picture: str | None = None
) -> Report:
    """Check one program in this process."""
    api = library()
    machine = options.machine(common.machine)
    control = Control(common.feed_override)
    with ProgressDisplay(control, quiet=common.terminal.quiet) as display:
        report: Report = api.check(
            file,
            machine,
            options.run_options(common, picture=picture),
            callbacks=display.callbacks(),
            control=control,
        )
    return report


def check_listed(
    files: Sequence[str], common: CommonOptions, options: CheckOptions, stream: TextIO
) -> list[Report]:
    """Check programs in parallel and print a line for each, in the order of the programs."""
    from cnc.batch.pool import check_many
    from cnc.report.summary import TRAVEL_NOT_CHECKED, one_line

    if common.has_program_outputs or options.stl is not None:
        message = "--blocks, --trace, --pulses, --lines and --stl take one program"
        hint = "check that program alone to get them"
        raise UsageError(Diagnostic("one-program-only", message, hint=hint))
    if options.scheduler is not None and options.jobs is not None:
        message = "--jobs is for this computer, --scheduler for others"
        raise UsageError(Diagnostic("jobs-and-scheduler", message, hint="give one of them"))
    reports: list[Report] = []
    machine = options.machine(common.machine)
    quiet = common.terminal.quiet
    with ProgressDisplay(Control(common.feed_override), quiet=quiet) as display:
        found = check_many(
            files,
            machine,
            options.run_options(common),
            jobs=options.jobs,
            scheduler=options.scheduler,
            on_done=lambda done: display.count(done, len(files)),
            on_compiling=None if quiet else print_compiling,
        )
        for report in found:
            reports.append(report)
            log.info("%s", one_line(report))
            for finding in report.findings:
                log.info("%s: %s", finding.severity, finding.render())
            for warning in report.warnings:
                display.warn(warning)
            if not quiet:
                print(one_line(report), file=stream, flush=True)
    if not (machine.has_travel or quiet):
        print(f"travel was {TRAVEL_NOT_CHECKED}", file=stream)
    return reports


def find_programs(names: Sequence[str]) -> list[str]:
    """Return the program files that names stand for, in order and without repetition.

    A folder stands for all programs in it and in its folders, a pattern for the files that it
    matches; each is sorted by name.

    Raises:
        UsageError: ``no-program`` if no name is given, or a folder or pattern has no program.
    """
    if not names:
        hint = "cncrun check PROGRAM..."
        raise UsageError(Diagnostic("no-program", "no program is named", hint=hint))
    found: list[str] = []
    for name in names:
        path = Path(name)
        if path.is_dir():
            matches = sorted(
                str(file)
                for file in path.rglob("*")
                if file.suffix.lower() in SUFFIXES and file.is_file()
            )
            known = " ".join("*" + suffix for suffix in SUFFIXES)
            missing = f"the folder {name} has no programs ({known})"
        elif not path.exists() and glob.has_magic(name):
            matches = sorted(
                file for file in glob.glob(name, recursive=True) if os.path.isfile(file)
            )
            missing = f"no file matches {name}"
        else:
            matches, missing = [name], ""
        if not matches:
            hint = "check the name and the folder"
            raise UsageError(Diagnostic("no-program", missing, hint=hint))
        found += matches
    return list(dict.fromkeys(found))


# End of a command: its last messages, and its exit code.

EXIT_PIPE = 141
"""The reader of the output went away: 128 + SIGPIPE, as a shell reports it for other tools."""


def usage(error: CycloptsError) -> str:
    """Return the fault of a command line in one line."""
    if isinstance(error, UnusedCliTokensError):
        unused = " ".join(error.unused_tokens or [])
        return (
            f"cncrun runs one program, {unused} is too much; "
            "several can be checked: cncrun check PROGRAM..."
        )
    return " ".join(str(error).split())


def fail(error: CncError) -> int:
    """Print an error; return its exit code."""
    sys.stdout.flush()
    log.error("%s", error.diagnostic.render())
    print(error.diagnostic.render(), file=sys.stderr)
    return error.exit_code


def internal_error(error: Exception, verbose: bool) -> int:
    """Print an error of cncrun itself; return its exit code."""
    log.critical("internal error", exc_info=error)
    if verbose:
        import traceback

        traceback.print_exception(error)
    message = f"cncrun failed: {type(error).__name__}: {error}"
    hint = (
        "please report the program, the machine file and this message; --verbose shows where it "
        "happened, --log FILE also what led to it"
    )
    print(Diagnostic("internal-error", message, hint=hint).render(), file=sys.stderr)
    return EXIT_REJECTED


def end(reports: Sequence[Report], *, quiet: bool, fail_on: Severity = "error") -> int:
    """Print the findings that count as faults to standard error.

    Args:
        reports: The reports of all programs.
        quiet: Whether to leave out the number of hidden warnings.
        fail_on: The least severe finding that counts.

    Returns:
        The exit code of the worst report.
    """
    counting = SEVERITIES[: SEVERITIES.index(fail_on) + 1]
    sys.stdout.flush()
    for report in reports:
        name = shown_name(report.program)
        if report.hidden_warnings and not quiet:
            _print_error(f"{name}: {report.hidden_warnings} more warnings are not shown")
        if report.hidden_faults:
            _print_error(
                f"{name}: {report.hidden_faults} more places outside the travel are not shown"
            )
        for finding in report.counting:
            if finding.severity in counting:
                _print_error(finding.render())
    stopped = next((report for report in reports if report.stopped_at_line is not None), None)
    code = max((report.exit_code for report in reports), default=0)
    if stopped is not None and code == 0:
        if stopped.resume_line:
            _print_error(f"to continue: --from-line {stopped.resume_line}")
        _print_error(_stop_message(stopped))
        return EXIT_STOPPED
    if code:
        return code
    found = (finding for report in reports for finding in report.counting)
    return EXIT_REJECTED if any(finding.severity in counting for finding in found) else 0


def _print_error(text: str) -> None:
    print(text, file=sys.stderr)


def _stop_message(report: Report) -> str:
    from cnc.report.result import position

    if report.board is None or not report.stopped_at_line:
        return "stopped by the operator; nothing has moved"
    place = " ".join(
        f"{axis.upper()}{position(value)}" for axis, value in report.end_position.items()
    )
    return (
        f"stopped by the operator at line {report.stopped_at_line}; "
        f"the board has come to rest at {place}"
    )


def write_summary(name: str, summary: Report | Sequence[Report]) -> None:
    """Write the summary as JSON to a file, or to standard output for ``-``."""
    from cnc.report.summary import write_json

    write_json(name, summary)


def show(report: Report, common: CommonOptions, stream: TextIO) -> None:
    """Print the summary, unless the program has faults or was stopped."""
    if common.terminal.quiet or report.faults or report.stopped_at_line is not None:
        return
    from cnc.report.summary import print_summary

    print_summary(report, stream, verbose=common.terminal.verbose)
