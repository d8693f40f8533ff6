"""Steps of the blocks of Klartext: program, tools, labels, jumps; moves and cycles are beside it.

Source: HEIDENHAIN, "TNC 640 User's Manual Klartext Programming", "Subprograms and program section
repeats", "Programming Q parameters", "Tools".
"""

from __future__ import annotations

import re
from collections.abc import Callable

from cnc.gcode.core.call_stack import Flow, Frame, Step
from cnc.gcode.core.control_flow import BackwardJump, not_ended
from cnc.gcode.core.tool_table import MAX_TOOL, ToolEntry
from cnc.gcode.klartext import moves
from cnc.gcode.klartext.moves import Session
from cnc.gcode.klartext.reader import Block, Item, block_of
from cnc.gcode.reader.source_text import Place, lines_with
from cnc.gcode.reader.statements import Control
from cnc.gcode.reader.words import whole

_LABEL = re.compile(rb"(?<![^\r\n])[ \t]*[0-9]*[ \t]*LBL[ \t]*[\"0-9]", re.IGNORECASE)


class BlockStep:
    """A block of Klartext as a step."""

    __slots__ = ("_block",)

    def __init__(self, _: Flow, line: int, block: Control) -> None:
        assert isinstance(block, Block)
        self._block = block

    def run(self, flow: Flow, line: int) -> int:
        """Execute the block; return the line to continue at."""
        block, session = self._block, flow.state(Session)
        if session is None:
            session = Session(flow)
            flow.keep(session)
        session.line = flow.interpreter.here.line = line
        flow.interpreter.begun = True
        session.defines = session.defines and block.head.key == "Q"
        after = _EFFECTS[block.head.key](session, block)
        return line + 1 if after is None else after


def _begin(session: Session, block: Block) -> None:
    if session.opened:
        raise block.head.fault("program-repeated", "a second BEGIN PGM")
    session.opened, session.inches = True, block.items[-1].key == "INCH"
    session.do(block.head._replace(text="BEGIN PGM").word("G", 20 if session.inches else 21))


def _end(session: Session, block: Block) -> None:
    if session.flow.frame.kind != "main":
        raise not_ended(session.flow, "before END PGM: LBL 0 is missing")
    session.do(block.head._replace(text="END PGM").word("M", 2))


def end_of_file(flow: Flow, line: int) -> None:
    """Refuse the end of the text of a program that began with BEGIN PGM."""
    session = flow.state(Session)
    if session is not None and session.opened:
        at = Place(line - 1, 1, max(len(flow.main.source(line - 1)), 1))
        message = "the program has no END PGM: the file may not be complete"
        raise flow.main.fault(at, "program-end-missing", message, "end it with END PGM")


def _tool_call(session: Session, block: Block) -> None:
    """Change the tool, and take its length; without a number set the speed only."""
    for item in block.items:
        if item.value is None and item.key != "Z":
            message = f"{item.text} in TOOL CALL is not supported"
            hint = "call a tool by its number, with the axis Z"
            raise item.fault("code-not-supported", message, hint)
        if item.key in ("DL", "DR", "DR2") and session.value(item) != 0.0:
            message = f"{item.text}: only 0 is supported"
            raise item.fault("code-not-supported", message, "use the tool table")
    if number := block.find(""):
        tool = session.value(number)
        session.do(number.word("T", tool), number.word("M", 6))
        session.do(number.word("G", 43 if tool else 49))
    if speed := block.find("S"):
        session.do(speed.word("S", session.value(speed)))
    if feed := block.find("F"):
        session.auto_feed = session.next_feed = session.feed(feed)


def _tool_def(session: Session, block: Block) -> None:
    """Prepare a tool, or enter its length and radius in the tool table."""
    number, *dimensions = block.items
    interpreter = session.flow.interpreter
    word, table = number.word("T", session.value(number)), interpreter.tool_codes.table
    if not dimensions:
        session.do(word)
        return
    if table.file:
        raise block.head.fault("code-not-supported", "L and R beside a tool table", "remove them")
    given = {item.key: session.value(item) * interpreter.modal.scale for item in dimensions}
    length, radius = given.get("L", 0.0), given.get("R", 0.0)
    tool = whole(word, "the tool number", 1, MAX_TOOL)
    table.put(ToolEntry(tool, offsets={"Z": length}, diameter=2.0 * radius))


