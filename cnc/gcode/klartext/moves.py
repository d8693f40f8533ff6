"""Moves of Klartext: straight lines, arcs, polar coordinates, rounds, chamfers and splines.

A move becomes G0 to G3 with absolute words; the interpreter does the rest. The pole, the tangent of
an arc and the angles of polar coordinates exist here only. Source: HEIDENHAIN, "TNC 640 User's
Manual Klartext Programming", "Programming contours"; for M functions "Miscellaneous functions".
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from cnc.gcode.klartext.cycles import call_cycle
from cnc.gcode.klartext.reader import Block, Item
from cnc.gcode.klartext.state import Point, Polar, Session
from cnc.gcode.splines import knots as curves
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word
from cnc.model.blocks import NurbsFeed

ALLOWED = {
    "L": "XYZABCUVW", "C": "XYZ", "CR": "XYZ", "CT": "XY", "LP": "Z", "CP": "Z", "M": "",
}  # fmt: skip
"""Axes of each move."""
_POLAR_MOVES = ("LP", "CP")
_TURNING = ("C", "CR", "CP")
"""Moves with a direction of rotation, DR."""
_SIDES = {"R0": G.G40, "RL": G.G41, "RR": G.G42}
_FEEDS = ("F", "FMAX", "FAUTO")
_BEFORE = {3: (3,), 4: (4,), 8: (8,), 7: (7,), 13: (3, 8), 14: (4, 8)}
"""M functions at the start of a block, and their M-codes."""
_AFTER = {5: (5,), 9: (9,), 0: (5, 0), 1: (1,), 2: (2,), 30: (30,)}
"""M functions at the end of a block. M0 stops the spindle, too."""
_MACHINE, _MODAL_CYCLE, _CYCLE, _CHANGE = 91, 89, 99, 6
_IDLE = {
    90: "constant feed at corners", 107: "end of M108", 111: "end of M109", 117: "end of M116",
    127: "end of M126", 129: "end of M128", 137: "end of M136", 145: "end of M144",
    149: "end of M148", 142: "end of M143",
}  # fmt: skip
_NEAR = 1e-9
"""Degrees or mm that are rounding only."""
_SPLINE_START = 0.01
"""Largest distance of a spline's start from the position, mm."""


def move(session: Session, block: Block) -> None:
    """Execute a block that may move: L, C, CR, CT, LP, CP, or M functions alone."""
    _check_words(block)
    kinds = {item: session.value(item) for item in block.items if item.key == "M"}
    numbers = {int(number) for number in kinds.values()}
    for item, number in kinds.items():
        _check_function(session, block, item, number)
    words = [
        item.word("M", code)
        for item, number in kinds.items()
        for code in _BEFORE.get(int(number), ())
    ]
    words += _side(session, block)
    has_place = any(item.key.lstrip("I") in (*"XYZABCUVW", "PR", "PA") for item in block.items)
    if has_place or block.head.key not in ("L", "M"):
        _place(session, block, words, machine=_MACHINE in numbers)
    else:
        if feed := block.find("F", "FAUTO"):
            words.append(_feed_word(session, feed))
        if words:
            session.do(*words)
    for item, number in kinds.items():
        if int(number) in (5, 9):
            session.do(item.word("M", number))
    if _MODAL_CYCLE in numbers:
        session.after_moves = True
    if _CYCLE in numbers or (session.after_moves and has_place):
        call_cycle(session, block)
    if _CYCLE in numbers:
        session.after_moves = False
    for item, number in kinds.items():
        if int(number) in (0, 1, 2, 30):
            for code in _AFTER[int(number)]:
                session.do(item.word("M", code))


def _check_words(block: Block) -> None:
    """Refuse words that the move does not have, and words given twice."""
    kind = block.head.key
    seen: set[str] = set()
    for item in block.items:
        key = item.key
        name = key.lstrip("I")
        group = "feed" if key in _FEEDS else "side" if key in _SIDES else name
        allowed = (
            group in ("feed", "side", "M")
            or (kind in _POLAR_MOVES and name in ("PR", "PA"))
            or (kind in _TURNING and name == "DR")
            or (kind == "CR" and name == "R")
            or (len(name) == 1 and name in ALLOWED[kind])
        )
        if not allowed or (kind == "CP" and name == "PR"):
            raise item.fault("klartext-word", f"{item.text} does not belong to {kind}")
        if group in seen and group != "M":
            raise item.fault("word-repeated", f"{item.text}: {name} is given twice in this block")
        seen.add(group)


