"""The builder: order, stops, chunks, gaps, tiny moves, errors, speed and memory."""

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest

from cnc.model.blocks import Dwell, End, Message, NurbsFeed, PathMode, Polyline, Probe, Spindle
from cnc.model.diagnostics import GcodeError
from cnc.path.block_pieces import MOST_NUMBERS, MOST_PIECES
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import ARC, LINE, SPAN
from tests.support.path.path_cases import XYZ, arc, ends, evaluate, lines, random_nurbs, whole
from tests.support.soak import share
from tests.support.work import at_most

ORIGIN = np.zeros(3)
EXACT_STOP = PathMode("part.nc", 1, "exact-stop")
EXACT_PATH = PathMode("part.nc", 1, "exact-path")
DWELL = Dwell("part.nc", 9, 0.5)
MESSAGE = Message("part.nc", 9, "look")


def built(*blocks, start=ORIGIN):
    return list(build(iter(blocks), axes=XYZ, start=np.array(start, float)))


def stops(items):
    return [
        list(item.stop_after) if isinstance(item, PathChunk) else type(item).__name__
        for item in items
    ]


def test_one_chunk_of_everything():
    spline = random_nurbs(np.random.default_rng(1), 3, 6)
    spline.control_points[0] = [0.0, 10, 0]
    chunk = whole(
        [
            lines([[10, 0, 0]], np.nan),
            arc([0, 10, 0], (0, 0), 0.25),
            spline,
            lines([[1, 1, 1]], 5.0, line=8),
        ],
        ORIGIN,
    )
    assert list(chunk.kind) == [LINE, ARC, SPAN, SPAN, SPAN, LINE]
    assert list(chunk.line) == [1, 3, 7, 7, 7, 8]
    assert np.isnan(chunk.feed[0]) and list(chunk.feed[1:]) == [10, 10, 10, 10, 5]
    assert list(chunk.stop_after) == [False] * 5 + [True]
    assert chunk.axes == XYZ and chunk.file == "part.nc"
    assert (
        chunk.line.dtype == np.int32
        and chunk.stop_after.dtype == np.bool_
        and chunk.kind.dtype == chunk.at.dtype == np.int64
    )
    for k in range(len(chunk) - 1):
        assert np.array_equal(
            evaluate(chunk, k, ends(chunk, k)[1])[0],
            evaluate(chunk, k + 1, ends(chunk, k + 1)[0])[0],
        )


@pytest.mark.parametrize(
    ("blocks", "expected"),
    [
        ([lines([[1, 0, 0], [2, 0, 0]])], [[False, True]]),
        ([lines([[1, 0, 0]]), DWELL, lines([[2, 0, 0]])], [[True], "Dwell", [True]]),
        ([lines([[1, 0, 0]]), MESSAGE, lines([[2, 0, 0]])], [[False], "Message", [True]]),
        (
            [lines([[1, 0, 0]]), MESSAGE, DWELL, lines([[2, 0, 0]])],
            [[True], "Message", "Dwell", [True]],
        ),
        ([lines([[1, 0, 0]]), MESSAGE, MESSAGE], [[True], "Message", "Message"]),
        ([MESSAGE, lines([[1, 0, 0]]), EXACT_PATH, lines([[2, 0, 0]])], ["Message", [False, True]]),
        (
            [EXACT_STOP, lines([[1, 0, 0], [2, 0, 0]]), EXACT_PATH, lines([[3, 0, 0], [4, 0, 0]])],
            [[True, True, False, True]],
        ),
        (
            [EXACT_STOP, arc([20, 0, 0], (10, 0), 1.5), EXACT_PATH, lines([[3, 0, 0]])],
            [[False, True, True]],
        ),
        ([DWELL, DWELL], ["Dwell", "Dwell"]),
        ([lines([[1, 0, 0]]), lines([[1, 0, 0]]), DWELL], [[True], "Dwell"]),
        (
            [
                lines([[1, 0, 0]]),
                PathMode("part.nc", 2, "blend", 0.1),
                Spindle("part.nc", 3, "cw", 100.0),
            ],
            [[True], "Spindle"],
        ),
        ([], []),
    ],
)
def test_order_and_stops(blocks, expected):
    assert stops(built(*blocks)) == expected


def probe(end, line=5):
    return Probe("part.nc", line, np.array(end, float), 2.0, True, True)


def test_a_probe_rests_at_both_ends():
    items = built(lines([[1, 0, 0]]), probe([1, 0, -5]), lines([[2, 0, 0]]))
    assert stops(items) == [[True], "Probe", [True], [True]]
    assert items[2].feed.tolist() == [2.0] and items[2].line.tolist() == [5]
    assert evaluate(items[3], 0, ends(items[3], 0)[0])[0].tolist() == [1, 0, -5]


