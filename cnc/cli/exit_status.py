"""End of a command: its last messages, and its exit code."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, TextIO

from cyclopts import CycloptsError, UnusedCliTokensError

from cnc.cli.options import CommonOptions
from cnc.model.diagnostics import (
    EXIT_REJECTED,
    EXIT_STOPPED,
    SEVERITIES,
    CncError,
    Diagnostic,
    Severity,
)
from cnc.model.shown_text import shown_name

if TYPE_CHECKING:
    from cnc.report.result import Report

log = logging.getLogger(__name__)

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
    from cnc.report.number_format import position

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
    from cnc.outputs.summary_json import write_json

    write_json(name, summary)


def show(report: Report, common: CommonOptions, stream: TextIO) -> None:
    """Print the summary, unless the program has faults or was stopped."""
    if common.terminal.quiet or report.faults or report.stopped_at_line is not None:
        return
    from cnc.report.summary import print_summary

    print_summary(report, stream, verbose=common.terminal.verbose)