def _check_function(session: Session, block: Block, item: Item, number: float) -> None:
    """Refuse or report an M function that has no effect here."""
    known = (*_BEFORE, *_AFTER, _MACHINE, _MODAL_CYCLE, _CYCLE)
    if number in _IDLE:
        session.note(block, f"M{number:g} ({_IDLE[int(number)]}) has no effect here")
    elif number == _CHANGE:
        session.note(block, "M6 has no effect here: TOOL CALL changes the tool")
    elif number not in known:
        hint = "let the CAM system write the program without it"
        raise item.fault("code-not-supported", f"M{number:g} is not supported in Klartext", hint)


def _side(session: Session, block: Block) -> list[Word]:
    """Return G40, G41 or G42 if the side of the compensation changes."""
    item = block.find(*_SIDES)
    if item is None:
        return []
    code = _SIDES[item.key]
    if code == session.flow.interpreter.modal.compensation:
        return []
    return [item.word("G", code / 10.0)]


def _feed_word(session: Session, item: Item) -> Word:
    """Return the F word of ``F`` or ``F AUTO``."""
    if item.key == "F":
        return item.word("F", session.feed(item))
    if session.auto_feed is None:
        hint = "give F in TOOL CALL, or here"
        raise item.fault("feed-missing", "F AUTO, but the last TOOL CALL has no F", hint)
    return item.word("F", session.auto_feed)


def _place(session: Session, block: Block, words: list[Word], *, machine: bool) -> None:
    """Make the move of a block."""
    kind, start = block.head.key, session.position()
    target = _target(session, block, start, machine=machine)
    feed = block.find(*_FEEDS)
    rapid = feed is not None and feed.key == "FMAX"
    code, more, direction = 0.0 if rapid else 1.0, [], None
    here = start.get("X", 0.0), start.get("Y", 0.0)
    there = target.get("X", here[0]), target.get("Y", here[1])
    if kind in ("L", "LP"):
        direction = None if machine else _unit(there[0] - here[0], there[1] - here[1])
    else:
        if rapid:
            assert feed is not None
            hint = "give F and a number"
            raise feed.fault("code-not-supported", f"FMAX in {kind}: an arc needs a feed", hint)
        code, more, direction = _arc(session, block, here, there)
        target |= {"X": there[0], "Y": there[1]}
    if machine:
        if kind != "L":
            raise session.fault(
                block, "code-not-supported", f"M91 goes with L only, not with {kind}"
            )
        words.append(block.head.word("G", 53.0))
    if not rapid:
        if feed is not None:
            words.append(_feed_word(session, feed))
        elif session.next_feed is not None:
            words.append(block.head.word("F", session.next_feed))
        session.next_feed = None
    words.append(Word("G", code, kind, block.column, block.length))
    given = {item.key.lstrip("I"): item for item in block.items}
    for letter, number in target.items():
        words.append(given.get(letter, block.head).word(letter, number))
    words += more
    words += _corner_word(session, block, rapid=rapid)
    session.do(*words)
    session.direction = direction
    if kind not in _POLAR_MOVES:
        session.polar = None


def _target(
    session: Session, block: Block, start: dict[str, float], *, machine: bool
) -> dict[str, float]:
    """Return the end of a move, by letter, in units of the program."""
    found: dict[str, float] = {}
    for item in block.items:
        letter = item.key.lstrip("I")
        if len(letter) != 1 or letter not in "XYZABCUVW":
            continue
        number = session.value(item)
        if item.key.startswith("I"):
            if machine:
                raise item.fault("machine-coordinates-incremental", f"{item.text} beside M91")
            if letter not in start:
                raise item.fault("axis-missing", f"the machine has no {letter} axis")
            number += start[letter]
        found[letter] = number
    if block.head.key in _POLAR_MOVES:
        found |= dict(zip("XY", _polar_end(session, block, start), strict=True))
    return found


