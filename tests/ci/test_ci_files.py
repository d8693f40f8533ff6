"""The pre-commit hook, the GitHub Action and GitLab's job, run as a pipeline runs them."""

import os
import re
import shlex
import subprocess
import sys
from xml.etree import ElementTree

import pytest
import yaml

from tests.support.paths import ROOT
from tests.support.soak import soaking

GOOD = "G21 G90 G94\nG1 X10 F600\nM2\n"
BAD = "G21 G90 G94\nG1 X10 F600\nG2 X20 Y5 I5 J9\nM2\n"


@pytest.fixture
def shop(tmp_path):
    """A folder of programs, and an environment in which cncrun is installed."""
    commands = tmp_path / "bin"
    commands.mkdir()
    command = commands / "cncrun"
    command.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -P -m cnc.cli "$@"\n')
    command.chmod(0o755)
    # compiled kernels of this run are used
    environment = os.environ | {
        "PATH": f"{commands}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "PRE_COMMIT_HOME": str(tmp_path / "cache"),
        "GIT_CONFIG_GLOBAL": os.devnull,
        "GITHUB_ACTION_PATH": str(ROOT),
    }
    folder = tmp_path / "shop"
    (folder / "parts" / "old").mkdir(parents=True)
    (folder / "parts" / "good.nc").write_text(GOOD)
    (folder / "parts" / "old" / "GOOD.NGC").write_text(GOOD)
    (folder / "readme.txt").write_text("G2 no program\n")

    def carry_out(
        *command: str, check: bool = False, **more: str
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command,
            cwd=folder,
            env=environment | more,
            capture_output=True,
            text=True,
            check=check,
            timeout=1700,
        )

    carry_out.folder = folder
    return carry_out


