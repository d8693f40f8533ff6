"""The process of the checks: it ends with the server, and with the console."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from tests.support.waiting import wait_until

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