def test_behind_a_probe_nothing_is_read_before_it_was_made():
    read = []

    def program():
        for block in (probe([0, 0, -5]), lines([[2, 0, 0]])):
            read.append(block)
            yield block

    stream = build(program(), axes=XYZ, start=ORIGIN)
    asked = next(stream)
    move = next(stream)
    assert len(read) == 1 and isinstance(move, PathChunk)
    asked.answer.values = (1.0, 0.0, 0.0, -3.0)
    (after,) = stream
    assert evaluate(after, 0, ends(after, 0)[0])[0].tolist() == [0, 0, -3]


def blend(tolerance=0.0):
    return PathMode("part.nc", 1, "blend", tolerance)


@pytest.mark.parametrize(
    ("blocks", "expected"),
    [
        ([lines([[50, 0, 0], [200, 0, 0]])], [0, 0]),
        ([blend(0.1), lines([[50, 0, 0], [50, 50, 0], [0, 50, 0]])], [0.1, 0.1, 0]),
        ([blend(), lines([[50, 0, 0], [50, 50, 0]])], [0.02, 0]),
        ([blend(0.1), lines([[50, 0, 0]]), EXACT_PATH, lines([[50, 50, 0]])], [0, 0]),
        ([lines([[50, 0, 0]]), blend(0.1), lines([[50, 50, 0], [0, 50, 0]])], [0, 0.1, 0]),
        (
            [
                blend(0.1),
                lines([[50, 0, 0]]),
                blend(0.05),
                lines([[50, 50, 0]]),
                blend(0.2),
                lines([[0, 50, 0]]),
            ],
            [0.05, 0.05, 0],
        ),
        ([blend(0.1), lines([[50, 0, 0]]), EXACT_STOP, lines([[50, 50, 0]])], [0, 0]),
        (
            [
                blend(0.1),
                lines([[50, 0, 0], [50, 50, 0]]),
                DWELL,
                lines([[0, 50, 0], [0, 0, 0]]),
            ],
            [0.1, 0, 0.1, 0],
        ),
        ([blend(0.1), lines([[50, 0, 0]]), MESSAGE, lines([[50, 50, 0]])], [0.1, 0]),
        (
            [blend(0.1), lines([[50, 0, 0]]), MESSAGE, blend(0.05), lines([[50, 50, 0]])],
            [0.05, 0],
        ),
        (
            [
                blend(0.1),
                lines([[50, 0, 0]]),
                probe([50, 50, 0]),
                lines([[0, 50, 0], [0, 0, 0]]),
            ],
            [0, 0, 0.1, 0],
        ),
        (
            [
                blend(0.1),
                arc([0, 2, 0], (0, 1), 0.5),
                lines([[-1, 2, 0]], np.nan),
                lines([[-1, 3, 0]]),
            ],
            [0.1, 0.1, 0],
        ),
    ],
)
def test_tolerance_of_joints(blocks, expected):
    items = build(iter(blocks), axes=XYZ, start=ORIGIN, tolerance=0.02)
    found = np.concatenate([item.tolerance for item in items if isinstance(item, PathChunk)])
    assert found.tolist() == expected


def test_an_exact_stop_is_no_stop_between_spans():
    block = random_nurbs(np.random.default_rng(1), 3, 7)
    items = built(EXACT_STOP, block, EXACT_PATH, lines([[1, 1, 1]]), start=block.control_points[0])
    assert stops(items) == [[False, False, False, True, True]]


def test_files_are_kept_apart():
    first, second = lines([[1, 0, 0]]), lines([[2, 0, 0]])
    other = Polyline("sub.nc", 4, second.points, second.feeds, second.lines)
    items = built(first, other, first)
    assert [item.file for item in items] == ["part.nc", "sub.nc", "part.nc"]
    assert stops(items) == [[False], [False], [True]]


def test_chunks_are_bounded_and_whole():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(3 * MOST_PIECES + 17, 3)).cumsum(axis=0)
    items = built(lines(points))
    assert max(len(c) for c in items) <= MOST_PIECES and sum(len(c) for c in items) == len(points)
    assert sum(c.stop_after.sum() for c in items) == 1 and items[-1].stop_after[-1]
    assert np.array_equal(np.concatenate([c.line for c in items]), np.arange(1, len(points) + 1))
    long = random_nurbs(rng, 3, 3000)
    items = built(long, start=long.control_points[0])
    assert len(items) > 1 and sum(len(c) for c in items) >= 2997
    assert max(len(c.data) for c in items) < 3 * MOST_NUMBERS
    for before, after in pairwise(items):
        last = evaluate(before, len(before) - 1, ends(before, len(before) - 1)[1])[0]
        assert np.array_equal(last, evaluate(after, 0, ends(after, 0)[0])[0])