def hook(**changed: str) -> dict:
    (found,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
    return found | changed


def test_the_hook_file_is_valid(shop):
    done = shop(
        sys.executable,
        "-m",
        "pre_commit",
        "validate-manifest",
        str(ROOT / ".pre-commit-hooks.yaml"),
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.soak
def test_the_hook_checks_programs_only(shop):
    """pre-commit runs the entry on the files that it names, with the cncrun of this environment."""
    config = {"repos": [{"repo": "local", "hooks": [hook(language="system")]}]}
    (shop.folder / ".pre-commit-config.yaml").write_text(yaml.safe_dump(config))
    shop("git", "init", "-q", check=True)
    shop("git", "add", ".", check=True)
    if soaking():
        done = shop(sys.executable, "-m", "pre_commit", "run", "--all-files")
        assert done.returncode == 0, done.stdout + done.stderr
    (shop.folder / "parts" / "bad.TAP").write_text(BAD)
    shop("git", "add", ".", check=True)
    done = shop(sys.executable, "-m", "pre_commit", "run", "--all-files")
    assert done.returncode == 1
    errors = re.findall(r"^(\S+): ([a-z-]+): ", done.stdout, re.MULTILINE)
    assert errors == [("parts/bad.TAP:3:11", "arc-radius-mismatch")], done.stdout


def test_the_hook_names_the_suffixes_of_a_folder_search():
    from cnc.cli.checking import SUFFIXES

    pattern = re.compile(hook()["files"])
    for suffix in SUFFIXES:
        assert pattern.search(f"a/b{suffix}")
        assert pattern.search(f"B{suffix.upper()}")
    assert not any(map(pattern.search, ["a.ncx", "nc", "a.nc/b.txt", "gcode"]))


@pytest.mark.timeout(1800)
@pytest.mark.skipif(
    not soaking(), reason="installs everything anew, and compiles the kernels there"
)
def test_the_hook_is_installed_by_pre_commit_itself(shop):
    (shop.folder / "parts" / "bad.nc").write_text(BAD)
    shop("git", "init", "-q", check=True)
    shop("git", "add", ".", check=True)
    done = shop(
        sys.executable,
        "-m",
        "pre_commit",
        "try-repo",
        str(ROOT),
        "cncrun-check",
        "--all-files",
        PYTHONPATH="",
    )
    assert done.returncode == 1
    assert "parts/bad.nc:3:11: arc-radius-mismatch" in done.stdout


def action(shop, name: str, **inputs: str) -> subprocess.CompletedProcess[str]:
    """Run a step of the action as GitHub's runner does.

    Inputs replace their expressions, and bash is called with the runner's options.
    """
    described = yaml.safe_load((ROOT / "action.yml").read_text())
    assert described["runs"]["using"] == "composite"
    (step,) = [each for each in described["runs"]["steps"] if each.get("name") == name]
    known = {key: each["default"] for key, each in described["inputs"].items()} | inputs
    assert known.keys() == described["inputs"].keys()

    def filled(text: str) -> str:
        return re.sub(r"\$\{\{\s*inputs\.(\w+)\s*\}\}", lambda each: known[each[1]], text)

    assert "${{" not in step["run"]  # input in a script would be run as code
    assert step["shell"] == "bash"
    (shop.folder.parent / "step.sh").write_text(step["run"])
    environment = {key: filled(text) for key, text in step.get("env", {}).items()}
    script = str(shop.folder.parent / "step.sh")
    return shop("bash", "--noprofile", "--norc", "-e", "-o", "pipefail", script, **environment)


def test_the_action_annotates(shop):
    (shop.folder / "parts" / "bad.nc").write_text(BAD)
    done = action(shop, "Check", arguments="--jobs 1")
    assert done.returncode == 1
    assert done.stdout.startswith(
        "::error file=parts/bad.nc,line=3,endLine=3,col=11,endColumn=13,title=arc-radius-mismatch::"
    )
    good = action(
        shop,
        "Check",
        programs="parts/**/*.NGC parts/good.nc parts/old",
        machine="grbl-uno",
        arguments="--fail-on note --portable grbl --jobs 1",
    )
    assert good.returncode == 0
    assert action(shop, "Check", programs="$(touch${IFS}hacked)").returncode == 2
    assert not (shop.folder / "hacked").exists()


@pytest.mark.skipif(not soaking(), reason="installs everything anew")
def test_the_action_installs(shop):
    subprocess.run([sys.executable, "-m", "venv", str(shop.folder.parent / "venv")], check=True)
    path = f"{shop.folder.parent / 'venv' / 'bin'}{os.pathsep}{os.environ['PATH']}"
    done = action(shop, "Install")
    assert done.returncode == 0, done.stderr
    assert shop("cncrun", "--version", PATH=path, PYTHONPATH="").returncode == 0


def gitlab() -> dict:
    """The job of docs/how-to/ci.md."""
    page = (ROOT / "docs/how-to" / "ci.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```yaml\n# \.gitlab-ci\.yml\n(.*?)```", page, re.DOTALL)
    return yaml.safe_load(text)


@pytest.mark.soak
@pytest.mark.parametrize("broken", [False, True])
def test_gitlabs_job_reports(shop, broken):
    if broken:
        (shop.folder / "parts" / "bad.nc").write_text(BAD)
    job = gitlab()["check-gcode"]
    install, *script = job["script"]
    assert install.startswith("pip install ")
    done = shop("bash", "-e", "-c", "\n".join(script))
    assert done.returncode == broken
    report = ElementTree.parse(shop.folder / job["artifacts"]["reports"]["junit"]).find("testsuite")
    assert (report.get("tests"), report.get("failures")) == (("3", "1") if broken else ("2", "0"))
    # a failed job shows its report as well
    assert job["artifacts"]["when"] == "always"


def test_the_other_snippets_name_hooks_and_inputs_that_exist():
    page = (ROOT / "docs/how-to" / "ci.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```yaml\n# \.pre-commit-config\.yaml\n(.*?)```", page, re.DOTALL)
    (used,) = yaml.safe_load(text)["repos"][0]["hooks"]
    assert used["id"] == hook()["id"]
    (text,) = re.findall(r"```yaml\n# \.github/workflows/gcode\.yml\n(.*?)```", page, re.DOTALL)
    (step,) = [
        each for each in yaml.safe_load(text)["jobs"]["gcode"]["steps"] if "/cnc@" in each["uses"]
    ]
    assert step["with"].keys() <= yaml.safe_load((ROOT / "action.yml").read_text())["inputs"].keys()
