"""Benchmark of the page of a finishing pass: time, memory, size, opening and rotation.

python -m benchmarks.view [--moves N] [--exact]

``--exact`` uses G61, which needs the most strokes. The browser is Chromium with software rendering.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
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
TURN = """opened.then(async m => {
  const {gl} = m.scene, pixel = new Uint8Array(4), frames = [];
  for (let i = 0; i < 20; i++) {
    m.scene.rotate(6, 1);
    const began = performance.now();
    m.draw();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    frames.push(performance.now() - began);
    if (frames.at(-1) > SLOW) m.scene.coarse = Math.min(2 * m.scene.coarse, 64);
  }
  return frames;
})"""


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
            frames = browser.evaluate(TURN)
            print(f"rotated: first frame {frames[0]:.0f} ms, then {sorted(frames[10:])[5]:.0f} ms")


if __name__ == "__main__":
    main()
