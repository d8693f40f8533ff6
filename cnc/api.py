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
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cnc.batch import pool
from cnc.batch.task import Task
from cnc.boards.protocols import LineSink, PulseSink
from cnc.boards.registry import open_board
from cnc.checks.selection import Selection
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.choices import Curves, DialectName, TargetName
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
from cnc.session.program_reader import TEXT_NAME, InlineProgram, start_position
from cnc.session.run_pulses import Progress
from cnc.session.session import Session

if TYPE_CHECKING:
    from cnc.convert.programs import Converted
    from cnc.session.homing import AxisHoming, Squared, Switched

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
    "convert_program",
    "from_points",
    "from_text",
    "home",
    "load_machine",
    "parse",
    "plan",
    "run",
    "start_position",
]

Program = Path | str | InlineProgram
"""A program's file, ``-`` for standard input, or a program that :func:`from_text` or
:func:`from_points` returns."""
MachineChoice = Machine | Path | str | None
"""A machine, its file, the name of a shipped machine file, or None for the default machine."""
Board = PulseSink | LineSink


def from_text(text: str) -> InlineProgram:
    """Return a program whose text is given, for all functions that take a program.

    Its name in messages is ``<text>``. It has no checkpoint, and no folder of subroutines.
    """
    return InlineProgram(TEXT_NAME, text.encode())


def from_points(points: ArrayLike, feed: float, axes: str = "xyz") -> InlineProgram:
    """Return a program of straight moves through points.

    The first point is reached by a traverse, the others at the feed. The blend at the corners is
    that of the machine file (G64).

    Args:
        points: Positions (n, axes) in the work coordinates in effect, mm (degrees).
        feed: mm/min.
        axes: Letters of the columns.

    Raises:
        UsageError: ``points-shape`` if the points are not (n, axes) finite numbers with n > 0, or
            the feed is not above 0.
    """
    places = np.asarray(points, np.float64)
    if places.ndim != 2 or places.shape[1] != len(axes) or not np.isfinite(places).all():
        message = f"the points have the shape {places.shape}, or are not all finite"
        hint = f"give an array (n, {len(axes)}), a column for each of {', '.join(axes)}"
        raise UsageError(Diagnostic("points-shape", message, hint=hint))
    if not (len(places) and feed > 0.0 and math.isfinite(feed)):
        message, hint = "there is no point, or the feed is not above 0", "give points and mm/min"
        raise UsageError(Diagnostic("points-shape", message, hint=hint))
    words = [
        " ".join(f"{axis.upper()}{value:.6f}" for axis, value in zip(axes, place, strict=True))
        for place in places.tolist()
    ]
    lines = ["G21 G90 G94", f"G0 {words[0]}", *(f"G1 {each}" for each in words[1:]), "M2"]
    if len(words) > 1:
        lines[2] += f" F{feed:.6f}"
    return from_text("\n".join(lines) + "\n")


def parse(
    program: Program, machine: MachineChoice = None, *, dialect: DialectName | None = None
) -> Iterator[Block]:
    """Read a program file and yield its canonical blocks as they are read.

    Args:
        program: The file, ``-`` for standard input, or a given text or points.
        machine: The machine, whose file also names the tool table and the parameters.
        dialect: How to read the program; None for the machine file's choice.

    Raises:
        GcodeError: At the first fault of the program.
        UsageError: If the file cannot be read.
        MachineFileError: If the machine file is wrong.
    """
    yield from Session(program, _loaded(machine), RunOptions(dialect=dialect)).blocks()


def plan(
    program: Program | Iterable[Block],
    machine: MachineChoice = None,
    *,
    dialect: DialectName | None = None,
) -> Iterator[PlanChunk | Block]:
    """Yield the jerk-limited plan of a program, with the blocks between the moves, in order.

    The arguments are those of :func:`parse`; in place of a program there may be its blocks, in
    machine coordinates. :meth:`PlanChunk.line_times` and :meth:`PlanChunk.positions` give times and
    places of a part of the plan.

    Raises:
        MotionLimitError: Where the motion breaks a limit of the machine.
        GcodeError, UsageError, MachineFileError: As :func:`parse`.
    """
    known = _loaded(machine)
    if isinstance(program, str | Path | InlineProgram):
        program = parse(program, known, dialect=dialect)
    yield from LookAhead(known).plan(path_of(program, known, start_position(known)))


def check(
    program: Program,
    machine: MachineChoice = None,
    options: RunOptions | None = None,
    *,
    callbacks: Callbacks | None = None,
    control: Control | None = None,
) -> Report:
    """Verify a program without a board: language, travel, the limits of the plan, and pulses.

    Args:
        program: The file, ``-`` for standard input, or a given text or points.
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
    loaded, chosen = _loaded(machine), options or RunOptions()
    tasks = [Task(str(program), loaded, chosen) for program in programs]
    return pool.check_tasks(tasks, jobs=jobs, scheduler=scheduler)


def convert_program(
    program: Program,
    to: TargetName,
    machine: MachineChoice = None,
    *,
    dialect: DialectName | None = None,
    tolerance: float = 0.01,
    curves: Curves = "lines",
) -> Converted:
    """Write a program for another control; the text is read back, and moves the machine alike.

    Args:
        program: The file, ``-`` for standard input, or a given text or points.
        to: The control to write it for.
        machine: The machine that both programs are for.
        dialect: How to read it; None for the machine file's choice.
        tolerance: Largest distance of curves that are written anew, mm.
        curves: How short moves are written: as they are, as arcs, or as NURBS.

    Returns:
        The text with a report: what was kept, expanded and assumed, and the largest distance.

    Raises:
        CncError: A fault of the program; ``convert-cannot`` for what the control does not have;
            ``convert-differs`` if no text of the same motion was found.
        UsageError: If the file cannot be read, or the machine is a lathe.
        MachineFileError: If the machine file is wrong.
    """
    # The parts of a conversion take time at each start of a program that converts nothing.
    from cnc.convert.programs import convert

    return convert(program, _loaded(machine), dialect, to, tolerance=tolerance, curves=curves)


def run(
    program: Program,
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
        program: The file, ``-`` for standard input, or a given text or points.
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

    def on_result(result: Squared | Switched) -> None:
        if on_squared is not None and isinstance(result, homing.Squared):
            on_squared(result)

    try:
        if opened.takes == "lines":
            return dict(homing.home_and_record(opened, known, axes, control or Control()))
        ensure_compiled(seen.on_compiling, seen.on_kernel, moving_jobs(opened, known))
        positions = homing.home(
            opened,
            known,
            axes,
            start_position(known),
            control=control,
            on_progress=on_progress,
            on_axis=on_axis,
            on_result=on_result,
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
