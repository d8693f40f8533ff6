"""Calls of subroutines in other windows of the text: equal blocks in compiled code."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from cnc.gcode.core import compiled_program
from cnc.gcode.core.compiled_program import CompiledProgram
from cnc.gcode.core.program import interpret
from cnc.gcode.reader import source_text
from cnc.gcode.reader.source_text import Text, Window
from cnc.model.blocks import Polyline
from tests.gcode.program.test_compiled_lines_in_programs import INSIDE, agree
from tests.gcode.program.test_plain_lines import AXES
from tests.support.gcode.flow_author import Author as FlowAuthor
from tests.support.gcode.flow_writers import OWords
from tests.support.soak import share


def program(rng: random.Random, seed: int) -> list[str]:
    """Subroutines that call each other, with calls of them far away."""
    flow = OWords(FlowAuthor(seed).program(), seed).text()
    lines = ["G1 F100", "#<n>=1", "#<_g>=2"]
    for name in ("<a>", "71", "72"):
        lines += [f"o{name} sub", "#<n>=[#1+1]", f"X#1 Y[#<n>+#2] Z[#<_g>+{rng.randint(0, 3)}]"]
        if rng.random() < 0.5:
            lines += ["o7 if [#1 GT 2]", "#<_g>=[#<_g>+1]", "o7 else", "G91 X1", "G90", "o7 endif"]
        if rng.random() < 0.5:
            lines += ["#5=0", "o8 while [#5 LT 3]", "X#5", "#5=[#5+1]", "o8 endwhile"]
        if rng.random() < 0.4:
            lines += [f"o9 repeat [{rng.randint(0, 3)}]", "Y[#1]", "o9 endrepeat"]
        if name != "<a>" and rng.random() < 0.6:
            lines += [rng.choice(["o<a> call [#1] [2]", "o71 call [#1-1]"])]
        if rng.random() < 0.2:
            lines += [rng.choice(INSIDE)]
        lines += [f"o{name} endsub" + rng.choice(["", "", " [#1*2]"])]
        lines += ["X1"] * rng.choice([0, 3, 30])
    for _ in range(rng.randint(1, 12)):
        lines += ["X2 Y2"] * rng.choice([0, 1, 9, 40])
        lines += [rng.choice([
            "o71 call [#<n>] [1]", "o72 call [3]", "o<a> call", "o<a> call [1] [2]", "X#<_value>",
            "#<n>=[#<n>+1]", *INSIDE,
        ])]  # fmt: skip
    return [*lines, *flow] if rng.random() < 0.3 else lines


@pytest.mark.timeout(3600)
def test_random_calls_across_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(share(40_000, 25)):
        rng = random.Random(seed)
        with monkeypatch.context() as patch:
            # Windows of some lines, so that calls lead to other windows.
            patch.setattr(source_text, "_FIRST_LINES", rng.choice([4, 16, 64]))
            patch.setattr(source_text, "_MOST_LINES", rng.choice([8, 32, 128]))
            agree(patch, program(rng, seed), AXES[0], rng.choice(["auto", "linuxcnc"]))


def test_calls_across_windows_run_in_compiled_code(monkeypatch: pytest.MonkeyPatch) -> None:
    sub = ["o<hole> sub", "G0 X#1 Y#2", "o1 if [#1 GT 5]", "G1 Z-1", "o1 endif", "o<hole> endsub"]
    lines = ["G90 F100", *sub, *(f"o<hole> call [{n % 9}] [{n}]" for n in range(3000)), "M2"]
    executed: list[int] = []
    run = CompiledProgram.run

    def counted(self: CompiledProgram, window: Window, line: int) -> int | None:
        before = self._flow.executed
        after = run(self, window, line)
        executed.append(self._flow.executed - before)
        return after

    monkeypatch.setattr(compiled_program.CompiledProgram, "run", counted)
    monkeypatch.setattr(source_text, "_MOST_LINES", 512)
    blocks = list(interpret(Text.of_lines(lines, "t")))
    moves = sum(len(block.points) for block in blocks if isinstance(block, Polyline))
    assert moves == 3000 + sum(n % 9 > 5 for n in range(3000))
    assert sum(executed) > 10_000, "calls, moves, conditions and returns"


def test_a_call_keeps_names_of_other_windows_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name that was set in an earlier window belongs to the caller, not to the call."""
    monkeypatch.setattr(source_text, "_MOST_LINES", 512)
    sub = ["o9 sub", "G4 P0", "X[EXISTS[#<own>]]", "#<own> = 7", "#<_all> = #<own>", "o9 endsub"]
    before = ["#<own> = 2", *["X1"] * 700]
    calls = [*["X1 Y[1 + 1]"] * 700, "o9 call", "(debug, asks for a name: #<_all>)", "o9 call"]
    after = [*["X1"] * 700, "Y[#<own>] Z[#<_all>]", "M2"]
    lines = ["G90 G1 F100", *sub, *before, *calls, *after]
    agree(monkeypatch, lines, AXES[0], "linuxcnc")
    moves = [block for block in interpret(Text.of_lines(lines, "t")) if isinstance(block, Polyline)]
    assert moves[-1].points[-1, 1:3].tolist() == [2.0, 7.0]


def test_small_and_capital_letters_beyond_ascii_are_equal(tmp_path: Path) -> None:
    """Compiled code reads bytes, the interpreter reads characters."""
    file = tmp_path / "t.ngc"
    moves = "X[1 + 1]\n" * 700
    file.write_text(f"G90 G1 F100\n#<\u00e9> = 3\n{moves}Y[#<\u00c9>]\nM2\n", encoding="utf-8")
    found = [block for block in interpret(Text.of_file(file)) if isinstance(block, Polyline)]
    assert found[-1].points[-1, 1] == 3.0
