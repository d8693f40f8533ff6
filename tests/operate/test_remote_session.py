"""A session in a process of its own: its answers, its mirror, and the death of the process."""

from __future__ import annotations

import os
import signal

import pytest

from cnc.machine.load import load_machine
from cnc.model.diagnostics import BoardError, UsageError
from cnc.operate.events import Alarm, State
from cnc.operate.operator_session import OperatorSession, begin_jog
from cnc.operate.remote_session import RemoteSession
from tests.support.waiting import HANG, wait_until


@pytest.fixture(scope="module")
def remote(tmp_path_factory):
    """One session for the tests of this module, in this order."""
    file = tmp_path_factory.mktemp("machine") / "machine.var"
    machine = load_machine(None)
    program = machine.program.model_copy(update={"parameters": file})
    session = RemoteSession(machine.model_copy(update={"program": program}))
    yield session
    session.close()


def carry_out(session, method, *args, **kwargs):
    return session.ask(method, *args, **kwargs).result(HANG).result(HANG)


def connect(session):
    if not session.state.board:
        carry_out(session, OperatorSession.connect, "loopback")


def test_the_mirror_is_that_of_the_session_after_each_answer(remote):
    connect(remote)
    assert remote.state.board == "loopback"
    assert remote.limited_machine.board.kind == "loopback"
    assert remote.offsets["G54"]["x"] == 0.0
    x = remote.state.machine["x"]
    carry_out(remote, OperatorSession.jog_step, {"x": 2.0})
    assert remote.state.machine["x"] == pytest.approx(x + 2.0, abs=0.01)
    offsets = carry_out(remote, OperatorSession.zero, {"x": 1.0})
    assert remote.offsets == offsets
    assert remote.state.work["x"] == pytest.approx(1.0)
    ended = carry_out(remote, OperatorSession.mdi, "G0 X0")
    assert ended.outcome == "done"
    assert remote.history == ["G0 X0"]


def test_an_activity_is_seen_before_its_answer(remote):
    connect(remote)
    jog = remote.ask(begin_jog, {"y": 1.0}).result(HANG)
    assert remote.state.activity == "jog"
    assert jog.feed > 0.0
    assert remote.ask(OperatorSession.keep_jog, jog.id).result(HANG)
    with pytest.raises(UsageError, match="busy"):
        remote.ask(OperatorSession.mdi, "G0 X1").result(HANG)
    remote.ask(OperatorSession.release_jog).result(HANG)
    wait_until(lambda: remote.state.activity == "none")


def test_faults_come_as_they_are(remote):
    connect(remote)
    with pytest.raises(UsageError) as refused:
        remote.ask(OperatorSession.jog_step, {"x": 1e6}).result(HANG)
    assert refused.value.diagnostic.code == "soft-limit"
    assert refused.value.diagnostic.hint
    with pytest.raises(RuntimeError, match="TypeError"):
        remote.ask(OperatorSession.override, feed="much").result(HANG)


def test_a_question_is_open_until_its_answer(remote):
    connect(remote)
    running = remote.ask(OperatorSession.mdi, "M0").result(HANG)
    wait_until(lambda: remote.dialog is not None)
    assert remote.ask(OperatorSession.answer, remote.dialog.id, yes=True).result(HANG)
    assert running.result(HANG).outcome == "done"
    assert remote.dialog is None


def test_a_process_that_dies_fails_what_waits_and_is_replaced(remote):
    connect(remote)
    events = []
    end = remote.listen(events.append)
    running = remote.ask(OperatorSession.mdi, "G4 P100").result(HANG)
    before = remote.process_id
    os.kill(before, getattr(signal, "SIGKILL", signal.SIGTERM))
    with pytest.raises(BoardError, match="session-lost"):
        running.result(HANG)
    wait_until(lambda: any(isinstance(each, Alarm) for each in events))
    end()
    assert remote.state == State()
    assert remote.offsets == {}
    with pytest.raises(UsageError, match="not-connected"):
        remote.ask(OperatorSession.mdi, "G0 X0").result(HANG)
    assert remote.process_id != before
    # The line before is in the history too, if its process told it in time.
    wait_until(lambda: remote.history[-1:] == ["G0 X0"])
    connect(remote)
    assert remote.state.board == "loopback"


def test_a_closed_session_refuses(remote):
    remote.close()
    with pytest.raises(BoardError, match="session-lost"):
        remote.ask(OperatorSession.stop).result(HANG)
