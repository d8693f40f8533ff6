"""Debian's Chromium without a window, by the Chrome DevTools Protocol over a pair of pipes: JSON
with a NUL behind each message.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Any

FOUND = shutil.which("chromium")
INSTALL = "apt-get install chromium"
FLAGS = (
    "--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader", "--hide-scrollbars",
    "--enable-unsafe-swiftshader", "--no-first-run", "--disable-extensions", "--disable-dev-shm-usage", "--disable-background-networking",
    "--force-color-profile=srgb",
)  # fmt: skip

READY = "document.documentElement?.dataset.opened || document.documentElement?.dataset.failed"
"""The page of a picture says how many ms it took, or what is wrong."""


class Browser:
    """A tab. ``events``: what the browser told of its own accord, method and parameters."""

    def __init__(self, width: int = 1280, height: int = 800) -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []
        self._folder = tempfile.TemporaryDirectory(
            prefix="cnc-browser-", ignore_cleanup_errors=True
        )
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        # The browser reads its file 3 and writes its file 4; a shell puts the pipes there.
        shell = f'exec "$@" 3<&{to_browser} 4>&{from_browser}'
        command = [
            FOUND or "chromium",
            *FLAGS,
            f"--window-size={width},{height}",
            f"--user-data-dir={self._folder.name}",
            "about:blank",
        ]
        self._process = subprocess.Popen(
            ["/bin/bash", "-c", shell, "chromium", *command],
            pass_fds=(to_browser, from_browser),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._buffer = b""
        self._number = 0
        self._session: str | None = None
        page = next(
            each for each in self.call("Target.getTargets")["targetInfos"] if each["type"] == "page"
        )
        self._session = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._session = None
        try:
            self.call("Browser.close", patience=10.0)
            self._process.wait(10.0)
        except (OSError, EOFError, TimeoutError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._read)
        os.close(self._write)
        self._folder.cleanup()

    def call(self, method: str, patience: float = 120.0, **parameters: Any) -> dict[str, Any]:
        """Carry out a method; its result."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        until = monotonic() + patience
        while True:
            answer = self._message(until)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                result: dict[str, Any] = answer["result"]
                return result
            if "method" in answer:
                self.events.append((answer["method"], answer["params"]))

    def _message(self, until: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            if not select.select([self._read], [], [], max(0.0, until - monotonic()))[0]:
                raise TimeoutError("the browser does not answer")
            data = os.read(self._read, 1 << 20)
            if not data:
                raise EOFError("the browser has gone")
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        decoded: dict[str, Any] = json.loads(message)
        return decoded

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression, a promise's when it is kept."""
        result = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in result:
            raise RuntimeError(
                result["exceptionDetails"]
                .get("exception", {})
                .get("description", result["exceptionDetails"]["text"])
            )
        return result["result"].get("value")

    def open(self, page: Path, ready: str = READY) -> Any:
        """Load a file and wait until ``ready`` is true; its value."""
        self.events.clear()
        self.call("Page.navigate", url=page.resolve().as_uri())
        return self.wait(lambda: self.evaluate(ready))

    def wait(self, until: Callable[[], Any], patience: float = 60.0) -> Any:
        """The first value that is true."""
        end = monotonic() + patience
        while not (value := until()):
            if monotonic() > end:
                raise TimeoutError("it does not come true")
            # Something to wait for that the browser does meanwhile.
            self.evaluate("new Promise(done => setTimeout(done, 50))")
        return value

    def dark(self, on: bool) -> None:
        """What the user prefers."""
        self.call(
            "Emulation.setEmulatedMedia",
            features=[{"name": "prefers-color-scheme", "value": "dark" if on else "light"}],
        )

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """A mouse event: mouseMoved, mousePressed, mouseReleased, mouseWheel."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        """With the left button."""
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
        self.mouse("mouseReleased", x, y, button="left", clickCount=1)

    def screenshot(self, file: Path) -> None:
        """What is in sight, as PNG."""
        file.write_bytes(
            base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        )

    @property
    def complaints(self) -> list[str]:
        """What the console says of errors and refused loads."""
        out = []
        for method, parameters in self.events:
            if method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
                out.append(parameters["entry"]["text"])
            if method == "Runtime.exceptionThrown":
                out.append(json.dumps(parameters["exceptionDetails"]))
        return out
