"""Two programs on one machine: how far apart they move, where, and how long they take."""

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
from cnc.report.result import Report
from cnc.report.summary import clock, number, position
from cnc.session.observer import Callbacks
from cnc.session.options import RunOptions
from cnc.session.program_reader import start_position
from cnc.session.session import Session


@dataclass(frozen=True, slots=True)
class Place:
    """A place in a program: source file and line; line 0 where nothing has moved yet."""

    file: str
    line: int


@dataclass(frozen=True, slots=True)
class Difference:
    """What came of a comparison.

    reports: of both programs, or of one with faults; then nothing else is known. distance: the
    largest between the ways, mm (a degree of a rotary axis counts as a millimetre); at: where, mm
    by axis, on the way of the first; places: the moves there, of the first program and of the
    second.
    """

    reports: tuple[Report, ...]
    distance: float = 0.0
    at: dict[str, float] | None = None
    places: tuple[Place, Place] | None = None

    @property
    def same_way(self) -> bool:
        """Whether both go the same way, to a millionth of a millimetre."""
        return self.distance <= SAME

    def as_json(self) -> dict[str, Any]:
        """For other programs; pairs are of the first program and the second."""
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
        """For people."""
        first, second = self.reports
        if self.same_way or self.places is None or self.at is None:
            yield "way     the same"
        else:
            where = " ".join(f"{axis.upper()}{position(value)}" for axis, value in self.at.items())
            one, other = (f"{place.file}:{place.line}" for place in self.places)
            yield f"way     at most {number(self.distance)} mm apart, at {where}: {one}, {other}"
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
    """Plan both programs and compare their motion; see :class:`Difference`."""
    one, track = _planned(first, machine, dialect, callbacks)
    if not one.ok:
        return Difference((one,))
    other, beside = _planned(second, machine, dialect, callbacks)
    if not other.ok:
        return Difference((one, other))
    apart = farthest(track, beside)
    places = _place(track, apart.a, one), _place(beside, apart.b, other)
    return Difference(
        (one, other),
        apart.distance,
        dict(zip(machine.axes, apart.place.tolist(), strict=True)),
        places,
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
