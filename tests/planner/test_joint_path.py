"""The path of the joints: on the path of the tip, within the limits of the joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Control, Outputs, RunOptions, check, parse, start_position
from cnc.boards.loopback import Loopback
from cnc.machine.models import Machine
from cnc.model.diagnostics import MachineFileError, MotionLimitError
from cnc.operate.jogging import jog
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import curve_eval, curve_range
from cnc.planner.joints import ACCURACY, Joints
from tests.support.kinematics import MIDDLE, TABLES, machine_of, misfit
from tests.support.planner.legality import compare_files
from tests.support.planner.random_jobs import Job
from tests.support.session.runs import run_with
from tests.support.soak import share

NAMES = list(TABLES)
APART = 20.0 * ACCURACY
"""mm; on these machines an error of ACCURACY degrees moves the tip by less."""
CURVES = """G21 G90 G64 P0.01 F2000
G1 X10 Y0
G3 X20 Y10 I0 J10
G2 X24 Y6 I2 J-2 Z2
G5 I3 J5 P-4 Q6 X12 Y12
G1 X11.8 Y12.3
X11.5 Y12.5
X11.3 Y12.9
X11 Y13
G3 X11 Y13 I-8 J0 Z1
G1 X0 Y0 Z0
M2
"""
FEW = "G21 G90 G64 P0.01 F2000\nG1 X2 Y0\nG3 X4 Y2 I0 J2\nG1 X4.2 Y2.6\nM2\n"


def placed(name: str, program: str) -> str:
    """Return a program that is moved to the middle of the reach of a machine."""
    place = " ".join(f"{axis}{value}" for axis, value in zip("XYZ", MIDDLE[name], strict=True))
    return f"G21 G90 G10 L2 P1 {place}\nG0 X0 Y0 Z0\n{program}"


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    found: str = request.param
    return found


@pytest.fixture
def write(tmp_path: Path):
    def written(text: str) -> Path:
        file = tmp_path / "part.ngc"
        file.write_text(text)
        return file

    return written


def chunks_of(file: Path, name: str) -> list[PathChunk]:
    machine = machine_of(name)
    start = start_position(machine)
    path = build(parse(file, machine), axes=("x", "y", "z"), start=start, tolerance=0.02)
    return [item for item in Joints(machine).path(path, start) if isinstance(item, PathChunk)]


def test_joints_lie_on_the_tips_path_to_the_accuracy(name: str, write) -> None:
    before: np.ndarray | None = None
    for chunk in chunks_of(write(placed(name, CURVES)), name):
        assert chunk.axes[:3] == ("x", "y", "z")
        out = np.empty((4, len(chunk.axes)))
        places = []
        for kind, at in zip(chunk.kind.tolist(), chunk.at.tolist(), strict=True):
            u0, u1 = curve_range(kind, chunk.data, at)
            for u in np.linspace(u0, u1, 9):
                curve_eval(kind, chunk.data, at, float(u), out)
                places.append(out[0].copy())
                if u == u0 and before is not None:
                    assert (out[0] == before).all(), "pieces meet to the last bit"
            before = out[0].copy()
        each = np.array(places)
        assert misfit(name, each[:, 3:], each[:, :3]) < APART


@pytest.mark.parametrize(
    "program", [FEW, pytest.param(CURVES, marks=pytest.mark.soak)], ids=["few", "many"]
)
def test_parts_of_a_piece_meet_without_a_jump_of_a_derivative(name: str, program, write) -> None:
    for chunk in chunks_of(write(placed(name, program)), name):
        left, right = np.empty((4, len(chunk.axes))), np.empty((4, len(chunk.axes)))
        for k in range(len(chunk) - 1):
            same = chunk.line[k] == chunk.line[k + 1] and not chunk.tolerance[k]
            if not same or chunk.stop_after[k]:
                continue
            kinds, at = chunk.kind[k : k + 2].tolist(), chunk.at[k : k + 2].tolist()
            curve_eval(
                kinds[0], chunk.data, at[0], curve_range(kinds[0], chunk.data, at[0])[1], left
            )
            curve_eval(
                kinds[1], chunk.data, at[1], curve_range(kinds[1], chunk.data, at[1])[0], right
            )
            if abs(chunk.data[at[0] + 2] - chunk.data[at[1] + 1]) > 0.0:
                continue  # two pieces with parameters of their own
            scale = np.maximum(1.0, np.abs(left))
            assert (np.abs(left - right) < 1e-6 * scale).all()


@pytest.mark.parametrize("seed", range(share(60, 1)))
def test_random_programs_keep_the_limits_of_every_joint(
    name: str, seed: int, tmp_path: Path
) -> None:
    """The message has the seed, which is a new one in each run."""
    fresh = share(int(np.random.default_rng().integers(2**32)), 1)
    rng = np.random.default_rng([fresh, seed])
    machine = machine_of(name, rng, period=float(rng.choice(share((1e-3, 1e-4), (1e-3,)))))
    job = Job(rng, 8.0)
    program = tmp_path / "part.ngc"
    program.write_text(placed(name, job.write()))
    blocks, trace, pulses = (
        tmp_path / each for each in ("blocks.jsonl", "trace.npz", "pulses.npz")
    )
    outputs = Outputs(blocks=str(blocks), trace=str(trace), pulses=str(pulses))
    report = check(program, machine, RunOptions(outputs=outputs))
    assert report.ok, (fresh, seed, [fault.diagnostic.message for fault in report.faults])
    found = compare_files(blocks, trace, pulses, machine, report.duration_s)
    assert not found.wrong, (fresh, seed, found.wrong)
    rows = np.load(trace)
    assert misfit(name, rows["position"], rows["tool"]) < APART
    moved = np.load(pulses)
    grid = np.cumsum(moved["step"], axis=0) + moved["origin_steps"]
    assert report.pulse_error_blu <= 0.5 + 1e-6
    end = grid[-1] if len(grid) else moved["origin_steps"]
    assert np.abs(end / moved["steps_per_mm"] - rows["position"][-1]).max() <= 0.5 / 100 + 1e-9


REFUSED = [
    ("scara", "G1 X0 Y0 Z0 F1000", "out-of-reach"),
    ("scara", "G1 X300 Y0 F1000", "out-of-reach"),
    ("scara", "G3 X-110 Y70 I-110 J110 F1000", "out-of-reach"),
    ("polar", "G1 X-60 Y-45 F1000", "singular-pose"),
    ("delta", "G1 X400 F1000", "out-of-reach"),
    ("rotary-delta", "G1 Z-600 F1000", "out-of-reach"),
]


@pytest.mark.parametrize(("machine", "line", "code"), REFUSED)
def test_paths_without_joint_positions_are_refused_at_their_line(
    machine: str, line: str, code: str, write
) -> None:
    """The arc of the third case leaves the reach between its ends."""
    place = " ".join(f"{axis}{value}" for axis, value in zip("XYZ", MIDDLE[machine], strict=True))
    report = check(write(f"G21 G90\nG0 {place}\n{line}\nM2\n"), machine_of(machine))
    assert [fault.diagnostic.code for fault in report.faults] == [code]
    assert report.faults[0].diagnostic.line == 3


def test_an_angle_counts_its_turns(write) -> None:
    """Three turns about the centre turn the table three times, and the joint does not go back."""
    program = "G21 G90 F3000\nG0 X40 Y1\n" + "G3 X40 Y1 I-40 J-1\n" * 3 + "M2\n"
    machine = machine_of("polar").model_copy()
    axes = dict(machine.axes) | {"y": machine.axes["y"].model_copy(update={"travel": None})}
    machine = machine.model_copy(update={"axes": axes})
    file = write("G21 G90\n" + program)
    start = np.array([40.0, 1.0, 0.0])
    path = build(parse(file, machine), axes=("x", "y", "z"), start=start)
    joints = Joints(machine)
    chunks = [item for item in joints.path(path, start) if isinstance(item, PathChunk)]
    out = np.empty((4, 6))
    last = chunks[-1]
    kind, at = int(last.kind[-1]), int(last.at[-1])
    curve_eval(kind, last.data, at, curve_range(kind, last.data, at)[1], out)
    assert out[0, 4] == pytest.approx(joints.at(start)[1] + 3 * 360.0, abs=1e-9)


def turntable(**start: float) -> Machine:
    """Return a turntable whose programs begin at a place, else at its centre."""
    machine = machine_of("polar")
    axes = {
        letter: axis.model_copy(update={"travel": None}) for letter, axis in machine.axes.items()
    }
    return machine.model_copy(update={"axes": axes, "start": start})


@pytest.mark.parametrize(
    ("program", "ends"),
    [
        ("G0 X50\n", (50.0, 0.0, 0.0)),
        ("G1 X30 Z5 F900\nG3 X0 Y30 R30\n", (30.0, 90.0, 5.0)),
        ("G64 P0.02\nG1 X30 F900\nY20\n", (np.hypot(30.0, 20.0), np.degrees(np.arctan2(2, 3)), 0)),
    ],
)
def test_a_path_leaves_the_centre_where_the_table_stands(
    program: str, ends: tuple[float, ...], write
) -> None:
    """r = x and c = 0 on the way: the radius has the limits of a straight axis, c does not turn."""
    machine = turntable()
    board = Loopback(3)
    report = run_with(write(f"G21 G90\n{program}M2\n"), machine, board=board)
    assert report.ok, report.faults
    steps = np.array(ends) * machine.of_joints.steps_per_mm
    assert np.abs(board.position_steps - steps).max() <= 1.0


@pytest.mark.parametrize(
    "line", ["G0 Y50", "G0 X-50", "G1 X50 Y1 F600", "G2 X20 Y0 R10 F600", "G0 X50\nX-50"]
)
def test_no_path_leaves_the_centre_in_another_direction(line: str, write) -> None:
    report = check(write(f"G21 G90\n{line}\nM2\n"), turntable())
    (fault,) = report.faults
    assert fault.diagnostic.code == "singular-pose"
    begins = "\n" not in line
    assert fault.diagnostic.message.startswith("the program begins at X0 Y0 Z0") == begins
    assert ("[machine] start" in fault.diagnostic.hint) == begins


def test_no_path_ends_at_the_centre(write) -> None:
    """The next program would not know where the table stands."""
    report = check(write("G21 G90\nG0 X0 Y0\nM2\n"), turntable(x=0.0, y=40.0))
    assert [fault.diagnostic.code for fault in report.faults] == ["singular-pose"]


@pytest.mark.parametrize(
    "start", [{"x": 30.0, "y": 40.0}, {"r": 50.0, "c": np.degrees(0.927295218)}]
)
def test_programs_begin_at_the_start_of_the_machine_file(start: dict[str, float]) -> None:
    assert start_position(turntable(**start)) == pytest.approx([30.0, 40.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("start", [{"r": -50.0}, {"c": 200.0, "r": 10.0}, {"c": 90.0}])
def test_a_start_of_joints_that_the_machine_never_has_is_refused(start: dict[str, float]) -> None:
    with pytest.raises(MachineFileError) as caught:
        start_position(turntable(**start))
    assert caught.value.diagnostic.code == "start-out-of-reach"


def test_a_start_with_the_elbow_on_the_other_side_is_refused() -> None:
    machine = machine_of("scara").model_copy(update={"start": {"a": 10.0, "b": -90.0}})
    with pytest.raises(MachineFileError) as caught:
        start_position(machine)
    assert caught.value.diagnostic.code == "start-out-of-reach"


def test_a_jog_does_not_leave_the_centre() -> None:
    """The board may know another angle of the table than 0."""
    board, machine, zero = Loopback(3), turntable(), np.zeros(3)
    end = np.array([20.0, 0.0, 0.0])
    with pytest.raises(MotionLimitError) as caught:
        jog(board, machine, zero, end, 10.0, control=Control())
    assert caught.value.diagnostic.code == "singular-pose"


def test_joints_at_the_centre_are_determined_only_at_angle_0() -> None:
    """Else a program would begin with the table turned by the rest of the angle."""
    joints = Joints(turntable())
    assert joints.determined(np.array([0.0, 0.0, 3.0]))
    assert joints.determined(np.array([20.0, 400.0, 3.0]))
    assert not joints.determined(np.array([0.0, 30.0, 3.0]))
    assert not joints.determined(np.array([-20.0, 0.0, 3.0]))


def test_a_program_that_begins_outside_the_travel_names_the_start(write) -> None:
    """The caret is not at a word of the line: the line does not lead outside."""
    machine = machine_of("scara")
    axes = {**machine.axes, "x": machine.axes["x"].model_copy(update={"travel": (-100.0, 100.0)})}
    machine = machine.model_copy(update={"axes": axes, "start": {"x": 130.0, "y": 60.0}})
    report = check(write("G21 G90\nG0 X90 Y70\nM2\n"), machine)
    (fault,) = report.faults
    assert fault.diagnostic.code == "soft-limit"
    assert fault.diagnostic.message.startswith("the program begins at X130; the travel is -100 to")
    assert (fault.diagnostic.column, fault.diagnostic.length) == (1, 10)


def test_the_caret_of_a_joints_limit_is_not_at_the_word_j(write) -> None:
    machine = machine_of("scara")
    joints = dict(machine.joints)
    joints["a"] = joints["a"].model_copy(update={"travel": (-1.0, 0.5)})
    machine = machine.model_copy(update={"joints": joints, "start": {"a": 0.0, "b": 90.0}})
    report = check(write("G21 G90\nG2 X140 Y100 I-20 J-10 F600\nM2\n"), machine)
    fault = report.faults[0].diagnostic
    assert fault.code == "soft-limit"
    assert fault.message.startswith("joint a would reach")
    assert (fault.column, fault.length) == (1, len("G2 X140 Y100 I-20 J-10 F600"))
