"""Headless Chromium, driven by the Chrome DevTools Protocol over a pair of pipes.

Each message is JSON with a NUL at its end.
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

from tests.support.waiting import HANG

FOUND = shutil.which("chromium")
INSTALL = "apt-get install chromium"
FLAGS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--no-sandbox",
    "--disable-gpu-sandbox",
    "--use-angle=swiftshader",
    "--hide-scrollbars",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-extensions",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-gpu-compositing",
    "--disable-gpu-rasterization",
    "--force-color-profile=srgb",
)

NO_POPUP = (
    "WebUIOmniboxPopup",
    "WebUIOmniboxAimPopup",
    "WebUIOmniboxFullPopup",
)
"""Features of Chromium that load the suggestions of its address bar for each window: these pages
take more than half of the processor time of a new window.
"""

READY = "document.documentElement?.dataset.opened || document.documentElement?.dataset.failed"
"""JavaScript: the ms that the page of a picture took to open, or its error."""


class Browser:
    """A tab of the browser. ``events`` has the method and parameters of its notifications."""

    def __init__(self, width: int = 1280, height: int = 800) -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []
        self._folder = tempfile.TemporaryDirectory(
            prefix="cnc-browser-", ignore_cleanup_errors=True
        )
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        # The browser reads file descriptor 3 and writes 4; a shell connects the pipes to them.
        shell = f'exec "$@" 3<&{to_browser} 4>&{from_browser}'
        command = [
            FOUND or "chromium",
            *FLAGS,
            f"--disable-features={','.join(NO_POPUP)}",
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
            self.call("Browser.close", timeout=60.0)
            self._process.wait(60.0)
        except (OSError, EOFError, TimeoutError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._read)
        os.close(self._write)
        self._folder.cleanup()

    @property
    def session(self) -> int:
        """The session of its processes."""
        return self._process.pid

    def call(self, method: str, timeout: float = HANG, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        until = monotonic() + timeout
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
                raise EOFError("the browser has ended")
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        decoded: dict[str, Any] = json.loads(message)
        return decoded

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, or of the promise that it returns."""
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
        """Load a file, wait until ``ready`` is true, and return its value."""
        self.events.clear()
        self.call("Page.navigate", url=page.resolve().as_uri())
        return self.wait(lambda: self.evaluate(ready))

    def wait(self, until: Callable[[], Any], timeout: float = HANG) -> Any:
        """Return the first true value of ``until``."""
        end = monotonic() + timeout
        while not (value := until()):
            if monotonic() > end:
                raise TimeoutError("the condition does not become true")
            # The browser keeps working during this wait.
            self.evaluate("new Promise(done => setTimeout(done, 50))")
        return value

    def dark(self, on: bool) -> None:
        """Select the dark or the light colour scheme."""
        self.call(
            "Emulation.setEmulatedMedia",
            features=[{"name": "prefers-color-scheme", "value": "dark" if on else "light"}],
        )

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Send a mouse event: mouseMoved, mousePressed, mouseReleased or mouseWheel."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        """Click with the left button."""
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
        self.mouse("mouseReleased", x, y, button="left", clickCount=1)

    def screenshot(self, file: Path) -> None:
        """Write the visible part of the page as PNG."""
        file.write_bytes(
            base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        )

    @property
    def complaints(self) -> list[str]:
        """Errors and refused requests in the console."""
        out = []
        for method, parameters in self.events:
            if method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
                out.append(parameters["entry"]["text"])
            if method == "Runtime.exceptionThrown":
                out.append(json.dumps(parameters["exceptionDetails"]))
        return out
