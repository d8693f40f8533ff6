"""Comparison of two programs on one machine: distance of their toolpaths, and machine times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cnc.compare.distance import farthest
from cnc.compare.match import SAME
from cnc.compare.track import Recorder, Track
from cnc.machine.models import Machine
from cnc.model.choices import DialectName
from cnc.model.shown_text import printable
from cnc.report.number_format import clock, number, position
from cnc.report.result import Report
from cnc.session.observer import Callbacks
from cnc.session.options import RunOptions
from cnc.session.program_reader import start_position
from cnc.session.session import Session


@dataclass(frozen=True, slots=True)
class Place:
    """A source line; line 0 stands for the start, before any motion."""

    file: str
    line: int


@dataclass(frozen=True, slots=True)
class Difference:
    """The result of a comparison.

    Attributes:
        reports: results of both programs; or of the first ones up to a program with faults, and
            then nothing else is known.
        distance: largest distance between the toolpaths, mm (a degree of a rotary axis counts as
            a millimetre).
        at: position on the first toolpath with that distance, mm by axis.
        places: source lines of the moves there, of the first program and of the second.
    """

    reports: tuple[Report, ...]
    distance: float = 0.0
    at: dict[str, float] | None = None
    places: tuple[Place, Place] | None = None

    @property
    def same_path(self) -> bool:
        """Whether the toolpaths are the same to a millionth of a millimetre."""
        return self.distance <= SAME

    def as_json(self) -> dict[str, Any]:
        """Return the result for other programs. Pairs are [first program, second program]."""
        first, second = self.reports
        return {
            "programs": [first.program, second.program],
            "distance_mm": self.distance,
            "at": self.at,
            "files": None if self.places is None else [place.file for place in self.places],
            "lines": None if self.places is None else [place.line for place in self.places],
            "duration_s": [first.duration_s, second.duration_s],
            "path_length_mm": [first.path_length_mm, second.path_length_mm],
        }

    def lines(self) -> Iterator[str]:
        """Yield the result as lines of text."""
        first, second = self.reports
        if self.same_path or self.places is None or self.at is None:
            yield "path    the same"
        else:
            where = " ".join(f"{axis.upper()}{position(value)}" for axis, value in self.at.items())
            one, other = (f"{printable(place.file)}:{place.line}" for place in self.places)
            yield f"path    at most {number(self.distance)} mm apart, at {where}: {one}, {other}"
        yield f"length  {number(first.path_length_mm)} -> {number(second.path_length_mm)} mm"
        change = 100.0 * (second.duration_s / first.duration_s - 1.0) if first.duration_s else 0.0
        yield f"time    {clock(first.duration_s)} -> {clock(second.duration_s)} ({change:+.1f} %)"


def compare(
    first: Path | str,
    second: Path | str,
    machine: Machine,
    dialect: DialectName | None,
    callbacks: Callbacks | None = None,
) -> Difference:
    """Plan both programs and compare their motion.

    Args:
        first: the first program.
        second: the second program.
        machine: the machine.
        dialect: dialect of the programs; None for that of the machine.
        callbacks: called during the planning; None for none.
    """
    first_report, first_track = _planned(first, machine, dialect, callbacks)
    if not first_report.ok:
        return Difference((first_report,))
    second_report, second_track = _planned(second, machine, dialect, callbacks)
    if not second_report.ok:
        return Difference((first_report, second_report))
    apart = farthest(first_track, second_track)
    return Difference(
        (first_report, second_report),
        apart.distance,
        dict(zip(machine.axes, apart.position.tolist(), strict=True)),
        (
            _place(first_track, apart.first, first_report),
            _place(second_track, apart.second, second_report),
        ),
    )


def _planned(
    program: Path | str, machine: Machine, dialect: DialectName | None, callbacks: Callbacks | None
) -> tuple[Report, Track]:
    recorder = Recorder(start_position(machine))
    session = Session(
        program,
        machine,
        RunOptions(dialect=dialect),
        callbacks=callbacks,
        on_plan=recorder.add,
    )
    return session.run(), recorder.track()


def _place(track: Track, index: int, report: Report) -> Place:
    return Place(track.files[int(track.file[index])] or report.program, int(track.line[index]))