def _polar_end(session: Session, block: Block, start: dict[str, float]) -> Point:
    """Return the end of LP or CP in the plane."""
    pole = _pole(session, block)
    here = start["X"], start["Y"]
    x, y = here[0] - pole[0], here[1] - pole[1]
    angle, radius = block.find("PA", "IPA"), block.find("PR", "IPR")
    last = session.polar
    if last is not None and math.dist(last.place, here) > _NEAR:
        last = None
    if block.head.key == "CP":
        if angle is None:
            raise session.fault(block, "klartext-incomplete", "CP needs the angle: PA or IPA")
        before = math.degrees(math.atan2(y, x))
        length = math.hypot(x, y)
        if length < _NEAR:
            raise session.fault(block, "polar-at-origin", "CP begins at the pole")
    else:
        absolute = (angle and angle.key == "PA") and (radius and radius.key == "PR")
        if last is None and not absolute:
            message = "LP without PR and PA, and the block before is not polar"
            raise session.fault(block, "polar-at-origin", message, "give PR and PA")
        before, length = (last.angle, last.radius) if last else (0.0, 0.0)
        if radius is not None:
            length = session.value(radius) + (length if radius.key == "IPR" else 0.0)
    degrees = before
    if angle is not None:
        degrees = session.value(angle) + (before if angle.key == "IPA" else 0.0)
    radians = math.radians(math.fmod(degrees, 360.0))
    end = pole[0] + length * math.cos(radians), pole[1] + length * math.sin(radians)
    if block.head.key == "CP" and abs(math.remainder(degrees - before, 360.0)) < _NEAR:
        end = here
    session.polar = Polar(length, degrees, end)
    return end


def _pole(session: Session, block: Block) -> Point:
    if session.pole is None:
        message = f"{block.head.key} without a CC before it"
        hint = "write CC X.. Y.. before; a datum shift, mirror image or rotation ends it"
        raise session.fault(block, "arc-center-missing", message, hint)
    return session.pole


def _arc(
    session: Session, block: Block, here: Point, there: Point
) -> tuple[float, list[Word], Point | None]:
    """Return the code of an arc, its words, and its direction at the end."""
    kind, head = block.head.key, block.head
    if kind == "CT":
        centre, turns_left = _tangent_arc(session, block, here, there)
    else:
        turn = block.find("DR")
        if turn is None:
            message = f"{kind} needs a direction of rotation"
            raise session.fault(block, "klartext-incomplete", message, "give DR+ or DR-")
        turns_left = session.value(turn) > 0.0
        if kind == "CR":
            radius = block.find("R")
            assert radius is not None
            size = session.value(radius)
            end = _direction_of_radius(here, there, size, turns_left=turns_left)
            return 3.0 if turns_left else 2.0, [radius.word("R", size)], end
        centre = _pole(session, block)
    words = [head.word(letter, to - at) for letter, to, at in zip("IJ", centre, here, strict=True)]
    angle = block.find("IPA")
    if angle is not None:
        degrees = session.value(angle)
        if degrees == 0.0 or (degrees > 0.0) != turns_left:
            message = f"{angle.text} and DR must turn in the same direction"
            raise angle.fault("arc-angle", message)
        count = math.ceil(abs(degrees) / 360.0 - _NEAR)
        words.append(angle.word("P", float(count)))
    x, y = there[0] - centre[0], there[1] - centre[1]
    direction = _unit(-y, x) if turns_left else _unit(y, -x)
    return 3.0 if turns_left else 2.0, words, direction


def _tangent_arc(session: Session, block: Block, here: Point, there: Point) -> tuple[Point, bool]:
    """Return the centre of an arc that continues the move before, and whether it turns left."""
    if session.direction is None:
        message = "CT needs a move in the plane directly before it"
        hint = "write the move that it is tangential to, or C or CR"
        raise session.fault(block, "arc-tangent-missing", message, hint)
    x, y = there[0] - here[0], there[1] - here[1]
    normal = -session.direction[1], session.direction[0]
    across = x * normal[0] + y * normal[1]
    length = math.hypot(x, y)
    if abs(across) <= _NEAR * max(length, 1.0):
        message = "CT ends on the straight line through the move before: this is no arc"
        raise session.fault(block, "arc-tangent-missing", message, "write L for a straight line")
    radius = length * length / (2.0 * across)
    return (here[0] + radius * normal[0], here[1] + radius * normal[1]), radius > 0.0


def _direction_of_radius(
    here: Point, there: Point, radius: float, *, turns_left: bool
) -> Point | None:
    """Return the direction at the end of an arc by its radius; one below 0 is more than half."""
    x, y = there[0] - here[0], there[1] - here[1]
    length = math.hypot(x, y)
    if not length or not radius:
        return None
    half = math.asin(min(1.0, length / (2.0 * abs(radius))))
    turned = half if radius > 0.0 else math.pi - half
    angle = math.atan2(y, x) + (turned if turns_left else -turned)
    return math.cos(angle), math.sin(angle)


