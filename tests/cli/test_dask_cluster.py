"""Checks on a Dask cluster: the output of local checks, also if workers die."""

import json
import os
import pickle
import signal
import subprocess
import sys
import zlib

import pytest

from cnc import cli
from cnc.api import RunOptions, check_many
from cnc.batch import dask_cluster
from cnc.model.diagnostics import UsageError
from tests.support.paths import ROOT

GOOD = "G21 G90 G94\nG0 X5 Y5\nG1 X10 F600\nG2 X20 Y5 I5 J0\nM2\n"
SLOW = "#1 = 0\no1 while [#1 LT 100000]\n#1 = [#1 + 1]\no1 endwhile\nM2\n"
"""A program that takes at least 0.1 s to check."""


def lasting(reports: str) -> list[dict]:
    """Return the reports without computing times."""
    clocks = ("timing", "lines_per_s", "steps_per_s")
    return [
        {key: value for key, value in each.items() if key not in clocks}
        for each in json.loads(reports)
    ]


@pytest.fixture(scope="module")
def cluster():
    """Start a cluster; yield the address of its scheduler and the processes of its workers."""
    command = [sys.executable, str(ROOT / "tests/support/cli/farm_cluster.py")]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    ) as process:
        try:
            address, *workers = process.stdout.readline().decode().split()
            yield address, [int(each) for each in workers]
        finally:
            process.stdin.close()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


@pytest.mark.usefixtures("one_process")
def test_a_dead_worker_loses_and_repeats_no_report(cluster, tmp_path, capfd, monkeypatch):
    address, workers = cluster
    kinds = {"good": GOOD, "slow": SLOW, "bad": "G2 X5\n", "sub": "o<part> call\nM2\n"}
    for number in range(16):
        kind = list(kinds)[number % 4]
        (tmp_path / f"{number:02d}-{kind}.nc").write_text(kinds[kind])
    (tmp_path / "part.ngc").write_text("o<part> sub\nG0 X1\no<part> endsub\n")
    names = [*(str(file) for file in sorted(tmp_path.glob("*.nc"))), str(tmp_path / "nowhere.nc")]

    reported, outcome = [], dask_cluster._outcome

    def killing(*arguments):
        reported.append(arguments)
        if len(reported) == 3:
            os.kill(workers[0], signal.SIGKILL)
        return outcome(*arguments)

    monkeypatch.setattr(dask_cluster, "_outcome", killing)
    there = cli.exit_code(["check", *names, "--scheduler", address, "--format", "json"])
    assert len(reported) == 16
    out, err = capfd.readouterr()
    home = cli.exit_code(["check", *names, "--jobs", "1", "--format", "json"])
    same_out, same_err = capfd.readouterr()
    assert there == home == 2
    assert lasting(out) == lasting(same_out)
    assert [each["program"] for each in lasting(out)] == names
    assert [each["ok"] for each in lasting(out)] == [True, True, False, True] * 4 + [False]
    assert err == same_err


def test_one_program_and_usage_errors_on_a_cluster(cluster, tmp_path, capfd):
    address, _ = cluster
    (tmp_path / "a.nc").write_text(GOOD)
    assert (
        cli.exit_code(
            [
                "check",
                str(tmp_path / "a.nc"),
                "--scheduler",
                address,
                "--json",
                str(tmp_path / "a.json"),
            ]
        )
        == 0
    )
    assert "path length" in capfd.readouterr().out
    assert json.loads((tmp_path / "a.json").read_text())["ok"]
    with pytest.raises(UsageError, match="unknown-dialect"):
        list(
            check_many(
                [tmp_path / "a.nc"], None, RunOptions(portable=("fanuk",)), scheduler=address
            )
        )
    assert cli.exit_code(["check", str(tmp_path), "--scheduler", address, "--jobs", "2"]) == 2


def test_a_worker_of_another_version_is_reported():
    answer = pickle.loads(zlib.decompress(dask_cluster.perform(b"", "0.0.1")))
    assert isinstance(answer, UsageError)
    assert answer.diagnostic.code == "farm-version"


def test_an_unreachable_scheduler_is_reported(monkeypatch, tmp_path, capfd):
    (tmp_path / "a.nc").write_text(GOOD)
    monkeypatch.setattr(dask_cluster, "TIMEOUT", 0.5)
    for address in "tcp://127.0.0.1:9", "nonsense://x", "no address":
        assert cli.exit_code(["check", str(tmp_path), "--scheduler", address]) == 2
        assert f"farm-unreachable: no scheduler answers at {address}: " in capfd.readouterr().err


def test_without_dask_the_message_names_the_package(monkeypatch, tmp_path, capfd):
    (tmp_path / "a.nc").write_text(GOOD)
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert cli.exit_code(["check", str(tmp_path), "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "pip install 'cncrun[farm]'" in capfd.readouterr().err
