"""``cncrun serve`` in a process, its session's process, and requests to it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from cnc.compiled.code_cache import cache_folder
from cnc.gcode.reader import tables
from tests.support.paths import ROOT


class ServerProcess:
    """A server with a client that has control.

    Args:
        folder: Folder of the process, with the library ``jobs``.
        machine: The machine.
        options: Further options of the command.
    """

    def __init__(self, folder: Path, machine: str, options: Sequence[str] = ()) -> None:
        (folder / "jobs").mkdir(exist_ok=True)
        environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "HOME": str(folder),
            "XDG_STATE_HOME": str(folder / "state"),
            "NUMBA_CACHE_DIR": str(cache_folder()),
            "XDG_CACHE_HOME": str(tables.cache_folder().parent),
        }
        arguments = ["serve", "--port", "0", "--library", "jobs", "--machine", machine, *options]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "cnc.cli", *arguments],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        self._key = ""
        self._key = self("POST", "control", {"client": "test"})["key"]

    def __call__(self, method: str, path: str, body: Any = None) -> Any:
        """Send a request; return the answer. A refusal fails the test with the server's words."""
        request = urllib.request.Request(
            f"{self.url}api/{path}",
            data=None if body is None else json.dumps(body).encode(),
            method=method,
            headers={"Content-Type": "application/json", "X-Control": self._key},
        )
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return json.loads(answer.read())
        except urllib.error.HTTPError as error:
            raise AssertionError(f"{method} {path}: {error.code}: {error.read()!r}") from error

    def owner_of(self, port: str) -> int:
        """Return the number of the process that has opened a port (Linux: proc(5))."""
        wanted = os.path.realpath(port)
        for process in _descendants(self.process.pid):
            with suppress(OSError):
                for each in Path(f"/proc/{process}/fd").iterdir():
                    with suppress(OSError):
                        if os.readlink(each) == wanted:
                            return process
        raise LookupError(f"no process of the server has opened {port}")

    def close(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def _descendants(process: int) -> list[int]:
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [process, *(each for child in children for each in _descendants(int(child)))]
