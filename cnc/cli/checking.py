"""The programs that `check` accepts, and the check of one or many."""

from __future__ import annotations

import glob
import logging
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from cnc.cli.options import CheckOptions, CommonOptions, library
from cnc.cli.progress import ProgressDisplay, print_compiling
from cnc.model.diagnostics import Diagnostic, UsageError
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
