"""How long the sender of lines sleeps while answers of a GRBL board gather. No I/O.

A wake-up costs the computer more than a line. The board meanwhile reads the lines that wait in its
buffer. A wire that brings lines more slowly than the board reads them is not left idle: no answers
gather, and the first answer after a long move is served at once. A report makes answers late:
behind it, more lines are answered than is known.
"""

from __future__ import annotations

from cnc.boards.grbl.unanswered import UnansweredLines
from cnc.boards.grbl.wire_time import WireTime

GATHERING = 0.5
"""Part of the time of the unanswered lines but one in which answers gather. The rest covers the way
of the answers to this computer, and its late wake-ups. One line may wait for space.
"""
SLOWER_THAN_WIRE = 1.3
"""Time between answers, in times of a line on the wire, above which the board takes longer for a
line than the wire. Answers gather only there.
"""
FEW_ARRIVED = 2.5
"""Unanswered lines that have arrived at such a board. Fewer are not enough to let answers gather.
"""
LONGEST = 0.02
"""Limit on that time, s."""
SHORTEST = 0.002
"""Time below which waiting is not worth its while, s."""
SPARE = 0.0015
"""Time before the wire is idle at which waiting ends, s; the mean lateness of wake-ups is added.
A single late wake-up, which a busy computer has now and then, says nothing about the next.
"""
LATE_WEIGHT = 0.3
"""Weight of the last wake-up in that mean."""
BEHIND_REPORT = 0.8
"""Share of the gathering while answers may wait behind a report or the answer to a mark."""
REPORT = 40
"""Fewest bytes of these."""


class AnswerGathering:
    """Follows the sleeps of one stream.

    Args:
        wire: The wire to the board.
    """

    def __init__(self, wire: WireTime) -> None:
        self._wire = wire
        self._asked = False
        self._late = 0.0

    def pause(
        self, lines: UnansweredLines, interval: float, partial: bytes, now: float, *, asked: bool
    ) -> float:
        """Return the time to sleep before the next look at the answers, s; 0 for none.

        Args:
            lines: The unanswered lines.
            interval: Average time between two answers, s.
            partial: Bytes of a message that has not ended yet.
            now: Present time, s.
            asked: Whether a report or the answer to a mark is expected.
        """
        behind, self._asked = asked or self._asked, asked
        if interval >= LONGEST:
            return 0.0
        wire, waiting = self._wire, lines.count
        busy = max(wire.idle_from - now, 0.0)
        # As long as the wire is busy, lines that are sent now would only wait for it.
        pause = busy - SPARE - self._late
        if waiting:
            on_one_line = wire.byte_time * lines.bytes / waiting
            slow = interval > SLOWER_THAN_WIRE * on_one_line
            if slow and busy <= (waiting - FEW_ARRIVED) * on_one_line:
                part = BEHIND_REPORT * GATHERING if behind else GATHERING
                pause = max(pause, part * (waiting - 1) * interval)
        if behind and partial[:1] in (b"<", b"["):
            # No answer comes before the end of the message.
            pause = max(pause, wire.byte_time * (REPORT - len(partial)))
        return min(pause, LONGEST) if pause >= SHORTEST else 0.0

    def woken(self, late: float) -> None:
        """Note by which time a sleep has ended late, s."""
        self._late += LATE_WEIGHT * (late - self._late)
