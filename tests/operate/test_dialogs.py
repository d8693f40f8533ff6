"""Questions to the operator, and their answers."""

from __future__ import annotations

import pytest

from cnc.model.diagnostics import Diagnostic
from cnc.operate.events import EventStream, as_object
from cnc.operate.program_runs import Dialogs, RunWatch


@pytest.mark.parametrize("yes", [True, False])
def test_an_answer_counts_however_early_it_comes(yes):
    """A client may answer before the event has reached the others."""
    events = EventStream()
    dialogs = Dialogs(events)
    events.listen(lambda each: each.event == "dialog" and dialogs.answer(each.id, yes))
    assert dialogs.ask("restart", "begin at line 3?") is yes
    assert dialogs.open is None


def test_the_question_of_a_start_in_the_middle_has_its_warnings_as_findings():
    events, asked = EventStream(), []
    dialogs = Dialogs(events)

    def answer(event):
        if event.event == "dialog":
            asked.append(event)
            dialogs.answer(event.id, True)

    events.listen(answer)
    watch = RunWatch("part.nc", events, dialogs, lambda progress: None, lambda question: None)
    callbacks = watch.callbacks()
    callbacks.on_warning(Diagnostic("position-assumed", "where is it?", severity="warning"))
    callbacks.on_warning(Diagnostic("feed-assumed", "no F", "part.nc", 1, severity="warning"))
    assert callbacks.on_beginning(["from line 3:", "lift Z"])
    (question,) = asked
    assert question.text == "where is it?; from line 3:"
    assert [doubt.code for doubt in question.doubts] == ["position-assumed"]
    assert as_object(question)["doubts"][0]["message"] == "where is it?"
    assert question.steps == ("lift Z",)
