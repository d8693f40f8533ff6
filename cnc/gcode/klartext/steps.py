"""Steps of the blocks of Klartext: program, tools, labels, jumps; moves and cycles are beside it.

Source: HEIDENHAIN, "TNC 640 User's Manual Klartext Programming", "Subprograms and program section
repeats", "Programming Q parameters", "Tools".
"""

from __future__ import annotations

import re

from cnc.gcode.klartext import cycles, moves
from cnc.gcode.klartext.reader import Block, Item
from cnc.gcode.klartext.state import Session
from cnc.gcode.program.call_stack import Flow, Frame, Step
from cnc.gcode.program.control_flow import BackwardJump, not_ended
from cnc.gcode.program.line_index import Place
from cnc.gcode.state.tool_table import MAX_TOOL, ToolEntry
from cnc.gcode.syntax.statement import Control
from cnc.gcode.syntax.words import whole

_LABEL = re.compile(rb"(?<![^\r\n])[ \t]*[0-9]*[ \t]*LBL[ \t]*[\"0-9]", re.IGNORECASE)
_NO_LENGTH = ("DL", "DR", "DR2")


class BlockStep:
    """A block of Klartext as a step."""

    __slots__ = ("_block",)

    def __init__(self, block: Block) -> None:
        self._block = block

    def run(self, flow: Flow, line: int) -> int:
        """Execute the block; return the line to continue at."""
        block = self._block
        session = flow.klartext
        if session is None:
            session = flow.klartext = Session(flow)
        session.line = flow.interpreter.here.line = line
        if block.label != "definition":
            session.defines = False
        after = _EFFECTS[str(block.label)](session, block)
        return line + 1 if after is None else after


def _begin(session: Session, block: Block) -> None:
    if session.opened:
        raise session.fault(block, "program-repeated", "a second BEGIN PGM")
    session.opened = True
    session.inches = block.items[-1].key == "INCH"
    session.do(block.head.word("G", 20.0 if session.inches else 21.0))


def _end(session: Session, block: Block) -> None:
    if session.flow.frame.kind != "main":
        raise not_ended(session.flow, "before END PGM: LBL 0 is missing")
    session.do(block.head._replace(text="END PGM").word("M", 2.0))


def end_of_file(flow: Flow, line: int) -> None:
    """Refuse the end of the text of a program that began with BEGIN PGM.

    Raises:
        CncError: ``program-end-missing``.
    """
    if flow.klartext is not None and flow.klartext.opened:
        at = Place(line - 1, 1, max(len(flow.main.source(line - 1)), 1))
        message = "the program has no END PGM: the file may not be complete"
        raise flow.main.fault(at, "program-end-missing", message, "end it with END PGM")


def _blank(session: Session, block: Block) -> None:
    session.note(block, "BLK FORM (the blank of the control's graphics) has no effect here")


def _tool_call(session: Session, block: Block) -> None:
    """Change the tool, and take its length; without a number set the speed only."""
    number = None
    for item in block.items[1:]:
        if item.key == "":
            number = item
        elif item.value is None and item.key != "Z":
            what = (
                f"the tool axis {item.key}" if item.key in ("X", "Y") else f"the tool {item.text}"
            )
            hint = "call a tool by its number, with the axis Z"
            raise item.fault("code-not-supported", f"{what} in TOOL CALL is not supported", hint)
        elif item.key in _NO_LENGTH and session.value(item) != 0.0:
            hint = "enter the difference in the tool table"
            raise item.fault("code-not-supported", f"{item.text}: only 0 is supported", hint)
    if number is not None:
        session.do(number.word("T", session.value(number)), number.word("M", 6.0))
        session.do(number.word("G", 43.0 if session.value(number) else 49.0))
    if speed := block.find("S"):
        session.do(speed.word("S", session.value(speed)))
    if feed := block.find("F"):
        session.auto_feed = session.next_feed = session.feed(feed)


def _tool_def(session: Session, block: Block) -> None:
    """Prepare a tool, or enter its length and radius in the tool table."""
    number = block.items[1]
    word, table = number.word("T", session.value(number)), session.flow.interpreter.tool_codes.table
    given = {item.key: session.value(item) for item in block.items[2:]}
    if not given:
        session.do(word)
        return
    if table.file:
        message = "TOOL DEF with dimensions, beside a tool table"
        hint = "remove L and R: the dimensions are those of the table"
        raise session.fault(block, "code-not-supported", message, hint)
    scale = session.flow.interpreter.modal.scale
    length, radius = (given.get(letter, 0.0) * scale for letter in "LR")
    tool = whole(word, "the tool number", 1, MAX_TOOL)
    table.put(ToolEntry(tool, offsets={"Z": length}, diameter=2.0 * radius))


def _stop(session: Session, block: Block) -> None:
    moves.move(session, _as_functions(block))
    session.do(block.head.word("M", 0.0))


