"""Segments: moves come out in order and on time for any path, in few bytes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.boards.stepper.kernels import segment_encoder, segments
from cnc.boards.stepper.segments import ROWS, SegmentEncoder, command, split
from cnc.model.streams import PulseChunk
from tests.support.boards.segment_decoder import SegmentDecoder
from tests.support.boards.segment_player import moves
from tests.support.soak import share


def chunk(time_ns, step):
    return PulseChunk(
        np.asarray(time_ns, np.int64), np.asarray(step, np.int8), np.zeros(len(time_ns), np.int32)
    )


def encoded(time_ns, step, *, tolerance_ns=2000, spacing_ns=0, cuts=(), flushes=()):
    encoder = SegmentEncoder(step.shape[1], tolerance_ns, spacing_ns)
    parts = []
    for i, (a, b) in enumerate(zip((0, *cuts), (*cuts, len(time_ns)), strict=True)):
        parts.append(encoder.push(chunk(time_ns[a:b], step[a:b])))
        if i in flushes:
            parts.append(encoder.flush())
    parts.append(encoder.flush(end=True))
    return b"".join(parts), encoder.delay_ns


def played(data, axes):
    parts = list(SegmentDecoder(axes).play(data))
    return np.concatenate([time for time, _ in parts]), np.concatenate([step for _, step in parts])


def when_due(time_ns, spacing_ns):
    """Return the times of the moves: as requested, or the least spacing after the move before."""
    spacing_ns = -(-spacing_ns // 500) * 500
    due, last = [], 0
    for each in time_ns:
        last = max(last + spacing_ns, int(each))
        due.append(last)
    return np.array(due)


def check(time_ns, step, *, tolerance_ns=2000, spacing_ns=0, cuts=(), flushes=()):
    """Check order, times and lengths of segments; return the bytes for each move."""
    data, put_off = encoded(
        time_ns, step, tolerance_ns=tolerance_ns, spacing_ns=spacing_ns, cuts=cuts, flushes=flushes
    )
    time, again = played(data, step.shape[1])
    np.testing.assert_array_equal(again, step)
    due = when_due(time_ns, spacing_ns)
    assert np.abs(time - due).max() <= tolerance_ns
    assert put_off == (due - time_ns).max()
    assert np.diff(time, prepend=0).min() >= spacing_ns
    single = list(split(data))
    assert b"".join(single) == data
    assert [bool(each[1] & segments.END) for each in single] == [False] * (len(single) - 1) + [True]
    return len(data) / len(step)


# ----------------------------------------------------------------------
# paths


def cutting(counts):
    """Return a line that makes a move where an axis crosses a half-grid line.

    Axes that cross at one place share the move. Places are 0 to 1.
    """
    places, which = [], []
    for axis, count in enumerate(counts):
        places.append((np.arange(abs(count)) + 0.5) / max(abs(count), 1))
        which.append(np.full(abs(count), axis))
    all_places, axes = np.concatenate(places), np.concatenate(which)
    unique, row = np.unique(np.round(all_places, 12), return_inverse=True)
    step = np.zeros((len(unique), len(counts)), np.int8)
    step[row, axes] = np.sign(np.array(counts))[axes]
    return unique, step


def fastest_leads(counts):
    """Return a line whose fastest axis steps in each move."""
    most = max(abs(count) for count in counts)
    k = np.arange(most + 1)[:, None]
    step = np.diff(np.floor(k * np.abs(counts) / most + 0.5), axis=0) * np.sign(counts)
    return (np.arange(most) + 1.0) / most, step.astype(np.int8)


def circle(radius, turns, per_axis=(1.0, 1.0)):
    """Return a circle by its crossings with half-grid lines; radius in steps."""
    angles, which, signs = [], [], []
    for axis, scale in enumerate(per_axis):
        most = int(np.floor(radius * scale - 0.5))
        lines = np.arange(-most - 1, most + 1) + 0.5
        once = np.arccos(lines / (radius * scale))
        for turn in range(int(np.ceil(turns)) + 1):
            for angle, sign in ((once, -1), (2 * np.pi - once, 1)):
                at = angle + 2 * np.pi * turn + 0.5 * np.pi * axis
                angles.append(at - 2 * np.pi * (axis == 1))
                which.append(np.full(len(at), axis))
                signs.append(np.full(len(at), sign))
    all_angles, axes, sign = np.concatenate(angles), np.concatenate(which), np.concatenate(signs)
    inside = (all_angles > 0.0) & (all_angles < 2 * np.pi * turns)
    unique, row = np.unique(np.round(all_angles[inside], 10), return_inverse=True)
    step = np.zeros((len(unique), 2), np.int8)
    step[row, axes[inside]] = sign[inside]
    return unique / (2 * np.pi * turns), step


def smooth_time(place, duration_s):
    """Return times from rest to rest, an S-curve of degree 5, ns."""
    t = np.linspace(0.0, 1.0, 100_001)
    return np.round(
        np.interp(place, t**3 * (10 - 15 * t + 6 * t * t), t) * duration_s * 1e9
    ).astype(np.int64)


PATHS = {
    "one axis": (fastest_leads((9000,)), 0.06),
    "three axes, the fastest leads": (fastest_leads((9000, -6300, 2700)), 0.12),
    "four axes, the fastest leads": (fastest_leads((6000, 5100, -2900, 1777)), 0.62),
    "a plane line, where it crosses": (cutting((6000, 4274)), 0.07),
    "a line with shared crossings": (cutting((5000, -3000)), 0.07),
    "a line in space, where it crosses": (cutting((4000, 2801, -1207)), 0.12),
    "a diagonal and a third axis": (cutting((4000, 4000, 844)), 0.10),
    "a large circle": (circle(2000, 0.5), 0.45),
    "an ellipse on a grid of its own an axis": (circle(800, 1, (1.0, 0.37)), 0.7),
}


@pytest.mark.parametrize("name", PATHS)
def test_steady_paths_need_few_bytes(name):
    (place, step), most = PATHS[name]
    assert check(np.round(place * len(place) / 10_000 * 1e9).astype(np.int64), step) <= most


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("rate", [2_000, 40_000])
def test_from_rest_to_rest(name, rate):
    (place, step), _ = PATHS[name]
    assert check(smooth_time(place, 1.9 * len(place) / rate), step) <= 1.2


def test_three_turns_at_five_thousand_moves_a_second():
    place, step = circle(600, 3)
    assert check(smooth_time(place, len(place) / 5_000), step) <= 0.95


# ----------------------------------------------------------------------
# anything

MASKS = st.integers(1, 15)
GAPS = st.one_of(
    st.just(0),
    st.integers(0, 3_000),
    st.integers(3_000, 200_000),
    st.integers(200_000, 40_000_000),
    st.integers(40_000_000, 20_000_000_000),
)


@st.composite
def runs(draw):
    """Generate moves of 4 axes: runs with a pattern, a steadily changing interval and their own
    directions, and random moves.
    """
    steps, gaps = [], []
    for _ in range(draw(st.integers(1, 6))):
        down = draw(st.integers(0, 15))
        pattern = draw(st.lists(MASKS, min_size=1, max_size=7))
        count = draw(st.integers(1, 300))
        gap, more = draw(GAPS), draw(st.integers(-50, 50))
        noise = draw(st.sampled_from([0, 0, 400, 3_000, 50_000]))
        random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
        k = np.arange(count)
        gaps.append(np.maximum(gap + more * k + random.integers(-noise, noise + 1, count), 0))
        mask = np.array(pattern)[k % len(pattern)]
        bits = mask[:, None] >> np.arange(4) & 1
        steps.append(bits * np.where(down >> np.arange(4) & 1, -1, 1))
    return np.cumsum(np.concatenate(gaps)), np.concatenate(steps).astype(np.int8)


@settings(max_examples=share(1500, 10), deadline=None)
@given(
    runs(),
    st.sampled_from([500, 1000, 2000, 10_000]),
    st.sampled_from([0, 0, 500, 10_000, 25_001]),
    st.data(),
)
def test_random_moves_are_reproduced(run, tolerance_ns, spacing_ns, data):
    time_ns, step = run
    cuts = (
        tuple(sorted(data.draw(st.lists(st.integers(1, len(step) - 1), max_size=3, unique=True))))
        if len(step) > 1
        else ()
    )
    check(time_ns, step, tolerance_ns=tolerance_ns, spacing_ns=spacing_ns, cuts=cuts)


@settings(max_examples=share(300, 8), deadline=None)
@given(runs())
def test_documented_format_plays_the_same_moves(run):
    time_ns, step = run
    data, _ = encoded(time_ns, step)
    time, again = played(data, 4)
    bits = 1 << np.arange(4)
    expected = zip(time // 500, (again != 0) @ bits, (again < 0) @ bits, strict=True)
    assert moves(data) == [tuple(int(each) for each in row) for row in expected]


@settings(max_examples=share(300, 7), deadline=None)
@given(
    st.lists(st.integers(-400, 400), min_size=2, max_size=4), st.floats(0.005, 3.0), st.booleans()
)
def test_lines_of_any_slope(counts, duration_s, lead):
    if any(counts):
        place, step = (fastest_leads if lead else cutting)(counts)
        check(smooth_time(place, duration_s), step)


HOUR = 3600 * 10**9
"""In ns."""


def test_pauses_of_hours():
    time_ns = np.cumsum(
        np.array(
            [0, 1, 32_767_500, 32_768_000, 40_000_000, 3 * HOUR, 1, share(168, 24) * HOUR],
            np.int64,
        )
    )
    check(time_ns, np.ones((len(time_ns), 1), np.int8))


def test_simultaneous_moves_are_spaced():
    step = np.eye(4, dtype=np.int8)[np.arange(400) % 4]
    check(np.full(400, 10**6), step)
    check(np.full(400, 10**6), step, spacing_ns=20_000)


def test_moves_after_hours_are_on_time():
    start = 30 * 3600 * 10**9
    place, step = cutting((700, 300))
    check(start + smooth_time(place, 0.2), step)


def test_flushed_moves_do_not_wait():
    place, step = cutting((700, 300))
    time_ns = smooth_time(place, 0.2)
    encoder = SegmentEncoder(2)
    sent = encoder.push(chunk(time_ns[:100], step[:100]))
    assert sent == b"" and encoder.waiting == 100
    sent = encoder.flush()
    assert encoder.waiting == 0
    assert len(played(sent, 2)[0]) == 100
    check(time_ns, step, cuts=(100, 500), flushes=(0,))


def test_memory_is_bounded():
    encoder, decoder = SegmentEncoder(3), SegmentDecoder(3)
    place, step = fastest_leads((100_000, 70_123, 31_111))
    time_ns = np.round(place * 10 * 1e9).astype(np.int64)
    rows, origin = 0, 0
    for _ in range(share(200, 4)):
        data = encoder.push(chunk(origin + time_ns, step))
        origin += int(time_ns[-1])
        assert encoder.waiting <= segment_encoder.LOOK_AHEAD
        for time, _ in decoder.play(data):
            assert len(time) <= ROWS
            rows += len(time)
    rows += sum(len(time) for time, _ in decoder.play(encoder.flush(end=True)))
    assert rows == share(200, 4) * len(step)


# ----------------------------------------------------------------------
# bad input


@pytest.mark.parametrize(
    "bad",
    [
        b"\x00\x00\x00\x00\x01\x00\x00\x01",  # no slot
        b"\x03\x18\x00\x00",  # a command cut off
        b"\x01\x00\x00\x00\x01\x00\x00",  # cut off
        b"\x01\x00\x00\x00\x01\x00\x00\x11\x00\x00\x00\x00\x00\x01\x00\x00",  # in both masks
        b"\x01\x00\x00\x00\x01\x00\x00\xe1" + bytes(24),  # three phases
        b"\x01\x00\x00\x00\x01\x00\x00\x10\x00\x00\x00\x00\x00\x01\x00\x00",  # no leading axis
        b"\x02\x03\x01\x10\x01",  # a timed move too few
        b"\x01",
    ],
)
def test_invalid_segments_are_refused(bad):
    good = b"\x01\x00\x00\x00\x01\x00\x00\x01"
    assert list(split(good)) == [good]
    for take in (lambda data: list(split(data)), lambda data: list(SegmentDecoder(4).play(data))):
        with pytest.raises(ValueError, match="No segment begins at byte 8"):
            take(good + bad)


@pytest.mark.parametrize("arguments", [(0,), (5,), (3, 499), (3, 2000, -1), (3, 2000, 16_384_000)])
def test_invalid_encoder_arguments_are_refused(arguments):
    with pytest.raises(ValueError):
        SegmentEncoder(*arguments)


def test_commands_between_segments_take_no_time():
    segment = b"\x02\x00\x00\x64\x00\x00\x00\x01"
    items = [command(1, 3, 200), segment, command(0), segment, command(2, 16, 0, end=True)]
    data = b"".join(items)
    assert list(split(data)) == items
    assert items[0] == b"\x02\x18\x03\xc8"
    time, step = played(data, 2)
    assert time.tolist() == [50_000, 100_000, 150_000, 200_000]
    assert step.tolist() == [[1, 0]] * 4


@given(
    st.lists(st.tuples(st.integers(1, 10**10), st.integers(0, 3 * 10**9)), min_size=1, max_size=5)
)
def test_pauses_end_on_time(gaps):
    """Each pause between moves ends within a tick of its time."""
    encoder, decoder = SegmentEncoder(1), SegmentDecoder(1)
    at, due, parts = 0, [], []
    for gap, idle in gaps:
        at += gap
        due.append(at)
        parts += [encoder.push(chunk([at], [[1]])), encoder.idle(at + idle)]
        at += idle
        assert at - 2500 <= encoder.clock_ns <= at + 2500
    times = [time for each in parts if each for time, _ in decoder.play(each)]
    assert np.abs(np.concatenate(times) - due).max() <= 2500
