"""Commands among the straight moves of a polyline."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.model.blocks import Dwell, Polyline, Spindle
from cnc.model.motion_commands import apart, command_array, rests


def power(line: int, *, laser: bool = False) -> Spindle:
    return Spindle("p", line, "cw", float(line), with_motion=laser)


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize("places", [(0,), (1,), (3,), (0, 1, 2, 3), (1, 3)])
def test_a_polyline_is_taken_apart_at_its_commands(places: tuple[int, ...], timed: bool) -> None:
    count = 4
    points, feeds = np.arange(3.0 * count).reshape(count, 3), np.arange(1.0, count + 1)
    lines = np.arange(10, 10 + count, dtype=np.int32)
    each = {place: (power(place + 1), power(place + 2)) for place in places}
    commands = command_array(count, each)
    blocks = [Dwell("p", 1, 1.0), Polyline("p", 10, points, feeds, lines, commands, timed)]
    found = list(apart(blocks))
    assert found.pop(0) is blocks[0]
    move = 0
    while found:
        if move in each:
            assert tuple(found[:2]) == each.pop(move)
            del found[:2]
        part = found.pop(0)
        assert isinstance(part, Polyline)
        end = move + len(part.points)
        assert end == min((place for place in each if place > move), default=count)
        assert part.points.tolist() == points[move:end].tolist()
        assert part.feeds.tolist() == feeds[move:end].tolist()
        assert part.lines.tolist() == lines[move:end].tolist()
        assert (part.file, part.line, part.timed) == ("p", lines[move], timed)
        assert part.commands is None
        move = end
    assert move == count
    assert not each


def test_the_motion_rests_at_a_speed_of_a_spindle() -> None:
    lasers = (power(1, laser=True), power(2, laser=True))
    commands = command_array(3, {1: lasers})
    assert commands is not None
    assert not rests(commands)
    commands[2] = (*lasers, power(3))
    assert rests(commands)
