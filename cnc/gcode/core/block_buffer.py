"""Buffer of the canonical blocks of a program; straight moves gather into polylines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain, compress, islice, zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.core.modal_groups import Diverted, lasting_state
from cnc.gcode.reader.words import Word
from cnc.model.blocks import (
    ArcFeed,
    Block,
    BoardCommand,
    NurbsFeed,
    Orient,
    Polyline,
    Probe,
    Spindle,
    Stop,
    Tool,
    WaitInput,
    polylines_of,
)
from cnc.model.diagnostics import Diagnostic, Fix
from cnc.model.motion_commands import Commands, command_array, goes_with_motion

# Place of the current line in the program text, for blocks, warnings and errors.

Warn = Callable[[Diagnostic], None]


@dataclass(slots=True)
class SourceLocation:
    """The file, the line (from 1), and access to the text and the words of a line."""

    file: str
    warn: Warn | None
    line: int = 0
    text_of: Callable[[int], str] = lambda line: ""
    words_of: Callable[[int], tuple[Word, ...]] = lambda line: ()

    @property
    def text(self) -> str:
        """The text of the line."""
        return self.text_of(self.line)

    def report_warning(
        self, code: str, message: str, word: Word, hint: str = "", fix: Fix | None = None
    ) -> None:
        """Report a legal but unusual word of the line, with its repair."""
        if self.warn:
            self.warn(
                Diagnostic(code, message, *self._place(word), hint, severity="warning", fix=fix)
            )

    def report_note(
        self, code: str, message: str, word: Word, hint: str = "", fix: Fix | None = None
    ) -> None:
        """Report a word that does no harm and has no effect, with its repair."""
        if self.warn:
            self.warn(Diagnostic(code, message, *self._place(word), hint, severity="note", fix=fix))

    def _place(self, word: Word) -> tuple[str, int, int, int, str]:
        """Return file, line, column and length of a word, and the text of its line."""
        return self.file, self.line, word.column, word.length, self.text


def without_word(word: Word, text: str) -> Fix:
    """Return the repair that removes a word without effect, with the blanks before or behind it."""
    begin, end = word.column - 1, word.column - 1 + word.length
    if before := text[:begin].rstrip(" \t"):
        begin = len(before)
    else:
        end = len(text) - len(text[end:].lstrip(" \t"))
    return Fix.replace(f"remove {word.written}", begin + 1, end - begin, safe=True)


MAX_MOVES = 4096
"""Most moves of a Polyline. Arrays of this length are efficient, and the first pulse does not wait
long for them.
"""

Question = Probe | WaitInput | BoardCommand
TakeAnswer = Callable[[tuple[float, ...]], None]
"""Processes an answer of the board."""


MapMove = Callable[[list[float] | ArcFeed, float], Iterator[tuple[list[float], float]]]
"""Makes positions and feeds from the end of a straight move, or an arc, and its feed."""
_Piece = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]
"""Points, feeds and lines of straight moves that are kept as arrays, before the single moves."""


class BlockBuffer:
    """Blocks of a program in order.

    Attributes:
        ready: Blocks that are complete, in groups. Each group can be taken once: many blocks are
            made while they are taken, so that they never need memory at once. The caller empties
            the list.
        unanswered: Blocks whose answers are processed before the next line is executed.
        defer: Takes each block that is not a move, instead of ``ready``, if it must follow a move
            that is not complete.
        in_effect: The values that the last blocks gave to each state that lasts, such as the
            spindle. A block with the same values is left out.
        map_move: Makes the moves of the axes from a straight move or an arc of a virtual axis; None
            without polar coordinate and cylindrical interpolation.
        asked: Whether the board was ever asked.
        assumed: Whether an expected answer was used because there was no board to answer.
    """

    def __init__(self, here: SourceLocation, axes: int) -> None:
        self.ready: list[Iterable[Block]] = []
        self.unanswered: list[tuple[Question, TakeAnswer]] = []
        self.defer: Callable[[Block], None] | None = None
        self.map_move: MapMove | None = None
        self.asked = self.assumed = False
        self._here = here
        self._axes = axes
        self._points: list[float] = []
        self._feeds: list[float] = []
        self._lines: list[int] = []
        self._pieces: list[_Piece] = []
        self._held, self._timed, self._turning = 0, False, ""
        self._commands: dict[int, tuple[Block, ...]] = {}
        self._many_commands: list[tuple[NDArray[np.intp], Commands]] = []
        self.in_effect: dict[tuple[str, int], tuple[object, ...]] = {}

    def move(self, end: list[float], feed: float, line: int) -> None:
        """Add a straight move at ``feed`` mm/s; NaN for a traverse."""
        if self.map_move is not None:
            for place, rate in self.map_move(end, feed):
                self._add_move(place, rate, line)
            return
        self._add_move(end, feed, line)

    def _add_move(self, end: list[float], feed: float, line: int) -> None:
        self._points += end
        self._feeds.append(feed)
        self._lines.append(line)
        if self._held + len(self._feeds) >= MAX_MOVES:
            self.flush()

    def moves(
        self, points: NDArray[np.float64], feeds: NDArray[np.float64], lines: NDArray[np.int32]
    ) -> None:
        """Add straight moves as arrays, with the same result as one after the other.

        Args:
            points: (n, axes) machine positions. The arrays are kept, not copied.
            feeds: (n,) mm/s; NaN for a traverse.
            lines: (n,) source lines.
        """
        if self._feeds:
            self._pack()
        begin, count = 0, len(feeds)
        while count - begin >= MAX_MOVES - self._held:
            end = begin + MAX_MOVES - self._held
            self._pieces.append((points[begin:end], feeds[begin:end], lines[begin:end]))
            self._held = MAX_MOVES
            self.flush()
            begin = end
        if count > begin:
            self._pieces.append((points[begin:], feeds[begin:], lines[begin:]))
            self._held += count - begin

    def mixed(
        self,
        points: NDArray[np.float64],
        feeds: NDArray[np.float64],
        lines: NDArray[np.int32],
        places: NDArray[np.intp],
        made: Callable[[NDArray[np.intp]], Iterator[Block]],
        spindle: NDArray[np.bool_],
    ) -> None:
        """Add straight moves with other blocks among them, none of which is left out.

        Args:
            points: As of :meth:`moves`, with an unused row for each of the blocks.
            feeds: Likewise.
            lines: Likewise.
            places: Rows of the other blocks, ascending. There is at least one.
            made: Makes the blocks of some of these rows.
            spindle: Flags of those that are of the spindle; the others do not go with the motion.
        """
        if not spindle.any():
            self._interleaved(points, feeds, lines, places, made(places))
            return
        blocks = list(made(places))
        straight = np.ones(len(feeds), np.bool_)
        straight[places] = False
        carried = self._carried(straight, places, blocks, spindle)
        firsts = np.flatnonzero(carried)
        # Numbers of the blocks before each command that are none.
        groups, begins = np.unique(firsts - np.arange(len(firsts)), return_index=True)
        ends = np.append(places[~carried], len(feeds)).tolist()
        row = block = 0
        for group, first, count in zip(
            groups.tolist(),
            firsts[begins].tolist(),
            np.diff(begins, append=len(firsts)).tolist(),
            strict=True,
        ):
            begin, end = ends[group - 1] + 1 if group else 0, ends[group]
            if begin > row:
                part = slice(row, begin)
                before = slice(block, first)
                moves = points[part], feeds[part], lines[part]
                self._interleaved(*moves, places[before] - row, iter(blocks[before]))
            row, block = end, first + count
            part = slice(begin, end)
            some = straight[part]
            at = places[first:block] - begin - np.arange(count)
            moves = points[part][some], feeds[part][some], lines[part][some]
            self._moves_with_commands(*moves, at, blocks[first:block])
        if row < len(feeds):
            moves = points[row:], feeds[row:], lines[row:]
            self._interleaved(*moves, places[block:] - row, iter(blocks[block:]))

    def _carried(
        self,
        straight: NDArray[np.bool_],
        places: NDArray[np.intp],
        blocks: list[Block],
        spindle: NDArray[np.bool_],
    ) -> NDArray[np.bool_]:
        """Return which blocks a polyline carries; arguments as of :meth:`mixed`.

        A command is carried if a move is before it, with nothing but such commands between.

        Args:
            straight: Flags of the rows that are straight moves.
            places: Rows of the other blocks.
            blocks: The other blocks.
            spindle: Flags of those that are of the spindle.
        """
        carried = spindle.copy()
        carried[spindle] = self._go_with_moves(
            [block for block in compress(blocks, spindle.tolist()) if isinstance(block, Spindle)]
        )
        if carried.any():
            kept = np.arange(len(straight))
            kept[places[carried]] = -1
            before = np.maximum.accumulate(kept)[places]
            carried &= np.where(before < 0, bool(self._held or self._feeds), straight[before])
        return carried

    def _go_with_moves(self, blocks: list[Spindle]) -> list[bool]:
        """Return which blocks of the spindle a polyline can carry, and note the spindle's state."""
        before = self._turning
        states: list[str] = [block.state for block in blocks]
        if states.count(before) == len(states):
            return [True] * len(states)
        self._turning = states[-1]
        return [
            block.with_motion or block.state == state
            for block, state in zip(blocks, (before, *states), strict=False)
        ]

    def _moves_with_commands(
        self,
        points: NDArray[np.float64],
        feeds: NDArray[np.float64],
        lines: NDArray[np.int32],
        at: NDArray[np.intp],
        commands: list[Block],
    ) -> None:
        """Add straight moves, and commands each with the number of these moves before it."""
        if self._feeds:
            self._pack()
        begin = first = 0
        while begin < len(feeds) or first < len(at):
            held, end = self._held, min(begin + MAX_MOVES - self._held, len(feeds))
            last = int(np.searchsorted(at, end))
            self._note_commands(at[first:last] - begin + held, commands[first:last])
            part = slice(begin, end)
            self.moves(points[part], feeds[part], lines[part])
            begin, first = end, last
            last = int(np.searchsorted(at, end, side="right"))
            for command in commands[first:last]:
                self._carry(command)
            first = last

    def _carry(self, command: Block) -> None:
        """Add a command that goes with the moves. Without a move before it, it stands alone."""
        place = self._held + len(self._feeds)
        if place:
            self._commands[place] = (*self._commands.get(place, ()), command)
        else:
            self.ready.append((command,))

    def _note_commands(self, places: NDArray[np.intp], commands: list[Block]) -> None:
        """Note the commands of moves that follow, by their places in the polyline."""
        if len(places) and places[0] not in self._commands and np.diff(places).all():
            singles = np.fromiter(zip(commands, strict=True), np.object_, len(commands))
            self._many_commands.append((places, singles))
            return
        for place, command in zip(places.tolist(), commands, strict=True):
            self._commands[place] = (*self._commands.get(place, ()), command)

    def _interleaved(
        self,
        points: NDArray[np.float64],
        feeds: NDArray[np.float64],
        lines: NDArray[np.int32],
        places: NDArray[np.intp],
        blocks: Iterator[Block],
    ) -> None:
        """Add moves and blocks that no polyline carries; ``blocks`` are those at ``places``."""
        begins, ends = places[:-1] + 1, places[1:]
        for k in np.flatnonzero(ends - begins > MAX_MOVES)[:1].tolist():
            cut = int(begins[k])
            for rows, some, at in (
                (slice(cut), islice(blocks, k + 1), places[: k + 1]),
                (slice(cut, None), blocks, places[k + 1 :] - cut),
            ):
                self._interleaved(points[rows], feeds[rows], lines[rows], at, some)
            return
        first, last = int(places[0]), int(places[-1])
        if first:
            self.moves(points[:first], feeds[:first], lines[:first])
        self.flush()
        moved = ends > begins
        if moved.any():
            runs = begins[moved].tolist(), ends[moved].tolist()
            polylines = polylines_of(self._here.file, (points, feeds, lines), *runs)
            between = (next(polylines) if moves else None for moves in moved.tolist())
            self.ready.append(filter(None, chain.from_iterable(zip_longest(blocks, between))))
        else:
            self.ready.append(blocks)
        if last + 1 < len(feeds):
            self.moves(points[last + 1 :], feeds[last + 1 :], lines[last + 1 :])

    def add(self, block: Block) -> None:
        """Add any other block, unless it changes nothing."""
        if not self._changes(block):
            return
        if self.defer is None:
            self.put(block)
        else:
            self.defer(block)

    def place(self, end: list[float], feed: float, line: int, file: str) -> None:
        """Add a straight move that may stand in another file than the current line."""
        if file == self._here.file or self.map_move is not None:
            self.move(end, feed, line)
            return
        self.flush()
        points, feeds, lines = np.array([end]), np.array([feed]), np.array([line], dtype=np.int32)
        self.ready.append((Polyline(file, line, points, feeds, lines, timed=self._timed),))

    def put(self, block: Block) -> None:
        """Add any other block directly after the moves."""
        if self.map_move is not None and isinstance(block, ArcFeed):
            for place, rate in self.map_move(block, block.feed):
                self._add_move(place, rate, block.line)
            return
        if isinstance(block, Spindle):
            carried = self._go_with_moves([block])[0]
        else:
            carried = goes_with_motion(block)
        if carried:
            self._carry(block)
            return
        self.flush()
        if self._timed and isinstance(block, ArcFeed | NurbsFeed):
            block = replace(block, timed=True)
        self.ready.append((block,))

    def set_timed(self, on: bool) -> None:
        """State whether the moves from here on take the time of their F (G93)."""
        if on != self._timed:
            self.flush()
            self._timed = on

    def ask(self, block: Question, take: TakeAnswer) -> None:
        """Add a block that the board answers.

        ``take`` gets the answer before the next line is executed.
        """
        self.add(block)
        self.asked = True
        self.unanswered.append((block, take))

    def take_answers(self) -> None:
        """Process the answers to all open questions; the expected answer where there is none."""
        for block, take in self.unanswered:
            values = block.answer.values
            self.assumed = self.assumed or values is None
            take(block.expected if values is None else values)
        self.unanswered.clear()

    def divert(self) -> Diverted:
        """Keep back the blocks that are added until :meth:`restore`."""
        self.flush()
        kept = Diverted(self.ready, self.in_effect.copy(), self._turning)
        self.ready = []
        return kept

    def restore(self, kept: Diverted) -> list[Block]:
        """Return the blocks since :meth:`divert`; what is in effect is as before."""
        self.flush()
        blocks = list(chain.from_iterable(self.ready))
        self.ready, self.in_effect, self._turning = kept
        return blocks

    @contextmanager
    def captured(self) -> Iterator[list[Block]]:
        """Take the blocks that are added meanwhile; the list has them at the end."""
        blocks: list[Block] = []
        kept = self.divert()
        try:
            yield blocks
        finally:
            blocks += self.restore(kept)

    def flush(self) -> None:
        """Complete the current run of straight moves."""
        if self._feeds:
            self._pack()
        if not self._pieces:
            return
        if len(self._pieces) == 1:
            points, feeds, lines = self._pieces[0]
        else:
            points = np.concatenate([piece[0] for piece in self._pieces])
            feeds = np.concatenate([piece[1] for piece in self._pieces])
            lines = np.concatenate([piece[2] for piece in self._pieces])
        behind = self._commands.pop(self._held, ()) if self._commands else ()
        commands = command_array(self._held, self._commands, self._many_commands)
        moves = Polyline(
            self._here.file, int(lines[0]), points, feeds, lines, commands, self._timed
        )
        self.ready.append((moves, *behind))
        self._pieces, self._held, self._commands, self._many_commands = [], 0, {}, []

    def _pack(self) -> None:
        """Turn the single moves into arrays."""
        self._pieces.append(
            (
                np.array(self._points, dtype=np.float64).reshape(-1, self._axes),
                np.array(self._feeds, dtype=np.float64),
                np.array(self._lines, dtype=np.int32),
            )
        )
        self._held += len(self._feeds)
        self._points, self._feeds, self._lines = [], [], []

    def _changes(self, block: Block) -> bool:
        """Return whether a block changes a state that is known from an earlier block."""
        if isinstance(block, Tool | Orient | BoardCommand | Stop):
            # Spindle and outputs may have another state afterwards. At a stop the operator may
            # have switched the spindle off by hand, and the next move would cut without it.
            self.in_effect.clear()
        state = lasting_state(block)
        if state is None:
            return True
        kind, values = state
        before = self.in_effect.get(kind)
        self.in_effect[kind] = values
        return before != values


