"""Programs of an operator session: files, entered lines, macros and probing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from cnc.boards.port import Clock
from cnc.executor.run import Progress
from cnc.machine.height_map import HeightMap
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, CncError, Diagnostic, UsageError
from cnc.operate import program_runs
from cnc.operate.events import JobEnded, OffsetsChanged
from cnc.operate.height_mapping import HEIGHT_MAP, Grid, not_probed
from cnc.operate.modal_memory import ModalMemory, starts_outputs
from cnc.operate.program_runs import RunWatch
from cnc.operate.worker import Worker
from cnc.session.options import RunOptions
from cnc.session.session import Session
from cnc.session.source import MDI_NAME, InlineProgram

CYCLES = RunOptions(dialect="linuxcnc")
"""Probing cycles are subroutines of LinuxCNC, whatever the dialect of the machine's programs."""
MOST_HISTORY = 1000
"""Entered lines that are kept."""


def macro_names(folder: Path | None) -> list[str]:
    """Return the names of the macros of a folder, sorted."""
    if folder is None or not folder.is_dir():
        return []
    found = (file for file in folder.iterdir() if file.suffix in (".ngc", ".nc"))
    return sorted(file.name for file in found if file.is_file())


class ProgramSession(Worker):
    """Runs programs on the machine.

    Args:
        machine: The machine.
        macros: Folder of the macros; None for no macros.
        clock: Measures the time between the signs of life of a jog; None for the real time.

    Attributes:
        machine: The machine.
        history: Lines entered by :meth:`mdi`, the oldest first.
    """

    machine: Machine

    def __init__(self, machine: Machine, macros: Path | None, clock: Clock | None = None) -> None:
        self.history: list[str] = []
        self._macros = macros
        self._modal = ModalMemory(has_m61=machine.program.dialect in ("auto", "linuxcnc"))
        super().__init__(machine, clock)

    def probe(self, line: str) -> Future[JobEnded]:
        """Run the call of a probing cycle (:func:`cnc.operate.probing.mdi_line`)."""
        system = self._view.system
        text = f"{system}\n{line}\nM2\n".encode()
        program = InlineProgram(MDI_NAME, text)
        return self._begin("probe", lambda: self._run(program, line, CYCLES, 1))

    def probe_grid(self, grid: Grid, *, trust_position: bool = False) -> Future[HeightMap]:
        """Probe a surface on a grid, and return its height map.

        Args:
            grid: The points.
            trust_position: The position that the board reports is right.

        Raises:
            UsageError: ``height-map-grid``, also if a contact is missing.
        """
        grid.check()

        def probe() -> HeightMap:
            system = self._view.system
            height = self._view.work_position(system)["z"]
            text = f"{system}\n{grid.program(height)}".encode()
            found: dict[int, float] = {}
            program = InlineProgram(MDI_NAME, text)
            options = replace(CYCLES, trust_position=trust_position)
            ended = self._run(program, HEIGHT_MAP, options, 1, found.update)
            if ended.outcome != "done":
                raise not_probed(ended)
            work = self._view.work_position(system)
            place = self._view.readings.position
            return grid.height_map(found, system, {each: place[each] - work[each] for each in work})

        return self._begin("probe", probe)

    def mdi(self, line: str, *, trust_position: bool = False) -> Future[JobEnded]:
        """Run a line, with the modal state of the lines before it.

        Args:
            line: The line.
            trust_position: The position that the board reports is right.
        """
        self.history = [*self.history, line][-MOST_HISTORY:]
        before = self._modal.before(line)
        text = f"{before}\n{line}\n" if before else f"{line}\n"
        skipped = before.count("\n") + 1 if before else 0

        def run() -> JobEnded:
            found: dict[int, float] = {}
            program = InlineProgram(MDI_NAME, text.encode())
            options = RunOptions(trust_position=trust_position)
            ended = self._run(program, MDI_NAME, options, skipped, found.update)
            # A line that was stopped has set its modes before it moved.
            if ended.outcome != "failed":
                self._after_line(line, found)
            return ended

        return self._begin("mdi", run)

    def _after_line(self, line: str, parameters: Mapping[int, float]) -> None:
        """Keep the modes that a line leaves, and report those that end with it."""
        memory, machine = self._modal, self._machine
        if not (memory.note_parameters(parameters) & memory.note(line)):
            message = "the modes before this line are forgotten: units, distance, tool length"
            self._warn(message, "the next line begins with the defaults of a program")
        if memory.lost:
            message = f"{' and '.join(memory.lost)} was in effect for this line only"
            self._warn(message, "write it into each line that needs it, or into a program")
        if machine.stops_outputs and starts_outputs(line):
            message = "spindle and coolant stop at the end of the line on this board"
            self._warn(message, "start them in the program that needs them")
        self._view.modes = memory.modes
        with suppress(BoardError):
            machine.keep_shift(parameters)
            self._offsets_changed()

    def _warn(self, message: str, hint: str) -> None:
        self._notice(Diagnostic("mdi-modes", message, hint=hint, severity="warning"))

    def macro(self, name: str) -> Future[JobEnded]:
        """Run a macro. UsageError ``no-such-macro``."""
        known = macro_names(self._macros)
        if self._macros is None or name not in known:
            hint = f"macros are {', '.join(known) or 'none'}"
            raise UsageError(Diagnostic("no-such-macro", f"there is no macro {name}", hint=hint))
        file = self._macros / name
        return self._begin("mdi", lambda: self._run_file(file, name, RunOptions()))

    def run(
        self, program: Path, options: RunOptions | None = None, *, name: str | None = None
    ) -> Future[JobEnded]:
        """Check a program and run it.

        Args:
            program: The file.
            options: Options of the run.
            name: Name in the events; None for that of the file.
        """
        chosen = options or RunOptions()
        return self._begin("program", lambda: self._run_file(program, name or program.name, chosen))

    def _run_file(self, program: Path, name: str, options: RunOptions) -> JobEnded:
        """Run a program; the modes of the lines before it end, because it may change the tool."""
        self._forget_modes()
        return self._run(program, name, options, 0)

    def _forget_modes(self) -> None:
        self._modal.forget()
        self._view.modes = ""

    def _run(
        self,
        program: Path | InlineProgram,
        name: str,
        options: RunOptions,
        skipped: int,
        on_end: Callable[[Mapping[int, float]], object] | None = None,
    ) -> JobEnded:
        machine, control = self._machine, self._control
        self._view.begin(name)

        def on_progress(progress: Progress) -> None:
            self._view.progress(progress, machine.of_progress(progress))

        watch = RunWatch(name, self.events, self._dialogs, control, on_progress, skipped)
        try:
            session = Session(
                program, self.machine, options, callbacks=watch.callbacks(), control=control
            )
            report = session.run(machine.board, self._view.board)
            ended = program_runs.ended(report, name, skipped)
            if on_end is not None:
                on_end(session.parameters)
        except CncError as error:
            ended = program_runs.failed(error, name)
        finally:
            self._view.end()
        self.events.emit(ended)
        # The end of the activity reports a board that has failed; the outcome of the run stays.
        with suppress(BoardError):
            machine.revive()
            self._offsets_changed()
        return ended

    def _offsets_changed(self) -> dict[str, dict[str, float]]:
        machine = self._machine
        offsets = machine.offsets()
        self._view.read(machine)
        self._view.offsets = offsets
        self.events.emit(OffsetsChanged(offsets=offsets))
        return offsets
