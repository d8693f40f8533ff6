"""The objects that the modules of codes share."""

from __future__ import annotations

from dataclasses import dataclass

from cnc.gcode.core.block_buffer import BlockBuffer, SourceLocation, UnusedWords
from cnc.gcode.core.coordinates import Coordinates
from cnc.gcode.core.modal_groups import ModalState, ReadingPolicy
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.parameters import Parameters


@dataclass(slots=True)
class Context:
    """The objects that the modules of codes share.

    Attributes:
        dialect: The dialect of the program.
        policy: Choices of the user.
        here: The place in the program.
        state: The modal state. A saved state comes into effect when it is put here.
        out: Takes the blocks.
        parameters: The parameters of the program.
        coordinates: The coordinate systems.
        unused_words: Collects words without effect.
    """

    dialect: Dialect
    policy: ReadingPolicy
    here: SourceLocation
    state: ModalState
    out: BlockBuffer
    parameters: Parameters
    coordinates: Coordinates
    unused_words: UnusedWords


class Executor:
    """A module of codes."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._dialect, self._policy = context.dialect, context.policy
        self._here, self._out = context.here, context.out
        self._parameters, self._coordinates = context.parameters, context.coordinates
        self._unused_words = context.unused_words

    @property
    def _state(self) -> ModalState:
        return self.context.state