def _stop_or_cycle(session: Session, block: Block) -> None:
    """Execute STOP or CYCL CALL, behind the M functions of the block."""
    moves.move(session, block_of(block.head._replace(key="M"), *block.items))
    if block.head.key == "STOP":
        session.do(block.head._replace(text="STOP").word("M", 0))
    else:
        moves.call_cycle(session, block)


def _note(session: Session, block: Block) -> None:
    """Report BLK FORM and FN 15; FN 14 stops the program."""
    if block.head.key == "ERROR":
        message = f"the program stops itself with error {session.value(block.head):g}"
        raise block.head.fault("program-abort", message, "correct the cause, then run it again")
    is_blank = block.head.key == "BLKFORM"
    session.note(block, "BLK FORM (the blank)" if is_blank else "FN 15 (output of a value)")


def _label_of(item: Item) -> str:
    """Return a label: a number without leading zeros, or a name in quotes."""
    return str(int(item.text)) if item.text.isdecimal() else item.text


def _line_of(session: Session, block: Block, item: Item) -> int:
    """Return the line of a label."""
    if session.labels is None:
        session.labels = _all_labels(session)
    name = _label_of(item)
    if name == "0" or name not in session.labels:
        what = "LBL 0 is the end of a subprogram" if name == "0" else f"there is no LBL {name}"
        raise block.head.fault("label-missing", what)
    return session.labels[name]


def _all_labels(session: Session) -> dict[str, int]:
    """Return the line of each label of the text."""
    labels: dict[str, int] = {}
    listing = session.flow.listing
    for window, index in lines_with(listing, _LABEL):
        at, statement = window.first + index, listing.statement(window, index)
        if statement is not None and isinstance(statement.control, Block):
            name = _label_of(statement.control.items[0])
            first = labels.setdefault(name, at)
            if first != at and name != "0":
                message = f"LBL {name} stands in line {first}, too"
                raise listing.control_fault(at, statement.control, "label-repeated", message)
    return labels


def _label(session: Session, block: Block) -> int | None:
    """Return from a subprogram at LBL 0; other labels have no effect."""
    returns = _label_of(block.items[0]) == "0" and session.flow.frame.kind != "main"
    return session.flow.leave() if returns else None


def _call(session: Session, block: Block) -> int | None:
    """Call a subprogram, or repeat the lines from a label to here."""
    flow, item, repeat = session.flow, block.items[0], block.find("REP")
    target = _line_of(session, block, item)
    if repeat is None:
        at, name = Place(session.line, block.column, block.length), f"LBL {_label_of(item)}"
        listing = flow.listing
        return flow.enter(Frame("program", name, listing, target, listing, at, session.line + 1))
    if target > session.line:
        message = "a program section to repeat must begin before this block"
        raise block.head.fault("jump-target-bad", message)
    number, left = repeat.word("REP", session.value(repeat)), flow.frame.counts
    rounds = left.pop(session.line, whole(number, "the number of repetitions", 0, 65_535))
    if not rounds:
        return None
    left[session.line] = rounds - 1
    return _back_to(session, block, target)


def _jump(session: Session, block: Block) -> int | None:
    """Jump to a label if the condition of FN 9 to FN 12 holds."""
    target = _line_of(session, block, block.items[0])
    return _back_to(session, block, target) if session.value(block.head) else None


def _back_to(session: Session, block: Block, target: int) -> int:
    if target <= session.line:
        at = Place(session.line, block.column, block.length)
        back = session.jumps.setdefault(session.line, BackwardJump("this block", at))
        back.record(session.flow, session.flow.listing, target)
    return target


_EFFECTS = {
    "BEGINPGM": _begin, "ENDPGM": _end, "BLKFORM": _note, "CC": moves.centre,
    **dict.fromkeys(moves.ALLOWED, moves.move), "RND": moves.corner, "CHF": moves.corner,
    "SPL": moves.spline, "TOOLCALL": _tool_call, "TOOLDEF": _tool_def, "STOP": _stop_or_cycle,
    "CYCLDEF": moves.define, "CYCLCALL": _stop_or_cycle, "Q": moves.assign, "LBL": _label,
    "CALLLBL": _call, "IF": _jump, "ERROR": _note, "PRINT": _note,
}  # fmt: skip
"""The effect of each kind of block. It returns the line to continue at; None for the next one."""

MAKERS: dict[str, Callable[[Flow, int, Control], Step]] = {"klartext": BlockStep}