def _as_functions(block: Block) -> Block:
    """Return the M functions of a STOP or CYCL CALL as a block of their own."""
    items = tuple(item for item in block.items if item.key == "M")
    head = Item("M", None, block.head.text, block.head.begin)
    return Block("klartext", "move", (), block.column, block.length, None, head, items)


def _cycle_call(session: Session, block: Block) -> None:
    moves.move(session, _as_functions(block))
    cycles.call_cycle(session, block)


def _message(session: Session, block: Block) -> None:
    number = session.value(block.head)
    if block.head.key == "PRINT":
        session.note(block, "FN 15 (output of a value) has no effect here")
        return
    message = f"the program stops itself with error {number:g}"
    raise block.head.fault("program-abort", message, "correct the cause, then run it again")


# Labels


def _label_of(session: Session, item: Item) -> str:
    if item.value is None:
        return item.text
    number = session.value(item)
    if not number.is_integer():
        raise item.fault("label-malformed", f"{item.text} is not a label")
    return str(int(number))


def _line_of(session: Session, block: Block, item: Item) -> int:
    """Return the line of a label.

    Raises:
        CncError: ``label-missing``, ``label-repeated``.
    """
    if session.labels is None:
        session.labels = _all_labels(session)
    name = _label_of(session, item)
    if name == "0" or name not in session.labels:
        message = f"there is no LBL {name}" if name != "0" else "LBL 0 is the end of a subprogram"
        raise session.fault(block, "label-missing", message)
    return session.labels[name]


def _all_labels(session: Session) -> dict[str, int]:
    """Return the line of each label of the text."""
    found: dict[str, int] = {}
    listing, line = session.flow.listing, 1
    while (window := listing.window(line)) is not None:
        index = 0
        while (index := window.find(_LABEL, index, window.count)) < window.count:
            statement = listing.statement(window, index)
            if statement is not None and isinstance(statement.control, Block):
                name = _label_of(session, statement.control.items[0])
                at = window.first + index
                if found.setdefault(name, at) != at and name != "0":
                    control = statement.control
                    message = f"LBL {name} stands in line {found[name]}, too"
                    raise listing.control_fault(at, control, "label-repeated", message)
            index += 1
            if index == window.count:
                break
        line = window.first + window.count
    return found


def _label(session: Session, block: Block) -> int | None:
    """Return from a subprogram at LBL 0; other labels have no effect."""
    flow = session.flow
    if _label_of(session, block.items[0]) != "0" or flow.frame.kind == "main":
        return None
    depth = len(flow.frames)
    session.repeats = {key: left for key, left in session.repeats.items() if key[0] < depth}
    return flow.leave()


def _call(session: Session, block: Block) -> int | None:
    """Call a subprogram, or repeat the lines from a label to here."""
    flow, item = session.flow, block.items[1]
    target = _line_of(session, block, item)
    repeat = block.find("REP")
    if repeat is None:
        at = Place(session.line, block.column, block.length)
        name = f"LBL {_label_of(session, item)}"
        return flow.enter(
            Frame("program", name, flow.listing, target, flow.listing, at, session.line + 1)
        )
    if target > session.line:
        message = "a program section to repeat must begin before this block"
        raise session.fault(block, "jump-target-bad", message)
    key = len(flow.frames), session.line
    left = session.repeats.get(key)
    if left is None:
        count = session.value(repeat)
        if not count.is_integer() or not 0 <= count <= 65_535:
            raise repeat.fault("call-repeats", f"{repeat.text} is no number of repetitions")
        left = int(count)
    if left == 0:
        session.repeats.pop(key, None)
        return None
    session.repeats[key] = left - 1
    return _jump_to(session, block, target)


def _jump(session: Session, block: Block) -> int | None:
    """Jump to a label if the condition of FN 9 to FN 12 holds."""
    return (
        _jump_to(session, block, _line_of(session, block, block.items[0]))
        if session.value(block.head)
        else None
    )


def _jump_to(session: Session, block: Block, target: int) -> int:
    if target <= session.line:
        at = Place(session.line, block.column, block.length)
        back = session.jumps.setdefault(session.line, BackwardJump("this block", at))
        back.record(session.flow, session.flow.listing, target)
    return target


_EFFECTS = {
    "begin": _begin, "end": _end, "blank": _blank, "move": moves.move, "centre": moves.centre,
    "corner": moves.corner, "spline": moves.spline, "tool_call": _tool_call,
    "tool_def": _tool_def, "stop": _stop, "cycle": cycles.define, "cycle_call": _cycle_call,
    "definition": cycles.assign, "label": _label, "call": _call, "jump": _jump,
    "message": _message,
}  # fmt: skip
"""What each kind of block does. It returns the line to continue at; None for the next one."""


def _maker(_: Flow, line: int, control: Control) -> Step:
    assert isinstance(control, Block)
    return BlockStep(control)


MAKERS = {"klartext": _maker}
