"""Feeds and units: F, G20, G21, G7 and G8.

Source: LinuxCNC, "Other codes", F; "G-codes", G20 G21 and G7 G8.
"""

from __future__ import annotations

from collections.abc import Iterator

from cnc.gcode.core.block_buffer import SourceLocation, without_word
from cnc.gcode.core.modal_groups import FEED_MODES, Code, Codes, ModalState, check_feed, feed_of
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.statements import Remark, Statement
from cnc.gcode.reader.words import AXES, G, LineWords, Word, fault
from cnc.gcode.turning.codes import THREADS, VARIABLE
from cnc.model.diagnostics import Edit, Fix, GcodeError
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

        On a lathe F of a thread is its lead, or the change of it, which the thread takes.
        """
        if "F" not in words.rest or self._is_dwell_time(codes):
            return
        if self.moving in (THREADS if self._dialect.turning.lathe else VARIABLE):
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
            and not self._dialect.feed.units_first
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
        return number.isdigit() and int(number) in self._dialect.feed.length_units

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
            fix = without_word(word, self._here.text)
            self._here.report_note("word-without-effect", message, word, fix=fix)

    def _is_dwell_time(self, codes: Codes) -> bool:
        """Whether F is the time of a dwell in its line."""
        code = codes.get("non-modal")
        return code is not None and code.number == G.G4 and "F" in self._dialect.dwell.units


def _scale(code: Code) -> float:
    """Return the millimetres of a program unit under G20 or G21."""
    return MM_PER_INCH if code.number == G.G20 else 1.0


# The warning of a distance without a decimal point, which some controls count in 0.001 mm.

_DISTANCES = AXES | frozenset("IJKR")
_Q_IS_DISTANCE = frozenset((G.G73.code, G.G76.code, G.G83.code))


def report_missing(
    statement: Statement, dialect: Dialect, here: SourceLocation, *, collected: bool
) -> bool:
    """Report the first distance without a decimal point; return whether there is one.

    Args:
        statement: The line.
        dialect: The dialect.
        here: Place of the line.
        collected: Whether the line belongs to a NURBS.
    """
    word = next(without_point(statement, dialect, collected=collected), None)
    if word is None:
        return False
    message = f"{word.written} has no decimal point: it is read as mm, inches or degrees"
    hint = f"other controls would read a thousandth of it or less: write {word.written}."
    fix = Fix("write the decimal point", (point_behind(word),), safe=True)
    here.report_warning("decimal-point-missing", message, word, hint, fix)
    return True


def point_behind(word: Word, line: int = 0) -> Edit:
    """Return the edit that writes a decimal point behind a word, in the line of the finding."""
    return Edit(word.column + word.length, 0, ".", line)


def without_point(
    statement: Statement, dialect: Dialect, *, collected: bool = False
) -> Iterator[Word]:
    """Yield the distances and angles that are not 0 and have no decimal point.

    In a line that is ``collected`` for a NURBS, and in that of G6.2, only axis words are distances:
    K is a knot and R a weight. A letter of repeats counts holes, unless an arc's centre has
    another letter beside it. Q is a distance in the line of a cycle that pecks or shifts. On a
    lathe it counts thousandths, A is the angle of a thread or a line, and R of G76 without axes may
    count thousandths.
    """
    words = statement.words
    codes = {word.number for word in words if word.letter == "G"}
    letters = AXES if collected or G.G6_2.code in codes else _DISTANCES
    if letters is _DISTANCES and not any(word.letter in "IJ" for word in words):
        letters -= frozenset(dialect.cycles.repeats)
    if dialect.turning.lathe:
        is_setting = 76.0 in codes and not any(word.letter in "XZUW" for word in words)
        letters -= {"A", "R"} if is_setting else {"A"}
    elif not codes.isdisjoint(_Q_IS_DISTANCE):
        letters |= {"Q"}
    return (
        word
        for word in words
        if word.letter in letters
        and (word.number < 0.0 or word.number > 0.0)  # a computed one is no number yet
        and "." not in word.written
    )


# Errors for words without a use in their line.

_OFFSETS = (
    "I, J and K belong to G2 and G3 (the centre's offset in the plane's two axes), "
    "to G5 and G5.1 (the control point's)"
)
_HINTS = {
    "D": "D belongs to G41 and G42 (the tool's number), G41.1 and G42.1 (its diameter) "
    "and G96 (the highest speed)",
    "E": "numbers have no exponent; E belongs to M66 to M68 (the channel) and to G76 (the taper)",
    "F": "under G93 an F word belongs to the move in its line",
    "H": "H belongs to G43, G43.2 and G44 (the number of the offset) "
    "and to G76 (the spring passes)",
    "I": _OFFSETS,
    "J": _OFFSETS,
    "K": "I, J and K belong to G2 and G3 (the centre's offset in the plane's two axes), "
    "G5 and G5.1; K to G33 and G33.1: the pitch",
    "L": "L belongs to G10 (the kind of offset), canned cycles and M98 (the repeats), "
    "G5.2 (the order) and M66 (the mode)",
    "PL": "PL belongs to the control points of a BSPLINE",
    "PW": "PW belongs to the control points of a BSPLINE",
    "SD": "SD belongs to BSPLINE: the degree",
    **dict.fromkeys(("A3", "B3", "C3"), "it belongs to G0, G1 and BSPLINE under TRAORI"),
    "O": "a program's number stands in a line of its own",
    "P": "P belongs to G4, G5, G5.2, G10, G64, G76, M50 to M53, M62 to M66, M98, "
    "to cycles with a dwell and to the turns of an arc",
    "Q": "Q belongs to G5, G64, G73 and G83 (the peck), G10 L1, G76, M19, M61 and M66 to M68",
    "R": "R belongs to G2 and G3 (the radius), canned cycles, "
    "G10 (a rotation, or the tool's radius), G76 and M19",
}


_USERS = {"D": "G41 or G42", "H": "G43"}
_CENTRE = frozenset("IJK")
_SPINDLE_ON = (3.0, 4.0)


def take_idle(words: LineWords, state: ModalState, here: SourceLocation) -> bool:
    """Take words that controllers ignore, with a warning.

    These are centre words of a traverse, and H and D without a code that uses them if they stand
    beside T and have its number, so that G43 and G41 without H and D mean the same offsets.

    Returns:
        Whether no other word is left.
    """
    if words.rest.keys() <= {"D", "H"}:
        if "T" not in words.users or any(word.number != state.tool for word in words.rest.values()):
            return False
        use, hint = (
            f"no effect without {_USERS[words.first().letter]}",
            "remove it, or give the code",
        )
    elif state.motion == G.G0 and words.rest.keys() <= _CENTRE:
        use, hint = "no use in a traverse (G0) and is ignored", "remove it, or give G2 or G3"
    else:
        return False
    word = words.first()
    here.report_warning("word-idle", f"{word.written} has {use}", word, hint)
    words.rest.clear()
    return True


def unused(words: LineWords, state: ModalState) -> GcodeError:
    """Return the error for the leftmost remaining word."""
    word = words.first()
    if state.motion == G.G6_2 and word.letter in "KURPW":
        message = f"{word.written} after the last knot: the curve is complete"
        return fault(
            "nurbs-still-active", message, word, "go on with G0, G1, G2, G3 or another G6.2"
        )
    hint = _HINTS.get(word.letter, "")
    if word.letter == "P" and any(code.number in _SPINDLE_ON for code in words.m):
        hint = "it is the power in per cent on Snapmaker's machines; here S gives the speed"
    return fault("word-unused", f"{word.written} has no use in this line", word, hint)
