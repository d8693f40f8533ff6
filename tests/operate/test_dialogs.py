"""Questions to the operator, and their answers."""

from __future__ import annotations

import pytest

from cnc.operate.events import EventStream
from cnc.operate.program_runs import Dialogs


@pytest.mark.parametrize("yes", [True, False])
def test_an_answer_counts_however_early_it_comes(yes):
    """A client may answer before the event has reached the others."""
    events = EventStream()
    dialogs = Dialogs(events)
    events.listen(lambda each: each.event == "dialog" and dialogs.answer(each.id, yes))
    assert dialogs.ask("restart", "begin at line 3?") is yes
    assert dialogs.open is None
