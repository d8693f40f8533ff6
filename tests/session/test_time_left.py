"""The reported time until the end, against the simulated time of a GRBL board."""

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
from cnc.machine.load import load_machine
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.firmware_profile import settings_of
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.session.runs import run_with
from tests.support.soak import share

ROUTER = load_machine("grbl-uno")
HELD = 7.0
"""Duration of a hold, s."""
SETTLING = 5.0
"""Time after a request until the estimate has settled, s: overrides change in steps of 10 %."""
BLIND = 0.6
"""Delay of a report, s: reports come at 5 Hz, and the first and last of them wait for the board."""


@dataclass
class Operated:
    """A run with requests of an operator.

    Attributes:
        requests: The request at each number of a report.
        feed: Feed override at the beginning, per cent.
        settings: Settings of the board.
        reported: Time of each report, the reported time left, and the duration of holds so far, s.
        changes: Times of the requests, s.
    """

    requests: dict[int, str]
    feed: float = 100.0
    settings: dict[int, float] = field(default_factory=dict)
    reported: list[tuple[float, float, float]] = field(default_factory=list)
    changes: list[float] = field(default_factory=list)

    def run(self, program: Path) -> None:
        simulator = GrblSimulator(settings=settings_of(ROUTER) | self.settings)
        port = GrblSimulatorPort(simulator)
        board = GrblBoard(port, ROUTER, port.clock, "the simulator")
        board.connect()
        control, held_at, held, reports = Control(self.feed), 0.0, 0.0, 0

        def see(progress: Progress) -> None:
            nonlocal held_at, held, reports
            now = board.now()
            reports += 1
            if held_at and now - held_at > HELD:
                held, held_at = held + now - held_at, 0.0
                control.resume()
                self.changes.append(now)
            if progress.left is not None and not progress.held and progress.rows:
                self.reported.append((now, progress.left, held))
            request = self.requests.get(reports)
            if request is None:
                return
            self.changes.append(now)
            if request == "hold":
                control.hold()
                held_at = now
            elif request.startswith("feed"):
                control.override(float(request[4:]))
            else:
                board.stream.write(RealTime[request].value)

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
        self.end, self.held = simulator.moves[-1].end_time, held

    def worst(self, since: float = 0.0) -> float:
        """Return the largest error of settled reports since a time, relative to the duration."""
        whole = self.end - self.reported[0][0]
        quiet = [
            (now, left, self.end - now - (self.held - held))
            for now, left, held in self.reported
            if now >= since and not any(0.0 <= now - at < SETTLING for at in self.changes)
        ]
        assert quiet
        return max(max(abs(left - real) - BLIND, 0.0) / whole for _, left, real in quiet)


def jobs(seed: int) -> str:
    """Return a random program of straight moves, arcs and dwells, with and without exact stops."""
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
                f"G{rng.integers(2, 4)} X{a} Y{b} "
                f"R{np.hypot(a - x, b - y) * rng.uniform(0.6, 3.0):.3f} F{feed}"
            )
        elif kind < 0.33:
            lines.append(f"G4 P{rng.uniform(0.1, 3.0):.2f}")
            continue
        else:
            lines.append(f"G1 X{a} Y{b} F{feed}")
        x, y = a, b
    # The program ends with a motion, whose end the simulator records.
    return "\n".join([*lines, f"G1 X{x + 1.0} F600", "M2", ""])


REQUESTS = st.dictionaries(
    st.integers(5, 60),
    st.sampled_from(["hold", "feed50", "feed150", "feed80", "RAPID_25", "RAPID_50"]),
    max_size=2,
)


@settings(max_examples=share(150, 2))
@given(
    seed=st.integers(0, 10**6),
    requests=REQUESTS,
    feed=st.sampled_from([100.0, 100.0, 60.0, 180.0]),
    arcs=st.sampled_from([0.002, 0.02]),
)
def test_the_time_left_is_within_five_per_cent(seed, requests, feed, arcs, tmp_path_factory):
    """The error is within a twentieth of the duration, from the last request on."""
    program = tmp_path_factory.mktemp("left") / "p.nc"
    program.write_text(jobs(seed))
    operated = Operated(requests, feed, settings={11: 0.02, 12: arcs, 120: 180.0, 110: 1500.0})
    operated.run(program)
    last = max(operated.changes, default=0.0)
    # A motion that ends before the estimate has settled leaves nothing to compare.
    assume(operated.end - last > SETTLING + 1.0)
    assert operated.worst(last) <= 0.05


@pytest.mark.parametrize("rapid", ["RAPID_25", "RAPID_50"])
def test_a_rapid_override_at_the_board_changes_the_time_left(rapid, tmp_path):
    program = tmp_path / "p.nc"
    program.write_text("G21 G90\n" + "G0 X60\nG0 X0\n" * 20 + "M2\n")
    operated = Operated({3: rapid})
    operated.run(program)
    assert operated.worst() <= 0.03
