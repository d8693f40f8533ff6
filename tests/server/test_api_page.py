"""The commands of docs/how-to/api.md, in a shell, against a real server."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys

import pytest

from tests.support.paths import ROOT

pytestmark = pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")


@pytest.mark.soak
def test_the_commands_of_the_page_run_a_job(tmp_path):
    page = (ROOT / "docs/how-to/api.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
    assert len(blocks) >= 6
    command = f'cncrun() {{ exec "{sys.executable}" -m cnc.cli "$@"; }}\n'
    ending = "\nkill %1\nwait\n"
    script = command + "set -e -m\ntrap 'kill %1' EXIT\n" + "".join(blocks) + "trap - EXIT" + ending
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(tmp_path / "state")},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout
    assert "True" in lines
    history = json.loads(re.search(r'\[\{"job".*?\}\]', lines)[0])
    assert (history[0]["job"], history[0]["outcome"]) == ("part.nc", "done")
    assert "{'x': 4.0, 'y': 3.0, 'z': 0.0}" in lines
    assert json.loads((tmp_path / "check.json").read_text())["lines"] == 4
