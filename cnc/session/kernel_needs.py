"""Kernels that one session needs, compiled before they are called.

A program that is wrong should be refused at once, also on a computer without compiled kernels. So
a small program is read, and its path built, by kernels that run as plain Python. Only then are the
kernels of planning and interpolation compiled, and only those that this program needs. They are
compiled before anything moves, because a compilation would starve the board.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from cnc.boards.protocols import LineSink, PulseSink
from cnc.compiled.jit import as_python
from cnc.machine.models import Machine
from cnc.model.blocks import Block, NurbsFeed, PathMode
from cnc.path.chunk import PathChunk
from cnc.session.context import SessionContext
from cnc.session.kernel_cache import SMALL_BYTES, ensure_compiled, is_compiled
from cnc.session.kernel_jobs import BLENDS, FITS, PLANNING, READING


class KernelNeeds:
    """Notes what a program contains, and compiles accordingly."""

    def __init__(self, context: SessionContext) -> None:
        self._context = context
        self._path_jobs = [*READING, *jobs_of(context.reader.machine)]
        self._blends = self._interprets = self._announced = False

    def reading(self, program: Path) -> AbstractContextManager[None]:
        """Return the context in which the check pass reads the program."""
        self._interprets = _is_small(program) and not all(map(is_compiled, self._path_jobs))
        if self._interprets:
            return as_python()
        self._compile(*self._path_jobs)
        return nullcontext()

    def see_block(self, block: Block) -> None:
        """Take note of a block of the check pass, before its path is built."""
        jobs: tuple[str, ...] = ()
        if isinstance(block, NurbsFeed):
            jobs = ("NURBS",)
        elif isinstance(block, PathMode) and block.control == "blend":
            jobs = FITS
        if jobs and jobs[0] not in self._path_jobs:
            self._path_jobs += jobs
            if not self._interprets:
                self._compile(*jobs)

    def see_path(self, path: PathChunk) -> None:
        """Take note of a part of the path."""
        self._blends = self._blends or bool(path.tolerance.any())

    def before_simulation(self) -> None:
        """Compile what the simulation of the cut needs."""
        self._compile(*self._path_jobs, "stock")

    def before_motion(self, board: PulseSink | LineSink | None, *, reads_again: bool) -> None:
        """Compile what planning, interpolation and the outputs need.

        Args:
            board: the board, if there is one.
            reads_again: whether the path of the check pass is not kept.
        """
        options = self._context.options
        takes_lines = board is not None and board.takes == "lines"
        lines = takes_lines or options.outputs.lines is not None
        plans = self._context.needs_plan or not takes_lines
        jobs = list(PLANNING) if plans else []
        if reads_again or lines:
            jobs += self._path_jobs
        if self._blends and plans:
            jobs += BLENDS
        if not takes_lines:
            jobs.append("pulses")
        if board is not None:
            jobs += board.capabilities.kernels
            if board.capabilities.slice_s > 0.0:
                jobs.append("holds")
        if options.sampled:
            jobs.append("samples")
        if lines:
            jobs.append("GRBL lines")
        if options.outputs.picture is not None:
            jobs.append("drawing")
            if self._context.reader.machine.tip_columns:
                jobs.append("samples")
        self._compile(*jobs)

    def _compile(self, *jobs: str) -> None:
        callbacks = self._context.observer.callbacks
        ensure_compiled(None if self._announced else self._announce, callbacks.on_kernel, jobs)

    def _announce(self) -> None:
        self._announced = True
        if (on_compiling := self._context.observer.callbacks.on_compiling) is not None:
            on_compiling()


def jobs_of(machine: Machine) -> tuple[str, ...]:
    """Return the jobs of each path of a machine, besides those of all machines."""
    return ("joints",) if machine.tip_columns else ()


def moving_jobs(board: PulseSink, machine: Machine) -> tuple[str, ...]:
    """Return the jobs of a straight move on a board: a jog, homing."""
    return ("paths", *jobs_of(machine), *PLANNING, "pulses", *board.capabilities.kernels)


def _is_small(program: Path) -> bool:
    """Return whether a program is read quickly without compiled kernels."""
    return program.is_file() and program.stat().st_size <= SMALL_BYTES
