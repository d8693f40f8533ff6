"""Which programs `check` takes, and how it goes through them."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from cnc.checks.selection import Selection
from cnc.cli.options import Common, library
from cnc.cli.progress import Screen, tell_compiling
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.operator_control import Control

if TYPE_CHECKING:
    from cnc.machine.models import Machine
    from cnc.report.result import Report

SUFFIXES = (".nc", ".ngc", ".gcode", ".gc", ".cnc", ".tap", ".mpf")
"""What `check` takes for programs in a folder."""


@dataclass(frozen=True)
class Look:
    """What `check` looks for, and how."""

    stock: str | None = None
    selection: Selection = field(default_factory=Selection)
    portable: tuple[str, ...] = ()
    jobs: int | None = None
    scheduler: str | None = None

    def machine(self, name: str | None) -> Machine:
        """The machine of a file, with the raw part on it."""
        from cnc.machine.load import load_machine
        from cnc.machine.stock import with_stock

        machine = load_machine(name)
        return machine if self.stock is None else with_stock(machine, self.stock)


def codes(listed: Sequence[str]) -> list[str]:
    """What was given one by one or with commas between."""
    return [code for each in listed for code in each.split(",") if code]


def check_one(file: str, common: Common, look: Look, picture: str | None = None) -> Report:
    """A program alone, in this process."""
    api = library()
    machine = look.machine(common.machine)
    control = Control(common.feed_override)
    with Screen(control, quiet=common.quiet) as screen:
        report: Report = api.check(
            file,
            machine,
            dialect=common.dialect,
            interpolator=common.interpolator,
            algorithm=common.algorithm,
            outputs=replace(common.outputs(), picture=picture),
            watch=screen.watch(),
            control=control,
            selection=look.selection,
            portable=look.portable,
        )
    return report


def check_listed(files: Sequence[str], common: Common, look: Look, shown: TextIO) -> list[Report]:
    """Programs in their order, in processes of their own; a line for each as soon as those before
    it have theirs.
    """
    from cnc.batch.pool import check_many
    from cnc.report.summary import one_line

    if any((common.blocks, common.trace, common.pulses, common.lines)):
        raise UsageError(
            Diagnostic(
                "one-program-only",
                "--blocks, --trace, --pulses and --lines take one program",
                hint="check that program alone to get them",
            )
        )
    if look.scheduler is not None and look.jobs is not None:
        raise UsageError(
            Diagnostic(
                "jobs-and-scheduler",
                "--jobs is for this computer, --scheduler for others",
                hint="give one of them",
            )
        )
    reports: list[Report] = []
    control = Control(common.feed_override)
    with Screen(control, quiet=common.quiet) as screen:
        found = check_many(
            files,
            look.machine(common.machine),
            dialect=common.dialect,
            sampled=common.interpolator == "sampled",
            algorithm=common.algorithm,
            feed_override=control.feed_override,
            selection=look.selection,
            portable=look.portable,
            jobs=look.jobs,
            scheduler=look.scheduler,
            on_done=lambda done: screen.count(done, len(files)),
            on_compiling=None if common.quiet else tell_compiling,
        )
        for report in found:
            reports.append(report)
            for warning in report.warnings:
                screen.warn(warning)
            if not common.quiet:
                print(one_line(report), file=shown, flush=True)
    return reports


def find_programs(names: Sequence[str]) -> list[str]:
    """Files in the order given: a folder stands for the programs anywhere in it, a pattern for what
    it matches, each sorted by name.

    UsageError ``no-program`` where nothing is named, or a folder or pattern has no program.
    """
    if not names:
        raise UsageError(
            Diagnostic("no-program", "no program is named", hint="cncrun check PROGRAM...")
        )
    found: list[str] = []
    for name in names:
        path = Path(name)
        if path.is_dir():
            matches = sorted(
                str(file)
                for file in path.rglob("*")
                if file.suffix.lower() in SUFFIXES and file.is_file()
            )
            where = f"the folder {name} has no programs ({' '.join('*' + suffix for suffix in SUFFIXES)})"
        elif not path.exists() and glob.has_magic(name):
            matches = sorted(
                file for file in glob.glob(name, recursive=True) if os.path.isfile(file)
            )
            where = f"no file matches {name}"
        else:
            matches, where = [name], ""
        if not matches:
            raise UsageError(Diagnostic("no-program", where, hint="check the name and the folder"))
        found += matches
    return list(dict.fromkeys(found))
