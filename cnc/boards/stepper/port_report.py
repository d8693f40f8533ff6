"""The report on a stepper board at a port. The board does not know the limits of the machine."""

from __future__ import annotations

import json
from collections.abc import Iterator

from cnc.boards.stepper.protocol import VERSION, Welcome


def stepper_report(port: str, board: Welcome, baud: int) -> Iterator[str]:
    """Yield the lines of the report, all comments of TOML.

    Args:
        port: Name of the serial port.
        board: The board's description of itself.
        baud: Speed of the port, bits/s.
    """
    if board.version != VERSION:
        yield (
            f"# stepper board, version {board.version} of the protocol; "
            f"this program uses {VERSION}: make flash PORT={port}"
        )
        return
    letters, spacing_us = " ".join("XYZA"[: board.axes]), board.least_ticks * board.tick_ns / 1000
    position = "its position is known" if board.position_known else "its position is not known"
    state = board.state.name.lower()
    yield f"# stepper board, version {board.version} of the protocol  {state}"
    yield (
        f"# {board.axes} axes ({letters}), ticks of {board.tick_ns} ns, "
        f"grid moves at least {spacing_us:g} us apart"
    )
    yield f"# buffer of {board.room} bytes for segments; {position}"
    keys = f'kind = "stepper", port = {json.dumps(port)}, baud = {baud}'
    yield f"# for its machine file: [board] {keys}"
