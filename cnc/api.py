"""The front door of the library: parse, plan, check, run.

    from cnc.api import check
    report = check("part.nc", "config/grbl-uno.toml")
    print(report.ok, report.duration_s)

A program goes by twice. The first pass reads it to the end and compares its path with the travel of
the axes, so that nothing moves in a program that is wrong anywhere. The second plans it, makes
pulses (and samples, if asked for) and sends them. Both passes stream: memory does not grow with the
program. A path that is small enough is kept from the first pass to the second.

:func:`check` and :func:`run` give a :class:`~cnc.report.result.Report`; what is wrong with the
program or the board is in its ``faults``. They raise only what the caller has to mend: UsageError
and MachineFileError.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal

from cnc.batch import pool
from cnc.boards.protocols import LineSink, PulseSink
from cnc.boards.registry import open_board
from cnc.checks.selection import Selection
from cnc.executor import homing
from cnc.executor.run import Progress
from cnc.machine.load import load_machine
from cnc.machine.models import DialectName, Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control, HomingStopped
from cnc.path.build import build
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.pulses.reference_pulse import Algorithm
from cnc.report.result import Report
from cnc.session import Job, Outputs, Pauses, Watch, start_position
from cnc.session.kernel_cache import ensure_compiled
from cnc.session.standing import home_by_board

__all__ = [
    "Control",
    "HomingStopped",
    "Outputs",
    "Report",
    "Selection",
    "Watch",
    "check",
    "check_many",
    "home",
    "load_machine",
    "parse",
    "plan",
    "run",
    "start_position",
]

Interpolator = Literal["reference-pulse", "sampled"]


def parse(
    program: Path | str,
    machine: Machine | Path | str | None = None,
    *,
    dialect: DialectName | None = None,
) -> Iterator[Block]:
    """Yield the canonical blocks of a program file, as it is read. GcodeError at the first fault,
    UsageError if there is no such file.
    """
    yield from Job(program, _machine(machine), dialect, False, Outputs(), Watch()).blocks()


def plan(
    program: Path | str,
    machine: Machine | Path | str | None = None,
    *,
    dialect: DialectName | None = None,
) -> Iterator[PlanChunk | Block]:
    """Yield the jerk-limited plan of a program file and the blocks between the moves, in order;
    MotionLimitError, and as :func:`parse`.
    """
    known = _machine(machine)
    blocks = parse(program, known, dialect=dialect)
    yield from LookAhead(known).plan(
        build(
            blocks,
            axes=known.axis_names,
            start=start_position(known),
            tolerance=known.path.tolerance,
        )
    )


def check(
    program: Path | str,
    machine: Machine | Path | str | None = None,
    *,
    dialect: DialectName | None = None,
    interpolator: Interpolator = "reference-pulse",
    algorithm: Algorithm | None = None,
    outputs: Outputs | None = None,
    watch: Watch | None = None,
    control: Control | None = None,
    selection: Selection | None = None,
    portable: Sequence[str] = (),
) -> Report:
    """Verify a program without a board: language, travel, the plan against every limit, and its
    pulses.

    program: its file, ``-`` for standard input. machine: itself, its file or shipped name, None for
    the default. dialect: None for the machine's. interpolator: ``sampled`` samples the motion at
    the machine's period, too; a trace does so in any case. algorithm: how grid moves are made; None
    for half steps on lines and arcs, enclosing lines on other curves. control: its feed override
    scales the feeds, its stop ends the check. selection: which findings besides errors to report.
    portable: dialects that have to understand the program in the same way.
    """
    known, sampled = _machine(machine), interpolator == "sampled"
    return Job(
        program,
        known,
        dialect,
        sampled,
        outputs or Outputs(),
        watch or Watch(),
        control,
        algorithm,
        selection,
        portable,
    ).carry_out()


def check_many(
    programs: Sequence[Path | str],
    machine: Machine | Path | str | None = None,
    *,
    dialect: DialectName | None = None,
    interpolator: Interpolator = "reference-pulse",
    algorithm: Algorithm | None = None,
    feed_override: float = 100.0,
    selection: Selection | None = None,
    portable: Sequence[str] = (),
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Iterator[Report]:
    """Verify many programs in ``jobs`` processes (None: one a core) and yield their reports in
    their order.

    scheduler: the address of a Dask cluster's scheduler, whose workers check them instead.

    The other arguments are those of :func:`check`. A program at which a process dies twice has the
    fault ``worker-died``, one at which this library fails ``internal-error``; the rest are checked
    all the same.
    """
    names = [str(program) for program in programs]
    return pool.check_many(
        names,
        _machine(machine),
        dialect=dialect,
        sampled=interpolator == "sampled",
        algorithm=algorithm,
        feed_override=feed_override,
        selection=selection,
        portable=portable,
        jobs=jobs,
        scheduler=scheduler,
    )


def run(
    program: Path | str,
    machine: Machine | Path | str | None = None,
    *,
    board: PulseSink | LineSink | str | None = None,
    port: str | None = None,
    dialect: DialectName | None = None,
    interpolator: Interpolator = "reference-pulse",
    algorithm: Algorithm | None = None,
    outputs: Outputs | None = None,
    watch: Watch | None = None,
    control: Control | None = None,
    check_on_board: bool = False,
    pauses: Pauses = "wait",
    from_line: int | None = None,
    home: bool = False,
    trust_position: bool = False,
) -> Report:
    """Check a program, then run it on a board; the other arguments are those of :func:`check`.

    board: itself, its name, None for the one of the machine file. port: where the board is; for the
    file board, the file to write. control: hold, resume, override and stop, from any thread or from
    ``watch.on_sent``; each takes effect at the end of what has been sent, on a board that plans for
    itself at once. check_on_board: let such a board read the lines without moving. pauses: whether
    such a board waits for ``control`` at M0 and M6, the program is refused for them, or goes on.
    from_line: the source line to begin at, with the state of the lines before restored at a safe
    height; ``watch.on_beginning`` is told how, and asked. home: the machine finds out where it
    stands first, as :func:`home` lets it, once the program has been read. trust_position: the
    position that a GRBL board reports is right, though it has restarted or the last run ended
    elsewhere, which is refused otherwise (``position-lost``).
    """
    known = _machine(machine)
    asked = outputs or Outputs(), watch or Watch(), control, algorithm
    job = Job(
        program,
        known,
        dialect,
        interpolator == "sampled",
        *asked,
        pauses=pauses,
        from_line=from_line,
        home=home,
        trust_position=trust_position,
    )
    if board is not None and not isinstance(board, str):
        return job.carry_out(board, type(board).__name__)
    name = board or known.board.kind
    try:
        opened = open_board(known, kind=name, port=port)
    except BoardError as error:
        job.report.board = name
        job.report.faults.append(error)
        return job.report
    try:
        if check_on_board:
            if not isinstance(opened, LineSink):
                hint = "leave --check-on-board out; cncrun check looks at the program"
                raise UsageError(
                    Diagnostic(
                        "no-check-on-board", f"the board {name!r} can't check lines", hint=hint
                    )
                )
            opened.check_only = True
        return job.carry_out(opened, name)
    finally:
        opened.close()


def home(
    machine: Machine | Path | str | None = None,
    axes: Sequence[str] = (),
    *,
    board: PulseSink | LineSink | str | None = None,
    port: str | None = None,
    watch: Watch | None = None,
    control: Control | None = None,
    on_axis: Callable[[homing.AxisHoming], None] | None = None,
) -> dict[str, float | None]:
    """Let the machine find out where it stands by the limit switches of its axes; where each axis
    then stands, mm, None where nobody knows.

    axes: which, all that have a switch if none is named; the machine file says in what order, where
    the switches are, and how fast. The board remembers until it is reset. on_axis is told of every
    axis before it goes. A GRBL board homes all axes by its own cycle, as its settings say. Raises
    UsageError, BoardError; HomingStopped when ``control`` stops the machine on its way.
    """
    known, seen = _machine(machine), watch or Watch()
    opened = (
        open_board(known, kind=board, port=port)
        if board is None or isinstance(board, str)
        else board
    )

    def on_progress(progress: Progress) -> None:
        if seen.on_progress is not None:
            seen.on_progress("running", 0, None)
        if seen.on_sent is not None:
            seen.on_sent(progress)

    try:
        if isinstance(opened, LineSink):
            return dict(home_by_board(opened, known, axes, control or Control()))
        ensure_compiled(seen.on_compiling)
        stands = homing.home(
            opened,
            known,
            axes,
            start_position(known),
            control=control,
            on_progress=on_progress,
            on_axis=on_axis,
        )
    finally:
        if opened is not board:
            opened.close()
    each = zip(known.axes.items(), stands, strict=True)
    return {
        letter: None if steps is None else steps / axis.steps_per_mm
        for (letter, axis), steps in each
    }


def _machine(machine: Machine | Path | str | None) -> Machine:
    return machine if isinstance(machine, Machine) else load_machine(machine)