def test_a_chunk_leaves_before_the_stream_ends():
    """The builder holds back one chunk at most."""
    read = 0

    def stream():
        nonlocal read
        for k in range(100):
            read = k
            yield lines([[i + 1000.0 * k + 1, 0, 0] for i in range(1000)])

    chunks = build(stream(), axes=XYZ, start=ORIGIN)
    next(chunks)
    assert read <= 2 * (MOST_PIECES // 1000 + 1)


def test_moves_of_no_length_vanish():
    items = built(
        EXACT_STOP, lines([[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 1e-12, 0], [2, 0, 0], [2, 0, 0]])
    )
    assert [len(item) for item in items] == [2]
    assert list(items[0].line) == [2, 5]
    assert np.array_equal(evaluate(items[0], 1, ends(items[0], 1)[0])[0], [1, 0, 0])
    assert built(lines([[0, 0, 0]]), arc([0, 0, 0], (0, 0), 1.0)) == []


def test_tiny_moves_add_up():
    """3000 moves of 0.4 pm: each is dropped, but their sum remains."""
    items = built(lines(np.outer(np.arange(1, 3001) * 4e-10, [1, 0, 0])))
    assert evaluate(items[-1], len(items[-1]) - 1, ends(items[-1], len(items[-1]) - 1)[1])[0][
        0
    ] == pytest.approx(1.2e-6, abs=1e-9)
    assert sum(c.length.sum() for c in items) == pytest.approx(1.2e-6, abs=1e-9)
    assert all((c.length > 1e-9).all() for c in items)


def test_the_linear_axis_counts_only_if_it_moves_noticeably():
    axes = ("x", "y", "z", "a")
    chunk = whole([lines([[1e-8, 0, 0, 90.0], [1e-8 + 2e-9, 0, 0, 90.0]])], np.zeros(4), axes)
    assert chunk.length == pytest.approx([90.0, 2e-9], rel=1e-6)


def test_an_arc_without_a_radius_is_a_line():
    chunk = whole([arc([0, 0, 5], (0, 0), 1.0)], ORIGIN)
    assert list(chunk.kind) == [LINE] and chunk.length[0] == 5.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_finite(bad):
    spline = random_nurbs(np.random.default_rng(1), 2, 4)
    broken = NurbsFeed(
        "part.nc", 7, 2, spline.knots, spline.control_points, np.array([1, bad, 1, 1.0]), 1.0
    )
    for block, line in [
        (lines([[0, 0, 1], [0, bad, 0], [0, 0, 2]], line=4), 5),
        (lines([[0, 0, 1], [0, 0, 2]], [1.0, -np.inf], line=4), 5),
        (arc([0, 10, bad], (0, 0), 0.25), 3),
        (arc([0, 10, 0], (0, bad), 0.25), 3),
        (arc([0, 10, 0], (0, 0), bad), 3),
        (broken, 7),
    ]:
        with pytest.raises(GcodeError) as error:
            built(lines([[1, 1, 1]]), block)
        found = error.value.diagnostic
        assert (found.code, found.file, found.line) == ("not-finite", "part.nc", line)


def test_a_nurbs_must_not_jump():
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 0, 0], [6, 1, 0], [7, 0, 0]], float)
    knots = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2.0])
    with pytest.raises(GcodeError) as error:
        built(NurbsFeed("part.nc", 7, 2, knots, points, np.ones(6), 1.0))
    assert (
        error.value.diagnostic.code == "nurbs-not-continuous" and error.value.diagnostic.line == 7
    )
    assert "3 mm" in error.value.diagnostic.message
    points[3] = points[2]
    chunk = whole([NurbsFeed("part.nc", 7, 2, knots, points, np.ones(6), 1.0)], ORIGIN)
    assert len(chunk) == 2 and chunk.length[0] == pytest.approx(2.0)


def test_a_nurbs_starts_where_the_motion_is():
    spline = random_nurbs(np.random.default_rng(1), 2, 4)
    near = spline.control_points[0] + [1e-8, 0, 0]
    chunk = whole([spline], near)
    assert np.array_equal(evaluate(chunk, 0, ends(chunk, 0)[0])[0], near)
    with pytest.raises(GcodeError) as error:
        built(spline)
    assert error.value.diagnostic.code == "nurbs-start"


def test_calls_and_memory_of_a_finishing_program():
    """Memory does not grow with the program, and ten moves do not take a call of a function."""

    def program(count):
        rng = np.random.default_rng(1)
        at = np.zeros(3)
        for first in range(0, count, MOST_PIECES):
            points = at + rng.normal(scale=0.1, size=(MOST_PIECES, 3)).cumsum(axis=0)
            at = points[-1]
            yield Polyline(
                "part.nc",
                first,
                points,
                np.full(MOST_PIECES, 25.0),
                np.arange(first, first + MOST_PIECES, dtype=np.int32),
            )
        yield End("part.nc", count)

    count = share(4_000_000, 400_000)
    with at_most(calls=count // 10):
        pieces = sum(
            len(item)
            for item in build(program(count), axes=XYZ, start=ORIGIN)
            if isinstance(item, PathChunk)
        )
    assert pieces >= count
    tracemalloc.start()
    for _ in build(program(100_000), axes=XYZ, start=ORIGIN):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6
