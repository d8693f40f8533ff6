"""Steps of threads: against a second computation, and one thread against LinuxCNC's interpreter."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.gcode.core.cycle_runner import Cut, Rapid, SetOverrides, Step, Synchronise, TurnSpindle
from cnc.gcode.turning.threads import (
    MOST_PASSES,
    ThreadSteps,
    cut,
    depths,
    passes,
    tap_rigidly,
)
from tests.support.soak import share

PLAIN = ThreadSteps(start=5, end=-20, drive=20, height=0, pitch=1.5, peak=-1, first=0.2, full=0.8)


def thread(**words: float | bool) -> ThreadSteps:
    values = {name: getattr(PLAIN, name) for name in ThreadSteps.__slots__}
    return ThreadSteps(**{**values, **words})  # type: ignore[arg-type]


def test_a_thread_of_equal_depths_pass_by_pass() -> None:
    """Drive line at x 20, peak 1 inside of it, four passes of 0.2 mm; the pass moves out by what is
    left to cut.
    """
    found = list(cut(PLAIN, 10.0))
    expected: list[Step] = [SetOverrides(overrides=False, spindle=False)]
    for bottom, away in ((18.8, 20.6), (18.6, 20.4), (18.4, 20.2), (18.2, 20.0)):
        expected += [
            Rapid((5, away, 0)),
            Rapid((5, bottom, 0)),
            Synchronise(1.5),
            Cut((-20, bottom, 0), 15.0),
            Synchronise(0.0),
        ]
        expected += [Rapid((-20, away, 0))]
    expected.append(SetOverrides(overrides=True, spindle=False))
    assert len(found) == len(expected)
    for got, want in zip(found, expected, strict=True):
        assert type(got) is type(want)
        if isinstance(got, Rapid | Cut):
            assert got.to == pytest.approx(want.to, abs=1e-12)  # type: ignore[union-attr]
        else:
            assert got == want


def test_compound_slide_and_both_tapers() -> None:
    """Figures that rs274 of LinuxCNC 2.9 prints for G76 P1.5 Z-20 I-1 J0.2 K0.8 R1.5 Q29.5 H1 E2 L3
    from X20 Z5, first and second pass.
    """
    found = list(
        cut(thread(degression=1.5, angle=29.5, springs=1, taper=2, entry=True, exit=True), 10.0)
    )
    figures: list[tuple[type[Step], float, float]] = [
        (Rapid, 20.6, 4.8868),
        (Synchronise, 1.615549, 0),
        (Cut, 19.6, 4.8868),
        (Cut, 18.8, 2.8868),
        (Synchronise, 1.5, 0),
        (Cut, 18.8, -17.6605),
        (Synchronise, 1.615549, 0),
        (Cut, 19.6, -19.6605),
        (Synchronise, 0, 0),
        (Rapid, 20.6, -19.6605),
        (Rapid, 20.4825, 4.8204),
        (Synchronise, 1.615549, 0),
        (Cut, 19.4825, 4.8204),
    ]
    for step, (kind, x, z) in zip(found[1:], figures, strict=False):
        assert type(step) is kind
        if isinstance(step, Synchronise):
            assert step.pitch == pytest.approx(x, abs=1e-6)
        elif isinstance(step, Rapid | Cut):
            assert step.to == pytest.approx((z, x, 0.0), abs=5.1e-5)
    moves = [step.to for step in found if isinstance(step, Rapid | Cut)]
    assert moves[-1] == (-20, 20, 0)
    assert len(moves) == 9 * 6


def test_an_internal_thread_is_the_mirror_image() -> None:
    outer = [step for step in cut(PLAIN, 1.0) if isinstance(step, Rapid | Cut)]
    inner = [step for step in cut(thread(peak=1), 1.0) if isinstance(step, Rapid | Cut)]
    for a, b in zip(outer, inner, strict=True):
        assert b.to == pytest.approx((a.to[0], 40 - a.to[1], a.to[2]))


@pytest.mark.parametrize(("degression", "count"), [(1.0, 4), (1.5, 8), (2.0, 16), (2.5, 32)])
def test_rounding_does_not_change_the_number_of_passes(degression: float, count: int) -> None:
    """0.2 mm of 0.8 mm: 4 ** degression passes."""
    assert passes(thread(degression=degression)) == count


def test_too_many_passes_are_not_counted() -> None:
    assert passes(thread(degression=1e6)) == MOST_PASSES + 1
    assert passes(thread(first=1e-9)) == MOST_PASSES + 1


threads = st.builds(
    lambda first, more, degression, angle, springs, taper, entry, exit, peak, start, length: thread(
        first=first,
        full=first * more,
        degression=degression,
        angle=angle,
        springs=springs,
        taper=taper if entry or exit else 0.0,
        entry=entry,
        exit=exit,
        peak=peak,
        start=start,
        end=start + length,
    ),
    st.floats(0.01, 1),
    st.floats(1, 8),
    st.floats(1, 3),
    st.floats(0, 45),
    st.integers(0, 3),
    st.floats(0.1, 2),
    st.booleans(),
    st.booleans(),
    st.sampled_from([-2.0, -0.1, 0.1, 2.0]),
    st.floats(-50, 50),
    st.sampled_from([-60.0, -30.0, 30.0, 60.0]),
)


@settings(max_examples=share(5000, 30), deadline=None)
@given(threads)
def test_depths_by_summation(case: ThreadSteps) -> None:
    """depth ** degression grows by first ** degression a pass: the meaning of degression (2: area),
    added up.
    """
    taken, found = 0.0, []
    while True:
        taken += case.first**case.degression
        depth = taken ** (1 / case.degression)
        if depth >= case.full * (1 - 1e-9):
            break
        found.append(depth)
    expected = found + [case.full] * (1 + case.springs)
    assert list(depths(case)) == pytest.approx(expected, rel=1e-9)


@settings(max_examples=share(5000, 30), deadline=None)
@given(threads)
def test_every_pass_keeps_the_pitch_along_z(case: ThreadSteps) -> None:
    """z moves pitch a turn wherever the tool cuts along the thread, so that no pass leaves the
    groove; the stroke is always the same.
    """
    speed, synchronised, place = 5.0, 0.0, (case.start, case.drive, case.height)
    inward = math.copysign(1.0, case.peak)
    for step in cut(case, speed):
        if isinstance(step, Synchronise):
            synchronised = step.pitch
        elif isinstance(step, Cut):
            assert step.feed == pytest.approx(synchronised * speed)
            dz, dx = step.to[0] - place[0], step.to[1] - place[1]
            if dz:
                turns = math.hypot(dz, dx) / synchronised
                assert abs(dz) / turns == pytest.approx(case.pitch, rel=1e-9)
            # Beyond the drive line, and never deeper than the whole thread.
            assert inward * (step.to[1] - case.drive) <= abs(case.peak) + case.full + 1e-9
        if isinstance(step, Rapid):
            assert synchronised == 0.0
        if isinstance(step, Rapid | Cut):
            place = step.to
    assert place == (case.end, case.drive, case.height)


def test_rigid_tapping_returns_faster_in_reverse() -> None:
    assert list(tap_rigidly((0, 0, 3), (0, 0, -1), 2.0, 10.0, "cw", 1.5)) == [
        Synchronise(2.0),
        Cut((0, 0, -1), 20.0),
        TurnSpindle("ccw", 1.5),
        Cut((0, 0, 3), 30.0),
        TurnSpindle("cw"),
        Synchronise(0.0),
    ]
