"""Runs with the fields of RunOptions as keywords, for helpers that pass them on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cnc.api import Callbacks, Control, Machine, Report, RunOptions, check, run


def run_with(
    program: Path,
    machine: Machine | None = None,
    *,
    board: Any = None,
    callbacks: Callbacks | None = None,
    control: Control | None = None,
    **options: Any,
) -> Report:
    return run(
        program, machine, RunOptions(**options), board=board, callbacks=callbacks, control=control
    )


def check_with(program: Path, machine: Any = None, **options: Any) -> Report:
    return check(program, machine, RunOptions(**options))
