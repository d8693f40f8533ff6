"""The objects that the modules of codes share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cnc.gcode.core.block_buffer import BlockBuffer, SourceLocation, UnusedWords
from cnc.gcode.core.coordinates import Coordinates
from cnc.gcode.core.modal_groups import ModalState, ReadingPolicy
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.words import Word, fault
from cnc.model.blocks import Overrides, PathMode, SpindleSync


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
        follows: Whether the moves follow the spindle now.
    """

    dialect: Dialect
    policy: ReadingPolicy
    here: SourceLocation
    state: ModalState
    out: BlockBuffer
    parameters: Parameters
    coordinates: Coordinates
    unused_words: UnusedWords
    follows: bool = False
    _suspended: int = 0

    @contextmanager
    def exact_path(self) -> Iterator[None]:
        """Suspend G64: holes and threads need the exact path."""
        self._suspend_blending()
        yield
        self._resume_blending()

    def _suspend_blending(self) -> None:
        if self.state.path == "blend" and not self._suspended:
            self.out.add(PathMode(self.here.file, self.here.line, "exact-path"))
        self._suspended += 1

    def _resume_blending(self) -> None:
        self._suspended -= 1
        if self.state.path == "blend" and not self._suspended:
            mode = PathMode(self.here.file, self.here.line, "blend", self.state.tolerance)
            self.out.add(mode)

    def follow_spindle(self, pitch: float, angle: float = 0.0) -> None:
        """Begin moves that follow the spindle. Those that follow it already go on without a stop.

        Args:
            pitch: mm a turn along the first move.
            angle: Angle of the spindle at which it begins, degrees.
        """
        if not self.follows:
            self._suspend_blending()
            self.out.add(SpindleSync(self.here.file, self.here.line, pitch, angle))
            self.follows = True

    def end_follow(self) -> None:
        """End the moves that follow the spindle, if there are any."""
        if self.follows:
            self.out.add(SpindleSync(self.here.file, self.here.line, 0.0))
            self.follows = False
            self._resume_blending()

    def add_overrides(self, *, feed: bool = True, spindle: bool = True) -> None:
        """Add the overrides that the program allows, without those that a cycle disables."""
        state = self.state
        self.out.add(
            Overrides(
                self.here.file,
                self.here.line,
                state.feed_override and feed,
                state.speed_override and spindle,
                state.adaptive_feed,
                state.feed_stop,
            )
        )

    def spindle_speed(
        self, name: str, at: Word, *, use: str = "needs", start: str = "S and M3"
    ) -> float:
        """Return the speed of the spindle, which must turn: rpm, or mm/s under G96.

        Args:
            name: The code, for messages.
            at: Word at which errors are reported.
            use: What the code does with the spindle.
            start: The words that start the spindle.

        Raises:
            GcodeError: ``spindle-stopped``.
        """
        state = self.state
        if state.spindle == "off" or not state.speed:
            message = f"{name} {use} the spindle, which does not turn"
            raise fault("spindle-stopped", message, at, f"give {start} before")
        return state.speed if state.constant_surface else state.rpm


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
