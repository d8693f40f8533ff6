"""Steps of LinuxCNC's G70, G71 and G72, whose profile is a subroutine.

The line is executed twice: first it enters the subroutine, whose blocks are kept back. At the
return it makes the cycle with them. Commands of the subroutine besides moves have no effect.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from cnc.gcode.cycles.subroutine_profiles import SubroutineProfiles
from cnc.gcode.cycles.turning_cycles import TurningCycles
from cnc.gcode.cycles.turning_moves import TurningMoves
from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.subprograms import Call
from cnc.gcode.program.turning_profiles import ProfileCycle
from cnc.gcode.state.lasting_state import Diverted
from cnc.gcode.state.modal_groups import ModalState
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.statement import Control, Statement
from cnc.gcode.syntax.words import LineWords, whole
from cnc.model.blocks import ArcFeed, Block, Polyline

_CODES = {code.code: code for code in (G.G70, G.G71, G.G72)}
MAX_SUBROUTINE = 99_999


def subroutine_cycle(line: int, statement: Statement) -> SubroutineCycle | None:
    """Return the step of a line with G70, G71 or G72, and Q; None for another line."""
    if not any(word.letter == "Q" for word in statement.words):
        return None
    for word in statement.words:
        if word.letter == "G" and word.number in _CODES:
            return SubroutineCycle(line, statement, word, _CODES[word.number])
    return None


@dataclass(slots=True)
class OpenProfile:
    """A cycle whose subroutine is being executed.

    Attributes:
        line: The line of the cycle.
        depth: Number of calls around it.
        code: The cycle.
        words: Words of the cycle.
        modal: The modal state before.
        position: Machine position before.
        blocks: The blocks that are kept back.
    """

    line: int
    depth: int
    code: G
    words: LineWords
    modal: ModalState
    position: list[float]
    blocks: Diverted


class SubroutineCycle(ProfileCycle):
    """``G71 Q100 X.. Z.. D.. I.. R..`` and its like."""

    def run(self, flow: Flow, line: int) -> int:
        """Enter the subroutine, or make the cycle after its return."""
        profile = flow.profile
        if profile is None:
            return self._begin(flow, line)
        if profile.line != line or profile.depth != len(flow.frames):
            message = f"{self._word.written} within the profile of another cycle"
            raise self._fault("profile-line", message)
        self._end(flow, profile)
        return line + 1

    def _begin(self, flow: Flow, line: int) -> int:
        interpreter = flow.interpreter
        words, rest = self._sorted(flow)
        interpreter.execute(rest, line)
        cycles = self._cycles(flow)
        cycles.check(self._word)
        at = words.take("Q", self._word.written)
        assert at is not None
        label = str(whole(at, "the number of a subroutine", 0, MAX_SUBROUTINE))
        cycles.go_to_start(words, self._word)
        modal, position = replace(interpreter.modal), list(interpreter.motion.position)
        call = Call(flow, line, Control("call", label, (), at.column, at.length))
        first = call.run(flow, line)
        flow.frame.return_line = line
        depth = len(flow.frames) - 1
        blocks = interpreter.out.divert()
        flow.profile = OpenProfile(line, depth, self._code, words, modal, position, blocks)
        return first

    def _end(self, flow: Flow, profile: OpenProfile) -> None:
        interpreter = flow.interpreter
        flow.profile = None
        found = interpreter.out.restore(profile.blocks)
        for each in fields(profile.modal):
            setattr(interpreter.modal, each.name, getattr(profile.modal, each.name))
        interpreter.motion.position = profile.position
        interpreter.here.line = profile.line
        interpreter.update_plain()
        blocks: list[Block] = [block for block in found if isinstance(block, Polyline | ArcFeed)]
        if not blocks:
            raise self._fault("profile-empty", "the profile has no move")
        self._cycles(flow).make(self._code, profile.words, blocks, self._word)
        interpreter.update_plain()

    @staticmethod
    def _cycles(flow: Flow) -> SubroutineProfiles:
        return SubroutineProfiles(TurningCycles(TurningMoves(flow.interpreter.motion)))
