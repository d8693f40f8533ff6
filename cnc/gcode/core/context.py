"""What the modules of codes share: the dialect, the place, the modal state, the blocks."""

from __future__ import annotations

from typing import NamedTuple

from cnc.gcode.core.block_buffer import BlockBuffer, SourceLocation, UnusedWords
from cnc.gcode.core.modal_groups import ModalState
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.parameters import Parameters


class Context(NamedTuple):
    """What the modules of codes share.

    Attributes:
        dialect: The dialect of the program.
        here: The place in the program.
        state: The modal state.
        out: Takes the blocks.
        parameters: The parameters of the program.
        unused_words: Collects words without effect.
    """

    dialect: Dialect
    here: SourceLocation
    state: ModalState
    out: BlockBuffer
    parameters: Parameters
    unused_words: UnusedWords


class Executor:
    """A module of codes."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._dialect, self._here, self._state = context.dialect, context.here, context.state
        self._out, self._parameters = context.out, context.parameters
        self._unused_words = context.unused_words