def _unit(x: float, y: float) -> Point | None:
    length = math.hypot(x, y)
    return (x / length, y / length) if length else None


# Centres, corners and splines


def centre(session: Session, block: Block) -> None:
    """Execute CC: the pole is a place, a distance from the position, or the position."""
    start = session.position()
    found = {"X": start["X"], "Y": start["Y"]}
    letters = [item.key.lstrip("I") for item in block.items]
    if letters and sorted(letters) != ["X", "Y"]:
        message = "CC takes X and Y, or no word for the position"
        raise session.fault(block, "code-not-supported", message)
    for item in block.items:
        letter = item.key.lstrip("I")
        found[letter] = session.value(item) + (start[letter] if item.key.startswith("I") else 0.0)
    session.pole, session.polar = (found["X"], found["Y"]), None


def _next_block(session: Session) -> tuple[Block, int] | None:
    """Return the block behind the current line, and its line."""
    listing, line = session.flow.listing, session.line + 1
    while (window := listing.window(line)) is not None:
        statement = listing.statement(window, line - window.first)
        if statement is not None and isinstance(statement.control, Block):
            return statement.control, line
        line += 1
    return None


def _corner_word(session: Session, block: Block, *, rapid: bool) -> Iterator[Word]:
    """Yield the word of the RND or CHF behind a move."""
    following = _next_block(session)
    if following is None or following[0].label != "corner":
        return
    corner, session.corner_line = following
    item = corner.find("R", "")
    assert item is not None
    if rapid:
        message = f"{corner.head.text} behind a move with FMAX"
        raise session.fault(block, "corner-next", message, "give the move a feed")
    if feed := corner.find(*_FEEDS):
        raise session.flow.listing.placed(
            feed.fault("code-not-supported", "F in RND and CHF is not supported"),
            session.corner_line,
        )
    letter = ",R" if corner.head.key == "RND" else ",C"
    yield Word(letter, session.value(item), corner.head.text, block.column, block.length)


def corner(session: Session, block: Block) -> None:
    """Check that an RND or CHF belongs to the move before it, which has made it."""
    if session.corner_line != session.line:
        message = f"{block.head.key} needs a move directly before it"
        raise session.fault(block, "corner-next", message)
    session.corner_line = 0
    session.direction = None


def spline(session: Session, block: Block) -> None:
    """Execute SPL: X(t) = K3X t^3 + K2X t^2 + K1X t + X, from t = 1 to 0.

    The control points are those of the same cubic in Bezier's form.
    """
    motion, scale = session.flow.interpreter.motion, session.flow.interpreter.modal.scale
    at = block.head.word("", 0.0)
    motion.compensation.refuse_curve(at)
    given: dict[str, float] = {}
    for item in block.items:
        if item.key in given or item.key[-1] not in "XYZFO" or item.key.startswith("I"):
            message = f"{item.text} does not belong to SPL, or is given twice"
            raise item.fault("klartext-word", message)
        if item.key.startswith("F"):
            session.do(_feed_word(session, item))
        else:
            given[item.key] = session.value(item) * scale
    start = motion.coordinates.to_program(motion.position)
    control = [start.copy() for _ in range(4)]
    for letter, column in motion.column.items():
        if letter not in "XYZ":
            continue
        end = given.get(letter, start[column])
        k1, k2, k3 = (given.get(f"K{power}{letter}", 0.0) for power in (1, 2, 3))
        if abs(end + k1 + k2 + k3 - start[column]) > _SPLINE_START:
            message = f"SPL does not begin at the position of the tool in {letter}"
            hint = "the coordinate and K3, K2 and K1 of an axis must add up to its position"
            raise session.fault(block, "nurbs-start", message, hint)
        control[1][column] = end + (2.0 * k1 + k2) / 3.0
        control[2][column], control[3][column] = end + k1 / 3.0, end
    points = np.array([motion.position, *map(motion.coordinates.to_machine, control[1:])])
    feed = motion.feed(LineWords(), points[-1].tolist(), 0.0, at)
    here = session.flow.interpreter.here
    weights, knots = np.ones(4), curves.bezier_knots(3)
    motion.spline(NurbsFeed(here.file, here.line, 3, knots, points, weights, feed))
    session.polar = None
    session.direction = _unit(-given.get("K1X", 0.0), -given.get("K1Y", 0.0))
