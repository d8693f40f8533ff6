"""Programs of an operator session: files, entered lines, macros and probing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

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


def macro_names(folder: Path | None) -> list[str]:
    """Return the names of the macros of a folder, sorted."""
    if folder is None or not folder.is_dir():
        return []
    found = (file for file in folder.iterdir() if file.suffix in (".ngc", ".nc"))
    return sorted(file.name for file in found if file.is_file())


class Programs:
    """Runs programs on the machine of a worker, in its thread.

    Args:
        worker: The worker.
        machine: The machine, with the folders of its subroutines.
        macros: Folder of the macros; None for no macros.
    """

    def __init__(self, worker: Worker, machine: Machine, macros: Path | None) -> None:
        self._worker, self._machine, self._macros = worker, machine, macros
        self._modal = ModalMemory(has_m61=machine.program.dialect in ("auto", "linuxcnc"))

    def probe(self, line: str) -> JobEnded:
        """Run the call of a probing cycle."""
        text = f"{self._worker.view.system}\n{line}\nM2\n".encode()
        return self._run(InlineProgram(MDI_NAME, text), line, CYCLES, 1)

    def probe_grid(self, grid: Grid, *, trust_position: bool) -> HeightMap:
        """Probe a surface on a grid. UsageError ``height-map-grid`` if a contact is missing."""
        view = self._worker.view
        system = view.system
        height = view.work_position(system)["z"]
        text = f"{system}\n{grid.program(height)}".encode()
        found: dict[int, float] = {}
        program = InlineProgram(MDI_NAME, text)
        options = replace(CYCLES, trust_position=trust_position)
        ended = self._run(program, HEIGHT_MAP, options, 1, found.update)
        if ended.outcome != "done":
            raise not_probed(ended)
        work, place = view.work_position(system), view.readings.position
        return grid.height_map(found, system, {each: place[each] - work[each] for each in work})

    def mdi(self, line: str, *, trust_position: bool) -> JobEnded:
        """Run a line, with the modal state of the lines before it."""
        before = self._modal.before(line)
        text = f"{before}\n{line}\n" if before else f"{line}\n"
        skipped = before.count("\n") + 1 if before else 0
        found: dict[int, float] = {}
        program = InlineProgram(MDI_NAME, text.encode())
        options = RunOptions(trust_position=trust_position)
        ended = self._run(program, MDI_NAME, options, skipped, found.update)
        # A line that was stopped has set its modes before it moved.
        if ended.outcome != "failed":
            self._after_line(line, found)
        return ended

    def _after_line(self, line: str, parameters: Mapping[int, float]) -> None:
        """Keep the modes that a line leaves, and report those that end with it."""
        memory, machine = self._modal, self._worker.machine
        if not (memory.note_parameters(parameters) & memory.note(line)):
            message = "the modes before this line are forgotten: units, distance, tool length"
            self._warn(message, "the next line begins with the defaults of a program")
        if memory.lost:
            message = f"{' and '.join(memory.lost)} was in effect for this line only"
            self._warn(message, "write it into each line that needs it, or into a program")
        if machine.stops_outputs and starts_outputs(line):
            message = "spindle and coolant stop at the end of the line on this board"
            self._warn(message, "start them in the program that needs them")
        self._worker.view.modes = memory.modes
        with suppress(BoardError):
            machine.keep_shift(parameters)
            self.offsets_changed()

    def _warn(self, message: str, hint: str) -> None:
        self._worker.notice(Diagnostic("mdi-modes", message, hint=hint, severity="warning"))

    def macro(self, name: str) -> Path:
        """Return the file of a macro. UsageError ``no-such-macro``."""
        known = macro_names(self._macros)
        if self._macros is None or name not in known:
            hint = f"macros are {', '.join(known) or 'none'}"
            raise UsageError(Diagnostic("no-such-macro", f"there is no macro {name}", hint=hint))
        return self._macros / name

    def run(self, program: Path, name: str, options: RunOptions) -> JobEnded:
        """Run a program; the modes of the lines before it end, because it may change the tool."""
        self.forget_modes()
        return self._run(program, name, options, 0)

    def forget_modes(self) -> None:
        """Let the next entered line begin with the modes of a program."""
        self._modal.forget()
        self._worker.view.modes = ""

    def _run(
        self,
        program: Path | InlineProgram,
        name: str,
        options: RunOptions,
        skipped: int,
        on_end: Callable[[Mapping[int, float]], object] | None = None,
    ) -> JobEnded:
        worker = self._worker
        machine, control = worker.machine, worker.control
        self._worker.view.begin(name)

        def on_progress(progress: Progress) -> None:
            self._worker.view.progress(progress, machine.of_progress(progress))

        watch = RunWatch(name, worker.events, worker.dialogs, control, on_progress, skipped)
        try:
            session = Session(
                program, self._machine, options, callbacks=watch.callbacks(), control=control
            )
            report = session.run(machine.board, self._worker.view.board)
            ended = program_runs.ended(report, name, skipped)
            if on_end is not None:
                on_end(session.parameters)
        except CncError as error:
            ended = program_runs.failed(error, name)
        finally:
            self._worker.view.end()
        worker.events.emit(ended)
        # The end of the activity reports a board that has failed; the outcome of the run stays.
        with suppress(BoardError):
            machine.revive()
            self.offsets_changed()
        return ended

    def offsets_changed(self) -> dict[str, dict[str, float]]:
        """Read the offsets again, and report them."""
        machine = self._worker.machine
        offsets = machine.offsets()
        self._worker.view.read(machine)
        self._worker.view.offsets = offsets
        self._worker.events.emit(OffsetsChanged(offsets=offsets))
        return offsets
