"""Benchmark of the page of a finishing pass: time, memory, size, opening, dragging and zooming.

python -m benchmarks.view [--moves N] [--exact]

``--exact`` uses G61, which needs the most strokes. The browser is Chromium with software rendering.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks import finishing
from tests.support.view.browser import FOUND, INSTALL, Browser

MACHINE = """[path]
max_feed = 100
max_tangential_acceleration = 1000
max_normal_acceleration = 1000
max_jerk = 50000
""" + "".join(f"[axes.{axis}]\nsteps_per_mm = 100\nmax_velocity = 100\n" for axis in finishing.AXES)
OPENINGS = 3
RECORD = """opened.then(m => {
  const {gl} = m.scene, pixel = new Uint8Array(4), draw = m.scene.draw.bind(m.scene);
  window.frames_ms = [];
  m.scene.draw = settings => {
    const began = performance.now();
    draw(settings);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);  // waits for the picture
    frames_ms.push(performance.now() - began);
  };
})"""
MOVES_OF_POINTER = 60
FRAME = 1.0 / 60.0
"""s between two moves of the pointer."""


def frames(browser: Browser, move: Callable[[int], None]) -> str:
    """Return how long the frames take while something moves, which are few if they are slow."""
    browser.evaluate("frames_ms.length = 0")
    for number in range(MOVES_OF_POINTER):
        move(number)
        time.sleep(FRAME)
    taken = [float(each) for each in browser.evaluate("frames_ms")]
    p50, p95 = (sorted(taken)[int(share * (len(taken) - 1))] for share in (0.5, 0.95))
    return f"first frame {taken[0]:.0f} ms, median {p50:.0f} ms, p95 {p95:.0f} ms"


def moved(browser: Browser) -> Iterator[str]:
    """Yield the figures of a view that is dragged, and of one that is magnified."""
    browser.evaluate(RECORD)
    time.sleep(2.0)  # the view is at rest
    browser.mouse("mousePressed", 400, 200, button="left", buttons=1, clickCount=1)

    def drag(number: int) -> None:
        browser.mouse("mouseMoved", 400 + 4 * number, 200 + number, button="left", buttons=1)

    yield f"dragged: {frames(browser, drag)}"
    browser.mouse("mouseReleased", 640, 260, button="left", clickCount=1)
    time.sleep(2.0)

    def zoom(number: int) -> None:
        step = -40 if number < MOVES_OF_POINTER // 2 else 40
        browser.mouse("mouseWheel", 400, 200, deltaX=0, deltaY=step)

    yield f"zoomed: {frames(browser, zoom)}"


def memory(browser: Browser) -> str:
    """Return the memory of the page: of its script, and of the processes that draw it."""
    used = browser.call("Runtime.getHeapUsage")
    script = used["usedSize"] + used["backingStorageSize"]
    texts = []
    for kind in ("renderer", "gpu-process"):
        pages = 0
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                arguments = (folder / "cmdline").read_bytes()
                ours = os.getsid(int(folder.name)) == browser.session
                if ours and f"--type={kind}".encode() in arguments:
                    pages = max(pages, int((folder / "statm").read_text().split()[1]))
            except OSError:
                continue
        texts.append(f"{kind} {pages * resource.getpagesize() / 1e6:.0f} MB resident")
    return f"script {script / 1e6:.0f} MB, {', '.join(texts)}"


def main() -> None:
    """Make the page, open it, rotate it, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--moves", type=int, default=1_000_000)
    parser.add_argument("--exact", action="store_true")
    options = parser.parse_args()
    if FOUND is None:
        sys.exit(f"chromium is not installed: {INSTALL}")
    with tempfile.TemporaryDirectory() as folder:
        program, machine, page = (
            Path(folder) / name for name in ("p.nc", "machine.toml", "p.html")
        )
        machine.write_text(MACHINE)
        with program.open("w") as file:
            for line in finishing.lines(options.moves):
                file.write(("G61" if options.exact and line.startswith("G64") else line) + "\n")
        began = time.perf_counter()
        command = [sys.executable, "-m", "cnc.cli", "view", str(program), "--quiet"]
        subprocess.run([*command, "--machine", str(machine), "-o", str(page)], check=True)
        took = time.perf_counter() - began
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = used.ru_utime + used.ru_stime
        print(f"{options.moves} moves, program {program.stat().st_size / 1e6:.1f} MB")
        print(f"made in {took:.1f} s ({cpu:.1f} CPU s), {used.ru_maxrss / 1e3:.0f} MB of memory")
        print(f"page {page.stat().st_size / 1e6:.1f} MB")
        with Browser(1400, 860) as browser:
            opened = [int(browser.open(page)) for _ in range(OPENINGS)]
            print(f"opened in {', '.join(map(str, opened))} ms")
            print(browser.evaluate("document.getElementById('accuracy').textContent"))
            for figures in moved(browser):
                print(figures)
            print(memory(browser))


if __name__ == "__main__":
    main()