# Notes on F, S and T words without effect.
#
# A word has no effect if another one replaces it, or the program ends, before a move or a code uses
# it.

_USE = {"F": "a feed move", "S": "a start of the spindle", "T": "a tool change (M6)"}
"""The use of the word of each letter."""


class _Given(NamedTuple):
    file: str
    line: int
    text: str
    word: Word


class UnusedWords:
    """The unused words by letter. Nothing is recorded without a receiver of warnings."""

    def __init__(self, here: SourceLocation) -> None:
        self.words: dict[str, _Given] = {}
        self._here = here
        self.enabled = here.warn is not None

    def note(self, word: Word, line: int | None = None, text: str | None = None) -> None:
        """Record a word that sets F, S or T, in the current line if no other is given."""
        if not self.enabled:
            return
        here = self._here
        at = here.line if line is None else line
        before = self.words.get(word.letter)
        if before is not None:
            if before.word.number == word.number:
                return
            if (before.file, before.line) != (here.file, at):
                message = (
                    f"{before.word.written} has no effect: {word.written} in line {at} replaces it "
                    f"before {_USE[word.letter]}"
                )
                self._report(
                    "word-shadowed",
                    before,
                    message,
                    "remove one of the two words, or insert the code that uses the first",
                )
        self.words[word.letter] = _Given(here.file, at, here.text if text is None else text, word)

    def mark_used(self, letter: str) -> None:
        """Remove the word of a letter, which has been used."""
        self.words.pop(letter, None)

    def end(self) -> None:
        """Report the unused words at the program end. A T word may be for the next program."""
        for letter in "FS":
            if given := self.words.pop(letter, None):
                message = (
                    f"{given.word.written} has no effect: the program ends before {_USE[letter]}"
                )
                fix = without_word(given.word, given.text)
                self._report("word-without-effect", given, message, "remove it", fix)

    def _report(
        self, code: str, given: _Given, message: str, hint: str, fix: Fix | None = None
    ) -> None:
        assert self._here.warn is not None
        word = given.word
        self._here.warn(
            Diagnostic(
                code,
                message,
                given.file,
                given.line,
                word.column,
                word.length,
                given.text,
                hint,
                severity="note",
                fix=fix,
            )
        )
