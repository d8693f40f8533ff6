"""Public functions of the library: parse, plan, check, check many, run, home.

    from cnc import check

    report = check("part.nc", "config/grbl-uno.toml")
    print(report.ok, report.duration_s)

A program is processed in two passes. The check pass reads it to its end and compares its path with
the travel of the axes, so that nothing moves if any part of the program is wrong. The run pass
plans the path, makes pulses (and samples, if requested) and sends them. Both passes work in chunks:
memory does not grow with the program. A path that is small enough is kept between the passes.

:func:`check` and :func:`run` return a :class:`~cnc.report.result.Report`. Faults of the program or
the board are in ``report.faults``. The functions raise only faults that the caller has to correct:
UsageError and MachineFileError.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cnc.batch import pool
from cnc.boards.protocols import LineSink, PulseSink
from cnc.boards.registry import open_board
from cnc.checks.selection import Selection
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.choices import DialectName
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control, HomingStopped
from cnc.planner.joints import Joints
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.report.result import Report
from cnc.session.context import Callbacks
from cnc.session.kernel_cache import ensure_compiled
from cnc.session.kernel_needs import moving_jobs
from cnc.session.options import Outputs, RunOptions
from cnc.session.pipeline import path_of
from cnc.session.position_check import home_by_board
from cnc.session.program_reader import start_position
from cnc.session.run_pulses import Progress
from cnc.session.session import Session

if TYPE_CHECKING:
    from cnc.session.homing import AxisHoming, Squared

__all__ = [
    "Block",
    "Callbacks",
    "Control",
    "HomingStopped",
    "Machine",
    "Outputs",
    "PlanChunk",
    "Progress",
    "Report",
    "RunOptions",
    "Selection",
    "check",
    "check_many",
    "home",
    "load_machine",
    "parse",
    "plan",
    "run",
    "start_position",
]

MachineChoice = Machine | Path | str | None
"""A machine, its file, the name of a shipped machine file, or None for the default machine."""
Board = PulseSink | LineSink


def parse(
    program: Path | str, machine: MachineChoice = None, *, dialect: DialectName | None = None
) -> Iterator[Block]:
    """Read a program file and yield its canonical blocks as they are read.

    Args:
        program: The file; ``-`` for standard input.
        machine: The machine, whose file also names the tool table and the parameters.
        dialect: How to read the program; None for the machine file's choice.

    Raises:
        GcodeError: At the first fault of the program.
        UsageError: If the file cannot be read.
        MachineFileError: If the machine file is wrong.
    """
    yield from Session(program, _loaded(machine), RunOptions(dialect=dialect)).blocks()


def plan(
    program: Path | str, machine: MachineChoice = None, *, dialect: DialectName | None = None
) -> Iterator[PlanChunk | Block]:
    """Yield the jerk-limited plan of a program file, with the blocks between the moves, in order.

    The arguments are those of :func:`parse`.

    Raises:
        MotionLimitError: Where the motion breaks a limit of the machine.
        GcodeError, UsageError, MachineFileError: As :func:`parse`.
    """
    known = _loaded(machine)
    blocks = parse(program, known, dialect=dialect)
    yield from LookAhead(known).plan(path_of(blocks, known, start_position(known)))


def check(
    program: Path | str,
    machine: MachineChoice = None,
    options: RunOptions | None = None,
    *,
    callbacks: Callbacks | None = None,
    control: Control | None = None,
) -> Report:
    """Verify a program without a board: language, travel, the limits of the plan, and pulses.

    Args:
        program: The file; ``-`` for standard input.
        machine: The machine.
        options: Options of the check; None for the defaults.
        callbacks: Functions that follow the check.
        control: Its feed override scales the feeds. Its stop request ends the check.

    Returns:
        The report, with the faults of the program.

    Raises:
        UsageError: If an option is wrong.
        MachineFileError: If the machine file is wrong.
    """
    session = Session(program, _loaded(machine), options, callbacks=callbacks, control=control)
    return session.run()


def check_many(
    programs: Sequence[Path | str],
    machine: MachineChoice = None,
    options: RunOptions | None = None,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Iterator[Report]:
    """Verify many programs in parallel and yield their reports in the order of the programs.

    A program has the fault ``worker-died`` if its worker process dies twice, and ``internal-error``
    if this library fails. The other programs are checked nevertheless.

    Args:
        programs: The files.
        machine: The machine.
        options: Options of each check; None for the defaults.
        jobs: Number of processes; None for one for each core.
        scheduler: Address of a Dask scheduler, whose workers check the programs instead.

    Raises:
        UsageError: If an option is wrong.
        MachineFileError: If the machine file is wrong.
    """
    names = [str(program) for program in programs]
    return pool.check_many(names, _loaded(machine), options, jobs=jobs, scheduler=scheduler)


def run(
    program: Path | str,
    machine: MachineChoice = None,
    options: RunOptions | None = None,
    *,
    board: Board | str | None = None,
    port: str | None = None,
    callbacks: Callbacks | None = None,
    control: Control | None = None,
) -> Report:
    """Check a program, then run it on a board.

    Args:
        program: The file; ``-`` for standard input.
        machine: The machine.
        options: Options of the run; None for the defaults.
        board: The board, or its name; None for the board of the machine file.
        port: Port of the board; for the file board, the file to write.
        callbacks: Functions that follow the run.
        control: Hold, resume, override and stop requests, from any thread or from
            ``callbacks.on_sent``. A request takes effect at the end of the motion that was sent; on
            a board that plans for itself it takes effect at once.

    Returns:
        The report, with the faults of the program and of the board.

    Raises:
        UsageError: If an option is wrong.
        MachineFileError: If the machine file is wrong.
    """
    known, options = _loaded(machine), options or RunOptions()
    session = Session(program, known, options, callbacks=callbacks, control=control)
    if board is not None and not isinstance(board, str):
        return session.run(board, type(board).__name__)
    name = board or known.board.kind
    try:
        opened = open_board(known, kind=name, port=port, homes=options.home)
    except BoardError as error:
        session.report.board = name
        session.report.faults.append(error)
        return session.report
    try:
        if options.check_on_board:
            _switch_to_check(opened, name)
        return session.run(opened, name)
    finally:
        opened.close()


def _switch_to_check(board: Board, name: str) -> None:
    if board.takes != "lines":
        message = f"the board {name!r} cannot check lines"
        hint = "leave --check-on-board out; cncrun check verifies the program without a board"
        raise UsageError(Diagnostic("no-check-on-board", message, hint=hint))
    board.check_only = True


def home(
    machine: MachineChoice = None,
    axes: Sequence[str] = (),
    *,
    board: Board | str | None = None,
    port: str | None = None,
    callbacks: Callbacks | None = None,
    control: Control | None = None,
    on_axis: Callable[[AxisHoming], None] | None = None,
    on_squared: Callable[[Squared], None] | None = None,
) -> dict[str, float | None]:
    """Home the machine on the limit switches of its axes.

    The machine file defines the order of the axes, the switches and the speeds. The board keeps the
    position until it is reset. A GRBL board homes all axes in its own cycle, by its settings.

    Args:
        machine: The machine.
        axes: Letters of the axes to home; empty for all axes that have a switch.
        board: The board, or its name; None for the board of the machine file.
        port: Port of the board.
        callbacks: Functions that follow the motion.
        control: The operator's requests.
        on_axis: Called before each axis moves.
        on_squared: Called with the difference between the motors of a gantry that was removed.

    Returns:
        Position of each axis, mm (degrees for rotary axes); None where it is unknown.

    Raises:
        UsageError: If an option is wrong.
        BoardError: If the board or its link fails.
        HomingStopped: If ``control`` stops the machine.
    """
    known, seen = _loaded(machine), callbacks or Callbacks()
    if board is None or isinstance(board, str):
        opened, owned = open_board(known, kind=board, port=port, homes=True), True
    else:
        opened, owned = board, False

    def on_progress(progress: Progress) -> None:
        if seen.on_progress is not None:
            seen.on_progress("running", 0, None)
        if seen.on_sent is not None:
            seen.on_sent(progress)

    from cnc.session import homing  # a check does not need it

    try:
        if opened.takes == "lines":
            return dict(home_by_board(opened, known, axes, control or Control()))
        ensure_compiled(seen.on_compiling, seen.on_kernel, moving_jobs(opened))
        positions = homing.home(
            opened,
            known,
            axes,
            start_position(known),
            control=control,
            on_progress=on_progress,
            on_axis=on_axis,
            on_squared=on_squared,
        )
    finally:
        if owned:
            opened.close()
    joints = Joints(known)
    steps = np.array([np.nan if count is None else count for count in positions])
    tip = joints.tip(steps / joints.machine.steps_per_mm)
    places = zip(known.axes, tip.tolist(), strict=True)
    return {letter: None if math.isnan(place) else place for letter, place in places}


def _loaded(machine: MachineChoice) -> Machine:
    return machine if isinstance(machine, Machine) else load_machine(machine)
