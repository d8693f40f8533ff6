"""Feeds and units: F, G20, G21, G7 and G8.

Source: LinuxCNC, "Other codes", F; "G-codes", G20 G21 and G7 G8.
"""

from __future__ import annotations

from cnc.gcode.codes.motion import Motion, MotionCodes
from cnc.gcode.codes.turning import THREADS
from cnc.gcode.state.modal_groups import FEED_MODES, Code, Codes, check_feed, feed_of
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.statement import Remark
from cnc.gcode.syntax.words import LineWords, Word, fault
from cnc.model.units import MM_PER_INCH

_NO_FEED = (None, G.G0)


class FeedCodes(MotionCodes):
    """Execution of these words.

    Attributes:
        moving: Motion code of the line that is executed; None for a line without a move.
    """

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)
        self.moving: G | None = None
        self._feed_units_reported = False

    def mode(self, codes: Codes) -> None:
        """Execute G93, G94 or G95. Another mode than before needs a new F."""
        if code := codes.get("feed-mode"):
            mode = FEED_MODES[code.g]
            if mode != self._state.feed_mode:
                self._state.feed_mode, self._state.feed = mode, None
                self._unused_words.mark_used("F")
                self._motion.set_timed(mode == "inverse-time")

    def units(self, codes: Codes) -> None:
        """Execute G20, G21, G7 and G8."""
        state = self._state
        if (code := codes.get("units")) or "diameter" in codes:
            if code:
                state.scale = _scale(code)
                state.feed_scale = 1.0 if self._leaves_feeds(code) else state.scale
            self._parameters.increments = 1_000.0 if state.scale == 1.0 else 10_000.0
            if diameter := codes.get("diameter"):
                state.diameter = diameter.number == G.G7
            self._motion.units_changed()

    def diameters(self, at: Remark, *, is_lathe: bool) -> None:
        """Execute SINUMERIK's DIAMON, DIAMOF or DIAM90 (diameters under G90 only).

        Raises:
            GcodeError: ``code-not-supported``: diameters on another machine than a lathe.
        """
        state = self._state
        if at.text != "DIAMOF" and not is_lathe:
            word = Word(at.text, 0.0, at.text, at.column, at.length)
            message = f"{at.text} (X in diameters) is for a lathe"
            hint = 'set kind = "lathe" under [machine] of the machine file'
            raise fault("code-not-supported", message, word, hint)
        state.diameter = at.text != "DIAMOF"
        state.radius_increments = at.text == "DIAM90"
        self._motion.units_changed()

    def feed(self, words: LineWords, codes: Codes) -> None:
        """Execute F. In inverse time mode the move of the line uses it instead.

        On a lathe F of a thread is its lead, which the thread takes.
        """
        if "F" not in words.rest or self._is_dwell_time(codes):
            return
        if self._dialect.lathe and self.moving in THREADS:
            return
        state = self._state
        if state.feed_mode == "inverse-time":
            self._inverse_time(words)
            return
        word = words.rest.pop("F")
        scale = state.feed_scale
        if scale != state.scale:
            self._report_feed_units(word)
        if (
            (code := codes.get("units"))
            and state.scale != _scale(code)
            and not self._dialect.units_before_feed
        ):
            message = f"F is read before {code.word.written} takes effect"
            hint = "write F in the next line"
            self._here.report_warning("feed-before-units", message, word, hint)
        if word.number == 0 and self.moving in _NO_FEED:
            state.feed = None
            self._unused_words.mark_used("F")
            return
        feed = feed_of(word.number, scale, per_turn=state.feed_mode == "per-revolution")
        check_feed(word, feed.rotary)
        state.feed = feed
        self._unused_words.note(word)

    def _leaves_feeds(self, code: Code) -> bool:
        """Whether a code changes the units of distances alone; feeds are in mm then."""
        number = code.word.written[1:].strip()
        return number.isdigit() and int(number) in self._dialect.length_units

    def _report_feed_units(self, word: Word) -> None:
        """Warn once that F is in mm where distances are in inches."""
        if not self._feed_units_reported:
            self._feed_units_reported = True
            message = f"{word.written} is in mm: G70 makes only distances inches"
            hint = "write G700 for feeds in inches; a control whose basic system is inches has them"
            self._here.report_warning("feed-in-mm", message, word, hint)

    def _inverse_time(self, words: LineWords) -> None:
        """Take an F of a line without a feed move, as LinuxCNC does."""
        if self.moving in _NO_FEED:
            word = words.rest.pop("F")
            message = f"{word.written} has no effect: under G93 it belongs to the move of its line"
            self._here.report_note("word-without-effect", message, word)

    def _is_dwell_time(self, codes: Codes) -> bool:
        """Whether F is the time of a dwell in its line."""
        code = codes.get("non-modal")
        return code is not None and code.number == G.G4 and "F" in self._dialect.dwell


def _scale(code: Code) -> float:
    """Return the millimetres of a program unit under G20 or G21."""
    return MM_PER_INCH if code.number == G.G20 else 1.0
