"""Compare the behaviour of two versions of the code over many programs.

Use, from the root of the repository::

    python -m tests.golden.golden collect FOLDER           write the programs, once
    python -m tests.golden.golden record FOLDER OLD.json   run them, before the change
    python -m tests.golden.golden record FOLDER NEW.json   run them, after the change
    python -m tests.golden.golden compare OLD.json NEW.json

``record`` runs the code in the current folder. ``--entry MODULE:FUNCTION`` names another entry
point. ``--only TEXT`` runs the cases whose names contain TEXT. ``compare`` lists each difference
with its program and artefact.

Every case of the manifest is a command line. The record has its exit code, the place and code of
each message on standard error, the summary, and the SHA-256 of each output file. It leaves out
times, folders and the wording of messages. The summary is kept as a whole, so that ``compare``
names the figure that differs.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import hashlib
import importlib
import io
import json
import multiprocessing
import os
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

MANIFEST = "manifest.json"
EXTENSIONS = {"blocks": ".jsonl", "trace": ".npz", "pulses": ".npz", "lines": ".nc", "port": ".npz"}
"""The output files of a case: names of options of ``cncrun``, and the extensions of their files."""
PATHS = {"file", "program", "first", "second"}
"""Keys of the summary that hold a path."""
LEFT_OUT = {"timing", "lines_per_s", "steps_per_s", "message", "hint"}
"""Keys of the summary that depend on the computer, or are text for people."""
PLACE = re.compile(
    r"^(?:(?P<file>.+?):(?P<line>\d+):(?:(?P<column>\d+):)? |.+?: )?"
    r"(?P<code>[a-z0-9]+(?:-[a-z0-9]+)+): ",
    re.M,
)
"""A message on standard error: an optional place, and the code."""

Case = dict[str, Any]
Result = dict[str, Any]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line.

    Returns:
        The exit code: 0, or 1 if two records differ.
    """
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    commands = parser.add_subparsers(dest="command", required=True)
    collecting = commands.add_parser("collect", help="write the programs and the manifest")
    collecting.add_argument("folder", type=Path)
    recording = commands.add_parser("record", help="run all cases and write their results")
    recording.add_argument("folder", type=Path)
    recording.add_argument("result", type=Path)
    recording.add_argument("--workers", type=int, default=2, help="processes (2)")
    recording.add_argument("--entry", help="module:function; the installed cncrun if left out")
    recording.add_argument("--only", default="", help="a part of the names of the cases to run")
    comparing = commands.add_parser("compare", help="list the differences of two records")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "collect":
        from tests.golden.collect import collect

        print(f"{collect(options.folder)} cases in {options.folder}")
        return 0
    if options.command == "record":
        return _record(options)
    differences = compare(_read(options.old), _read(options.new))
    print(*differences, f"differences: {len(differences)}", sep="\n")
    return 1 if differences else 0


def _read(file: Path) -> dict[str, Any]:
    """Return the contents of a JSON file."""
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


# Recording


def _record(options: argparse.Namespace) -> int:
    """Run all cases of a folder and write the record."""
    folder = options.folder.resolve()
    cases = [case for case in _read(folder / MANIFEST)["cases"] if options.only in case["name"]]
    entry = options.entry or _installed_entry()
    code = importlib.import_module(entry.split(":")[0]).__file__
    print(f"{len(cases)} cases with {entry} of {code}", flush=True)
    begin, results = time.monotonic(), {}
    # A fork would inherit threads of the import above. `check --jobs` needs workers with children,
    # which a multiprocessing.Pool forbids.
    initial = (str(folder), entry)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.workers, context, _prepare, initial) as pool:
        running = [pool.submit(_timed_run, case) for case in cases]
        for count, done in enumerate(as_completed(running), 1):
            name, result, seconds = done.result()
            results[name] = result
            if seconds > 10 or count % 500 == 0:
                passed = time.monotonic() - begin
                print(f"{count} cases, {passed:.0f} s: {name} {seconds:.1f} s", flush=True)
    text = json.dumps({"cases": results}, indent=0, sort_keys=True)
    options.result.write_text(text + "\n", encoding="utf-8")
    codes = Counter(str(result["exit"]) for result in results.values())
    print(f"{time.monotonic() - begin:.0f} s; exit codes:", dict(sorted(codes.items())))
    return 0


def _installed_entry() -> str:
    """Return ``module:function`` of the installed ``cncrun``."""
    found = {entry.value for entry in entry_points(group="console_scripts", name="cncrun")}
    if len(found) != 1:
        sys.exit(f"{len(found)} programs cncrun are installed: name one with --entry")
    return found.pop()


