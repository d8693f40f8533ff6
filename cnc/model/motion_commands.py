"""Commands among straight moves: new speeds of the spindle (S), laser power and outputs.

A row of moves carries them in an array of objects: entry k is the tuple of commands that take
effect at the start of move k, else None. So a program with S on each line is one row, not a block
for each move and each S. Laser power and outputs go with the motion. At a new speed of a spindle
the motion rests, so a path is cut there: its pieces carry only commands that go with the motion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import AnalogOutput, Block, DigitalOutput, Polyline, Spindle, polylines_of

Commands = NDArray[np.object_]


def goes_with_motion(block: Block) -> bool:
    """Return whether a command takes effect in motion: M62, M63, M67, M68, S of a laser."""
    if isinstance(block, Spindle | DigitalOutput):
        return block.with_motion
    return isinstance(block, AnalogOutput)


def command_array(
    count: int,
    places: Mapping[int, tuple[Block, ...]],
    many: Sequence[tuple[NDArray[np.intp], Commands]] = (),
) -> Commands | None:
    """Return the array of moves with commands at some of them; None without any.

    Args:
        count: Number of moves.
        places: Commands by the number of their move.
        many: Numbers of further moves (k,), and the tuples of their commands (k,).
    """
    if not places and not many:
        return None
    commands = np.full(count, None, np.object_)
    for numbers, tuples in many:
        commands[numbers] = tuples
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


def rests(commands: Commands) -> bool:
    """Return whether the motion rests at one of the commands."""
    return not all(goes_with_motion(block) for k in places_of(commands) for block in commands[k])


def apart(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the blocks, with the commands of polylines as blocks of their own."""
    for block in blocks:
        if not isinstance(block, Polyline) or block.commands is None:
            yield block
            continue
        places = places_of(block.commands)
        begins = places if places[0] == 0 else [0, *places]
        moves = block.points, block.feeds, block.lines
        parts = polylines_of(
            block.file, moves, begins, [*begins[1:], len(block.points)], timed=block.timed
        )
        for begin, part in zip(begins, parts, strict=True):
            yield from block.commands[begin] or ()
            yield part
