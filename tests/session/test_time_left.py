"""The time that is left, as it is told while a program runs, against the time that the board in the
box then takes, by its own clock.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cnc.api import Callbacks, Control
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.protocol import RealTime
from cnc.boards.grbl.simulator.from_machine import settings_of
from cnc.boards.grbl.simulator.grbl_simulator import GrblSimulator
from cnc.boards.grbl.simulator.ports import GrblSimulatorPort
from cnc.executor.run import Progress
from cnc.machine.load import load_machine
from tests.support.session.runs import run_with
from tests.support.soak import share

ROUTER = load_machine("grbl-uno")
HELD = 7.0
"""s."""
SETTLING = 5.0
"""s from a change until what is told is to be right again: overrides go by steps of ten per cent,
one a report, and GRBL tells them in every twentieth report at least (interface.md, "Ov").
"""
BLIND = 0.6
"""s by which what is told may be late: reports come five times a second, and the first and last of
them wait for the board.
"""


@dataclass
class Operated:
    """A run, and what was told during it: when, how much time is left, how long the motion had been
    held by then.

    Each wish is carried out at the report of its number. disturbed: when something was changed.
    """

    wishes: dict[int, str]
    feed: float = 100.0
    settings: dict[int, float] = field(default_factory=dict)
    told: list[tuple[float, float, float]] = field(default_factory=list)
    disturbed: list[float] = field(default_factory=list)

    def run(self, program: Path) -> None:
        box = GrblSimulator(settings=settings_of(ROUTER) | self.settings)
        port = GrblSimulatorPort(box)
        board = GrblBoard(port, ROUTER, port.clock, "the box")
        board.connect()
        control, held_at, held, reports = Control(self.feed), 0.0, 0.0, 0

        def see(progress: Progress) -> None:
            nonlocal held_at, held, reports
            now = board.now()
            reports += 1
            if held_at and now - held_at > HELD:
                held, held_at = held + now - held_at, 0.0
                control.resume()
                self.disturbed.append(now)
            if progress.left is not None and not progress.held and progress.rows:
                self.told.append((now, progress.left, held))
            wish = self.wishes.get(reports)
            if wish is None:
                return
            self.disturbed.append(now)
            if wish == "hold":
                control.hold()
                held_at = now
            elif wish.startswith("feed"):
                control.override(float(wish[4:]))
            else:
                board.real_time(RealTime[wish])

        report = run_with(
            program,
            ROUTER,
            board=board,
            control=control,
            callbacks=Callbacks(on_sent=see),
            dialect="linuxcnc",
        )
        board.close()
        assert report.ok, report.faults
        self.end, self.held = box.moves[-1].end_time, held

    def worst(self, since: float = 0.0) -> float:
        """The largest part of the whole time by which what was told was wrong, when all was
        quiet.
        """
        whole = self.end - self.told[0][0]
        quiet = [
            (now, left, self.end - now - (self.held - held))
            for now, left, held in self.told
            if now >= since and not any(0.0 <= now - at < SETTLING for at in self.disturbed)
        ]
        assert quiet
        return max(max(abs(left - real) - BLIND, 0.0) / whole for _, left, real in quiet)


def jobs(seed: int) -> str:
    """Straight moves long and short, arcs, dwells, with exact stops and without."""
    rng = np.random.default_rng(seed)
    lines, x, y = (
        ["G21 G90 G94 G17", str(rng.choice(["G61", "G64", "G61.1"])), "G0 X30 Y30"],
        30.0,
        30.0,
    )
    for _ in range(int(rng.integers(20, 80))):
        kind, reach = rng.random(), float(rng.choice([0.3, 3.0, 30.0]))
        a, b = np.round(
            np.clip([x + rng.uniform(-reach, reach), y + rng.uniform(-reach, reach)], 1.0, 60.0), 3
        )
        feed = round(float(10 ** rng.uniform(2.3, 3.3)))
        if kind < 0.15:
            lines.append(f"G0 X{a} Y{b}")
        elif kind < 0.3 and (a, b) != (x, y):
            lines.append(
                f"G{rng.integers(2, 4)} X{a} Y{b} R{np.hypot(a - x, b - y) * rng.uniform(0.6, 3.0):.3f} F{feed}"
            )
        elif kind < 0.33:
            lines.append(f"G4 P{rng.uniform(0.1, 3.0):.2f}")
            continue
        else:
            lines.append(f"G1 X{a} Y{b} F{feed}")
        x, y = a, b
    # the end that is looked for is that of the motion
    return "\n".join([*lines, f"G1 X{x + 1.0} F600", "M2", ""])


WISHES = st.dictionaries(
    st.integers(5, 60),
    st.sampled_from(["hold", "feed50", "feed150", "feed80", "RAPID_25", "RAPID_50"]),
    max_size=2,
)


@settings(max_examples=share(150, 6))
@given(
    seed=st.integers(0, 10**6),
    wishes=WISHES,
    feed=st.sampled_from([100.0, 100.0, 60.0, 180.0]),
    arcs=st.sampled_from([0.002, 0.02]),
)
def test_what_is_told_to_be_left_is_left(seed, wishes, feed, arcs, tmp_path_factory):
    """Within a twentieth of the whole, from the last change on."""
    program = tmp_path_factory.mktemp("left") / "p.nc"
    program.write_text(jobs(seed))
    operated = Operated(wishes, feed, settings={11: 0.02, 12: arcs, 120: 180.0, 110: 1500.0})
    operated.run(program)
    last = max(operated.disturbed, default=0.0)
    # A motion that ends before the estimate has settled leaves nothing to compare.
    assume(operated.end - last > SETTLING + 1.0)
    assert operated.worst(last) <= 0.05


@pytest.mark.parametrize("rapid", ["RAPID_25", "RAPID_50"])
def test_an_override_of_traverses_at_the_board_counts(rapid, tmp_path):
    program = tmp_path / "p.nc"
    program.write_text("G21 G90\n" + "G0 X60\nG0 X0\n" * 20 + "M2\n")
    operated = Operated({3: rapid})
    operated.run(program)
    assert operated.worst() <= 0.03
