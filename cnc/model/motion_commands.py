"""Commands that go with the motion: laser power (S) and outputs, at their place on the path.

The motion does not rest at such a command. A row of moves or pieces carries them in an array of
objects: entry k is the tuple of commands that take effect at the start of move k, else None.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import AnalogOutput, Block, DigitalOutput, Polyline, Spindle

Commands = NDArray[np.object_]


def goes_with_motion(block: Block) -> bool:
    """Return whether a command takes effect in motion: M62, M63, M67, M68, S of a laser."""
    if isinstance(block, Spindle | DigitalOutput):
        return block.with_motion
    return isinstance(block, AnalogOutput)


def command_array(count: int, places: Mapping[int, tuple[Block, ...]]) -> Commands | None:
    """Return the array of ``count`` moves with commands at some of them; None without any."""
    if not places:
        return None
    commands = np.full(count, None, np.object_)
    for place, blocks in places.items():
        commands[place] = blocks
    return commands


def places_of(commands: Commands | None) -> list[int]:
    """Return the moves that carry commands."""
    if commands is None:
        return []
    # Tuples of commands are true.
    return np.flatnonzero(commands.astype(np.bool_)).tolist()


def carried_over(
    commands: Commands | None, origin: NDArray[np.integer]
) -> tuple[Commands | None, tuple[Block, ...]]:
    """Return the commands of moves that were made of others.

    Args:
        commands: Commands of the original moves.
        origin: Number of the original move of each new one, ascending.

    Returns:
        The commands of the new moves. Those of a move without a successor of its own go to the next
        one; the second value has those behind the last.
    """
    places: dict[int, tuple[Block, ...]] = {}
    assert commands is not None
    numbers = places_of(commands)
    for place, number in zip(np.searchsorted(origin, numbers).tolist(), numbers, strict=True):
        places[place] = places.get(place, ()) + commands[number]
    behind = places.pop(len(origin), ())
    return command_array(len(origin), places), behind


def joined(parts: Iterable[tuple[Commands | None, int]]) -> Commands | None:
    """Return the commands of parts in a row; each with its number of moves."""
    listed = list(parts)
    if all(commands is None for commands, _ in listed):
        return None
    return np.concatenate(
        [
            np.full(count, None, np.object_) if commands is None else commands
            for commands, count in listed
        ]
    )


def apart(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the blocks, with the commands of polylines as blocks of their own."""
    for block in blocks:
        if not isinstance(block, Polyline) or block.commands is None:
            yield block
            continue
        first = 0
        for place in [*places_of(block.commands), len(block.points)]:
            if place > first:
                yield polyline_part(block, slice(first, place))
            if place < len(block.points):
                yield from block.commands[place]
            first = place


def polyline_part(block: Polyline, part: slice) -> Polyline:
    """Return some moves of a polyline, without commands."""
    return replace(
        block,
        line=int(block.lines[part][0]),
        points=block.points[part],
        feeds=block.feeds[part],
        lines=block.lines[part],
        commands=None,
    )