_run_command: Callable[[], None]
"""The entry point in a worker process."""


def _prepare(folder: str, entry: str) -> None:
    """Prepare a worker process for cases in ``folder``."""
    global _run_command
    module, _, function = entry.partition(":")
    _run_command = getattr(importlib.import_module(module), function)
    os.chdir(folder)
    os.environ["COLUMNS"] = "500"


def _timed_run(case: Case) -> tuple[str, Result, float]:
    """Run a case and return its name, result and seconds."""
    begin = time.monotonic()
    result = run_case(case)
    return case["name"], result, time.monotonic() - begin


def run_case(case: Case) -> Result:
    """Run a case in this process.

    Returns:
        Its exit code, messages, summary and the hashes of its files.
    """
    with tempfile.TemporaryDirectory(prefix="golden-") as scratch:
        files = {name: Path(scratch, name + EXTENSIONS[name]) for name in case["outputs"]}
        options = [part for name, file in files.items() for part in (f"--{name}", str(file))]
        code, out, err = _call([*case["arguments"], *options])
        hashes = {name: file_hash(file) for name, file in files.items() if file.exists()}
    messages = [_message(found) for found in PLACE.finditer(err)]
    return {"exit": code, "messages": messages, "summary": summary_of(out), "files": hashes}


def _call(arguments: list[str]) -> tuple[int | str | None, str, str]:
    """Call the entry point as the shell does.

    Returns:
        Exit code, standard output and standard error. An escaped exception is a code of its own.
    """
    out, err = io.StringIO(), io.StringIO()
    before = sys.argv, sys.stdin
    sys.argv, sys.stdin = ["cncrun", *arguments], io.StringIO()
    code: int | str | None = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            _run_command()
    except SystemExit as end:
        code = end.code
    except Exception as error:
        code = f"exception {type(error).__name__}"
    finally:
        sys.argv, sys.stdin = before
        gc.unfreeze()
    return code, out.getvalue(), err.getvalue()


def _message(found: re.Match[str]) -> str:
    """File, line, column and code of a message."""
    name = Path(found["file"] or "").name
    return f"{name}:{found['line'] or ''}:{found['column'] or ''}: {found['code']}"


def summary_of(text: str) -> Any:
    """Return the JSON of standard output without the keys LEFT_OUT.

    A list of summaries becomes a dict by program. Other text is returned unchanged, and None
    without any.
    """
    if not text.strip():
        return None
    try:
        found = _plain(json.loads(text), "")
    except json.JSONDecodeError:
        return text
    return {each["program"]: each for each in found} if isinstance(found, list) else found


def _plain(value: Any, key: str) -> Any:
    """Return a value of the summary; of a path only the name of the file."""
    if isinstance(value, dict):
        return {name: _plain(each, name) for name, each in value.items() if name not in LEFT_OUT}
    if isinstance(value, list):
        return [_plain(each, key) for each in value]
    return Path(value).name if isinstance(value, str) and key in PATHS else value


def file_hash(file: Path) -> str:
    """Return the SHA-256 of the arrays of an .npz file, or of text without the current folder."""
    digest = hashlib.sha256()
    if file.suffix != ".npz":
        digest.update(file.read_bytes().replace(os.fsencode(Path.cwd()) + b"/", b""))
        return digest.hexdigest()
    import numpy as np

    with np.load(file) as arrays:
        for name in sorted(arrays.files):
            array = arrays[name]
            digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


# Comparing


def compare(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Return a line for each difference of two records, with case and artefact."""
    before, after = old["cases"], new["cases"]
    found = [f"{name}: only in the old record" for name in sorted(before.keys() - after.keys())]
    found += [f"{name}: only in the new record" for name in sorted(after.keys() - before.keys())]
    for name in sorted(before.keys() & after.keys()):
        found += [f"{name}: {line}" for line in _differences(before[name], after[name], "")]
    return found


_ABSENT = object()


def _differences(old: Any, new: Any, where: str) -> Iterator[str]:
    """Yield each differing value with its place in the result."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            place = f"{where}.{key}" if where else key
            yield from _differences(old.get(key, _ABSENT), new.get(key, _ABSENT), place)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (first, second) in enumerate(zip(old, new, strict=True)):
            yield from _differences(first, second, f"{where}[{index}]")
    elif type(old) is not type(new) or old != new:
        yield f"{where}: {_shown(old)} -> {_shown(new)}"


def _shown(value: Any) -> str:
    """Return a value as short text."""
    text = "absent" if value is _ABSENT else json.dumps(value)
    return text if len(text) <= 120 else text[:117] + "..."


if __name__ == "__main__":
    sys.exit(main())
