"""The work of the commands that check programs: their names, the checks, and their results.

It imports the library, so the commands import it when they are carried out.
"""

from __future__ import annotations

import glob
import logging
import os
import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TextIO

from cnc import api
from cnc.batch.pool import check_tasks
from cnc.batch.task import Task
from cnc.cli.options import CheckFormat, CheckOptions, CommonOptions
from cnc.cli.progress import ProgressDisplay, print_compiling
from cnc.cli.projects import jobs_of, options_of
from cnc.model.diagnostics import (
    EXIT_REJECTED,
    EXIT_STOPPED,
    SEVERITIES,
    Diagnostic,
    Severity,
    UsageError,
    printable,
    shown_name,
)
from cnc.model.operator_control import Control
from cnc.report.result import Report, position
from cnc.report.summary import TRAVEL_NOT_CHECKED, one_line, print_summary, write_json
from cnc.session.kernel_cache import ensure_compiled

log = logging.getLogger(__name__)

SUFFIXES = (".nc", ".ngc", ".gcode", ".gc", ".cnc", ".tap", ".mpf")
"""Suffixes of programs in a folder."""


def check_programs(
    names: Sequence[str],
    common: CommonOptions,
    options: CheckOptions,
    format: CheckFormat,
    baseline: str | None,
    fail_on: Severity,
) -> int:
    """Check programs, folders and patterns; report in a format; return the exit code."""
    files = find_programs(names)
    listed = len(files) != 1 or names != files
    stream = common.summary_file if format == "text" else sys.stderr
    before = None
    if baseline is not None:
        from cnc.checks.baseline import Baseline, change_lines

        before = Baseline(baseline)
    reports = (
        check_listed(files, common, options, stream)
        if listed or options.scheduler
        else [check_one(files[0], common, options)]
    )
    if before is not None:
        for report in reports:
            report.changes = before.changes(report)
    for name in {common.json, "-" if format == "json" else None}:
        if name is not None:
            write_json(name, reports if listed else reports[0])
    if format != "text" and format != "json":
        from cnc.report.findings import write_findings  # imports a library for XML

        write_findings(format, reports)
    if not listed:
        show(reports[0], common, stream)
    quiet = common.terminal.quiet
    if not quiet and format == "text" and (repairable := _repairable(reports)):
        print(repairable, file=stream)
    if before is not None and not quiet:
        print(*change_lines(reports, before.missing(reports)), sep="\n", file=stream)
    return end(reports, quiet=quiet, fail_on=fail_on)


def _repairable(reports: Sequence[Report]) -> str:
    """Return a line with the number of findings that have a repair; empty without any."""
    fixes = [finding.fix for report in reports for finding in report.findings if finding.fix]
    safe = sum(fix.safe for fix in fixes)
    parts = [
        f"{count} finding{'s' * (count > 1)} can be repaired with {name}"
        for count, name in ((safe, "--fix"), (len(fixes) - safe, "--fix --unsafe-fixes"))
        if count
    ]
    return ", ".join(parts)


def check_one(
    file: str, common: CommonOptions, options: CheckOptions, picture: str | None = None
) -> Report:
    """Check one program in this process."""
    chosen = options_of(file, common, options)
    control = Control(common.feed_override)
    with ProgressDisplay(control, quiet=common.terminal.quiet) as display:
        return api.check(
            file,
            chosen.machine,
            chosen.check.run_options(chosen.common, picture=picture),
            callbacks=display.callbacks(),
            control=control,
        )


def check_listed(
    files: Sequence[str], common: CommonOptions, options: CheckOptions, stream: TextIO
) -> list[Report]:
    """Check programs in parallel and print a line for each, in the order of the programs."""
    if common.has_program_outputs or options.stl is not None:
        message = "--blocks, --trace, --pulses, --lines and --stl take one program"
        hint = "check that program alone to get them"
        raise UsageError(Diagnostic("one-program-only", message, hint=hint))
    if options.scheduler is not None and options.jobs is not None:
        message = "--jobs is for this computer, --scheduler for others"
        raise UsageError(Diagnostic("jobs-and-scheduler", message, hint="give one of them"))
    reports: list[Report] = []
    quiet = common.terminal.quiet
    # Programs behind each other with the same options share them: a machine takes memory.
    tasks = [
        Task(file, chosen.machine, chosen.check.run_options(chosen.common))
        for chosen, group in groupby(files, lambda file: options_of(file, common, options))
        for file in group
    ]
    with ProgressDisplay(Control(common.feed_override), quiet=quiet) as display:
        results = check_tasks(
            tasks,
            jobs=options.jobs or jobs_of(files[0]),
            scheduler=options.scheduler,
            on_compiling=None if quiet else print_compiling,
        )
        for report in results:
            display.count(len(reports) + 1, len(files))
            reports.append(report)
            log.info("%s", one_line(report))
            for finding in report.findings:
                log.info("%s: %s", finding.severity, finding.render())
            for warning in report.warnings:
                display.warn(warning)
            if not quiet:
                print(one_line(report), file=stream, flush=True)
    if not (quiet or all(report.machine.has_travel for report in reports)):
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
    programs: list[str] = []
    for name in names:
        path = Path(name)
        if path.is_dir():
            matches = sorted(
                str(file)
                for file in path.rglob("*")
                if file.suffix.lower() in SUFFIXES and file.is_file()
            )
            suffixes = " ".join("*" + suffix for suffix in SUFFIXES)
            missing = f"the folder {name} has no programs ({suffixes})"
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
        programs += matches
    return list(dict.fromkeys(programs))


# End of a check or a run: its findings and its exit code.


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
    findings = (finding for report in reports for finding in report.counting)
    return EXIT_REJECTED if any(finding.severity in counting for finding in findings) else 0


def _print_error(text: str) -> None:
    print(text, file=sys.stderr)


def _stop_message(report: Report) -> str:
    if report.board is None or not report.stopped_at_line:
        return "stopped by the operator; nothing has moved"
    place = " ".join(
        f"{axis.upper()}{position(value)}" for axis, value in report.end_position.items()
    )
    return (
        f"stopped by the operator at line {report.stopped_at_line}; "
        f"the board has come to rest at {place}"
    )


def finish(report: Report, common: CommonOptions, picture: str | None = None) -> int:
    """Write and print the summary of one program; return the exit code.

    Args:
        report: The report.
        common: The options.
        picture: The picture that was drawn.
    """
    if common.json is not None:
        write_json(common.json, report)
    show(report, common, common.summary_file)
    quiet = common.terminal.quiet
    if picture is not None and report.ok and report.stopped_at_line is None and not quiet:
        print(f"picture      {printable(picture)}", file=common.summary_file)
    return end([report], quiet=quiet)


def show(report: Report, common: CommonOptions, stream: TextIO) -> None:
    """Print the summary, unless the program has faults or was stopped."""
    if common.terminal.quiet or report.faults or report.stopped_at_line is not None:
        return
    print_summary(report, stream, verbose=common.terminal.verbose)


def compile_kernels(*, quiet: bool) -> None:
    """Compile all kernels, with a progress bar."""
    with ProgressDisplay(Control(), quiet=quiet) as display:
        callbacks = display.callbacks()
        ensure_compiled(callbacks.on_compiling, callbacks.on_kernel)
