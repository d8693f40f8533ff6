"""How a command ends: the last words, and the exit code."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, TextIO

from cyclopts import CycloptsError, UnusedCliTokensError

from cnc.cli.options import Common
from cnc.model.diagnostics import (
    EXIT_REJECTED,
    EXIT_STOPPED,
    SEVERITIES,
    CncError,
    Diagnostic,
    Severity,
)

if TYPE_CHECKING:
    from cnc.report.result import Report

EXIT_PIPE = 141
"""Whoever read our output went away: 128 + SIGPIPE, as a shell shows it for other tools."""


def usage(error: CycloptsError) -> str:
    """What is wrong with the command line, in one line and in our words where cyclopts speaks of
    its own.
    """
    if isinstance(error, UnusedCliTokensError):
        return f"cncrun runs one program, {' '.join(error.unused_tokens or [])} is too much; several can be checked: cncrun check PROGRAM..."
    return " ".join(str(error).split())


def fail(error: CncError) -> int:
    """Say what is wrong; the exit code for it."""
    sys.stdout.flush()
    print(error.diagnostic.render(), file=sys.stderr)
    return error.exit_code


def internal_error(error: Exception, verbose: bool) -> int:
    """A fault of ours: said as such, with a way to learn more."""
    if verbose:
        import traceback

        traceback.print_exception(error)
    kind = type(error).__name__
    hint = "please report the program, the machine file and this message; --verbose shows where it happened"
    print(
        Diagnostic("internal-error", f"cncrun failed: {kind}: {error}", hint=hint).render(),
        file=sys.stderr,
    )
    return EXIT_REJECTED


def end(reports: Sequence[Report], *, quiet: bool, fail_on: Severity = "error") -> int:
    """Faults of all reports on standard error, and lesser findings that count for as much; the exit
    code of the worst.
    """
    counting = SEVERITIES[: SEVERITIES.index(fail_on) + 1]
    sys.stdout.flush()
    for report in reports:
        if report.hidden_warnings and not quiet:
            print(
                f"{report.program}: {report.hidden_warnings} more warnings are not shown",
                file=sys.stderr,
            )
        if report.hidden_faults:
            print(
                f"{report.program}: {report.hidden_faults} more places outside the travel are not shown",
                file=sys.stderr,
            )
        for finding in report.counting:
            if finding.severity in counting:
                print(finding.render(), file=sys.stderr)
    stopped = next((report for report in reports if report.stopped_at_line is not None), None)
    code = max((report.exit_code for report in reports), default=0)
    if stopped is not None and code == 0:
        if stopped.resume_line:
            print(f"to go on: --from-line {stopped.resume_line}", file=sys.stderr)
        print(_where_stopped(stopped), file=sys.stderr)
        return EXIT_STOPPED
    return (
        code
        or int(
            any(finding.severity in counting for report in reports for finding in report.counting)
        )
        * EXIT_REJECTED
    )


def _where_stopped(report: Report) -> str:
    from cnc.report.summary import position

    if report.board is None or not report.stopped_at_line:
        return "stopped by the operator; nothing has moved"
    place = " ".join(
        f"{axis.upper()}{position(value)}" for axis, value in report.end_position.items()
    )
    return f"stopped by the operator at line {report.stopped_at_line}; the board has come to rest at {place}"


def write_summary(name: str, summary: Report | Sequence[Report]) -> None:
    """The summary as JSON into a file, or ``-``."""
    from cnc.outputs.summary_json import write_json

    write_json(name, summary)


def show(report: Report, common: Common, stream: TextIO) -> None:
    """The summary; a program that never moved has none."""
    if common.quiet or report.faults or report.stopped_at_line is not None:
        return
    from rich.console import Console

    from cnc.report.summary import print_summary

    console = Console(file=stream, highlight=False, width=None if stream.isatty() else 120)
    print_summary(report, console, verbose=common.verbose)
