"""What can be wrong with a GRBL board, in words: each a BoardError with its source line and what to
do about it.
"""

from __future__ import annotations

from collections.abc import Sequence

from cnc.boards.grbl.codes import alarm_meaning, error_meaning
from cnc.boards.protocols import board_error
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import BoardError, Diagnostic

CABLE = "see to a better cable (short, shielded, no hub); what was cut since may be wrong"
STOP_IT = "if the machine still moves, press its emergency stop; check the supply and the cable, then home it"
HOME_IT = "home the machine before the next run: its position is lost"
PROBE_ALARMS = (4, 5)


def refused(code: int, text: str, line: int, *, hal: bool) -> BoardError:
    """``error:code`` to a line."""
    meaning = error_meaning(code, hal=hal)
    return board_error(
        "board-error",
        f"the board refuses {text!r}, error:{code}: {meaning.what}",
        line=line,
        hint=meaning.advice,
    )


def alarmed(code: int, line: int, *, hal: bool, probing: bool = False) -> BoardError:
    """``ALARM:code``; ``probing``: while a probe was under way."""
    meaning = alarm_meaning(code, hal=hal)
    name = "probe-no-contact" if probing and code in PROBE_ALARMS else "board-alarm"
    return board_error(
        name, f"the board stopped with ALARM:{code}: {meaning.what}", line=line, hint=meaning.advice
    )


def alarmed_unheard(line: int) -> BoardError:
    """A board that is in alarm, and whose message of it got lost."""
    hint = "look at its switches and at what it shows; home the machine before the next run"
    return board_error(
        "board-alarm",
        "the board is in alarm; the message why got lost on the way",
        line=line,
        hint=hint,
    )


def restarted(line: int) -> BoardError:
    """A welcome that nobody asked for."""
    return board_error(
        "board-restarted",
        "the board has restarted by itself",
        line=line,
        hint=f"was it its reset button, or its supply? {HOME_IT}",
    )


def locked(line: int) -> BoardError:
    """An alarm from before."""
    hint = "home the machine with cncrun home or a program that begins with $H, or unlock the board with $X if its position is right"
    return board_error("board-locked", "the board is locked by an alarm", line=line, hint=hint)


def lost(after: int, until: int) -> BoardError:
    """Answers do not match the lines."""
    where = f"between line {after} and line {until}" if after < until else f"near line {until}"
    return board_error(
        "reply-lost",
        f"a line or its answer got lost on the way to or from the board, {where}",
        line=until,
        hint=CABLE,
    )


def question_lost(line: int) -> BoardError:
    """Bytes behind a line that was answered."""
    message = f"the board took line {line}, but does not answer a question behind it: bytes got lost on the way"
    return board_error("reply-lost", message, line=line, hint=CABLE)


def unanswered(line: int) -> BoardError:
    """A board at rest that owes an answer."""
    message = f"the board is at rest and has not answered line {line}: it, or its answer, got lost on the way"
    return board_error("reply-missing", message, line=line, hint=CABLE)


def stuck(seconds: float, line: int) -> BoardError:
    """A board that says Run and does not move."""
    hint = "look at the machine, then switch the board off and on"
    return board_error(
        "board-stuck",
        f"the board says that it runs, but has not moved for {seconds:g} s",
        line=line,
        hint=hint,
    )


def off_path(position: Sequence[float], off: float, line: int) -> BoardError:
    """A board where no line leads."""
    message = f"the board is at {shown(position)}, {off:.3g} mm off its way: bytes of line {line}, or of one soon after, got lost"
    return board_error("off-path", message, line=line, hint=CABLE)


def elsewhere(position: Sequence[float], off: float, line: int) -> BoardError:
    """A board at rest, and not at the end of its way."""
    message = f"the board stands at {shown(position)}, {off:.3g} mm from where line {line} leads: bytes got lost"
    return board_error("position-differs", message, line=line, hint=CABLE)


def silent(name: str) -> BoardError:
    """No answer to ``?``."""
    return board_error(
        "board-silent", f"the board at {name} does not answer any more", hint=STOP_IT
    )


def not_stopped(name: str) -> BoardError:
    """No welcome after a reset."""
    return board_error(
        "board-silent", f"the board at {name} does not confirm that it has stopped", hint=STOP_IT
    )


def followed_by(first: BoardError, second: BoardError) -> BoardError:
    """Two faults in one: what came of the first counts for what to do."""
    one, two = first.diagnostic, second.diagnostic
    return type(first)(
        Diagnostic(one.code, f"{one.message}; then: {two.message}", line=one.line, hint=two.hint)
    )


def shown(position: Sequence[float]) -> str:
    """``X1.000 Y2.000 Z0.000``."""
    return " ".join(
        f"{letter.upper()}{value:.3f}"
        for letter, value in zip(AXIS_LETTERS, position, strict=False)
    )
