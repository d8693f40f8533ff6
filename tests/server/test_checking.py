"""The process of the checks: it ends with the server, and with the console."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from cnc.machine.load import load_machine
from cnc.server import checking
from cnc.server.checking import CheckOrder, check_job
from tests.support.waiting import HANG, wait_until

SERVER = """
import os, sys, time
from cnc.server.checking import Checker
if __name__ == "__main__":
    checker = Checker()
    print(checker.pool.submit(os.getpid).result(), flush=True)
    if sys.argv[1] == "close":
        checker.pool.submit(time.sleep, 600)
        checker.close()
    else:
        time.sleep(600)
"""


def lives(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def started(tmp_path, how):
    script = tmp_path / "server.py"
    script.write_text(SERVER)
    server = subprocess.Popen([sys.executable, str(script), how], stdout=subprocess.PIPE, text=True)
    return server, int(server.stdout.readline())


def test_a_check_ends_with_a_server_that_is_killed(tmp_path):
    server, worker = started(tmp_path, "wait")
    with server:
        server.send_signal(signal.SIGKILL)
    wait_until(lambda: not lives(worker))


def test_a_check_does_not_delay_the_end_of_the_server(tmp_path):
    server, worker = started(tmp_path, "close")
    with server:
        assert server.wait(timeout=60) == 0
    wait_until(lambda: not lives(worker))


def test_a_text_that_is_changed_during_its_check_gets_one_of_its_own(controller, console):
    """The result of the old text would stand for the new one, which was never checked."""
    long = "G21 G90 G94 F100\n" + "G1 X1\nG1 X0\n" * 20_000 + "M30\n"
    assert controller("PUT", "/api/jobs/part.nc", {"text": long}).status_code == 200
    old = console.check("part.nc")
    assert console.check("part.nc") is old
    assert controller("PUT", "/api/jobs/part.nc", {"text": "G21\nG1 X5\nM30\n"}).status_code == 200
    new = console.check("part.nc")
    assert new is not old
    assert not new.result(HANG)["ok"]
    assert codes(controller) == ["feed-missing"]


def codes(client):
    wait_until(lambda: client("GET", "/api/jobs/part.nc/check").status_code == 200)
    return [found["code"] for found in client("GET", "/api/jobs/part.nc/check").json()["errors"]]


def test_the_result_of_a_text_that_has_changed_is_not_kept(library, monkeypatch):
    file = library.folder / "changed.nc"
    file.write_text("G21 G90 G94 F100\nG1 X5\nM30\n")
    found = checking.settings_of

    def changed(*arguments):
        file.write_text("G21 G90 G94 F100\nG1 X55\nM30\n")
        return found(*arguments)

    monkeypatch.setattr(checking, "settings_of", changed)
    order = CheckOrder(file.name, library.folder, load_machine(None), {})
    assert check_job(order) is None
    assert library.summary(file.name) is None
    monkeypatch.undo()
    assert check_job(order)["ok"]
    assert library.summary(file.name)["ok"]
