"""Styles of posts for industrial controllers."""

from __future__ import annotations

import random
from collections.abc import Callable

from tests.support.corpus.geometry import fixed, holes, point, profile, short_moves


def fusion_fanuc(rng: random.Random) -> str:
    """Fusion 360, FANUC post: O number, line numbers, tool list, G28 G91, G43 H."""
    number = rng.randint(1, 9999)
    tools = [(tool, rng.choice((3, 6, 10, 12))) for tool in rng.sample(range(1, 20), 2)]
    lines = [f"O{number:04d} (PART {number})"]
    lines += [f"(T{tool}  D={d}. CR=0. - ZMIN=-2. - FLAT END MILL)" for tool, d in tools]
    lines += ["G90 G94 G17 G49 G40 G80", rng.choice(("G21", "G20")), "G28 G91 Z0.", "G90"]
    for place, (tool, _) in enumerate(tools):
        lines += ["", f"({rng.choice(('2D CONTOUR', 'ADAPTIVE1 (2)', 'POCKET'))})"]
        if place:
            lines += ["M9", "M5", "G28 G91 Z0.", "G90", "M1"]
        lines += [f"T{tool} M6", f"S{rng.randint(1000, 12000)} M3", "G17 G90 G94", "G54", "M8"]
        start, *rest = profile(rng, point, feed=f"F{rng.randint(100, 900)}.")
        lines += [start, f"G43 Z15. H{tool:02d}", "G0 Z5.", "G1 Z-1. F333."]
        lines += [*rest, "G0 Z15."]
        if place:
            cycle = rng.choice(
                ("G81 {} Z-6. R2. F120.", "G83 {} Z-12. R2. Q1.5 F90.", "G82 {} Z-4. R2. P500 F90.")
            )
            for index, (x, y) in enumerate(holes(rng)):
                at = f"X{point(x)} Y{point(y)}"
                lines.append(("G98 " + cycle).format(at) if not index else at)
            lines.append("G80")
    lines += ["M5", "M9", "G28 G91 Z0.", "G28 X0. Y0.", "M30"]
    step = rng.choice((0, 5))
    if step:
        lines = [
            f"N{5 * index} {line}" if line and line[0] not in "(O" else line
            for index, line in enumerate(lines)
        ]
    return "\n".join(["%", *lines, "%"]) + "\n"


def fusion_haas(rng: random.Random) -> str:
    """Fusion 360, Haas post: five digits, G187, G103, G53, chip conveyor, M97 or G154."""
    tool = rng.randint(1, 24)
    lines = [
        "%", f"O0{rng.randint(1000, 9999)} (BRACKET OP1)",
        "(USING HIGH FEED G1 F500. INSTEAD OF G0.)",
        f"(T{tool} D=0.5 CR=0. - ZMIN=-0.5 - FLAT END MILL)",
        "G90 G94 G17", "G20", "G53 G0 Z0.", "", "(ADAPTIVE)", f"T{tool} M6",
        f"S{rng.randint(3000, 12000)} M3", rng.choice(("G54", "G154 P3", "G110")),
        rng.choice(("M8", "M88", "M83")), rng.choice(("G187 P1", "G187 P2 E0.001", "G103 P1")),
        "G17 G90", "G0 X0.5 Y0.25", f"G43 Z0.6 H{tool}", f"T{tool % 20 + 1}",
        "G0 Z0.2", "G1 Z-0.05 F20.", "X2. F60.", "G3 X2.25 Y0.5 J0.25", "G1 Y1.75",
        "G2 X2.5 Y2. I0.25 J0.", "G0 Z0.6",
    ]  # fmt: skip
    if rng.random() < 0.5:
        lines += ["G12 I0.5 Z-0.1 F12. D0" if rng.random() < 0.5 else "G13 I0.25 K0.75 Q0.25 F12."]
    lines += [
        "G103",
        "M5",
        "M9",
        rng.choice(("M31", "M33", "M89")),
        "G53 G0 Z0.",
        "G53 Y0.",
        "M30",
        "%",
    ]
    return "\n".join(lines) + "\n"


def mastercam(rng: random.Random) -> str:
    """Mastercam: N100 steps, file names in comments, A0. in the first move, G91 G28."""
    tool = rng.randint(1, 30)
    metric = rng.random() < 0.5
    lines = [
        f"G{21 if metric else 20}", "G0 G17 G40 G49 G80 G90", f"T{tool} M6",
        f"G0 G90 G54 X10. Y-5. {rng.choice(('', 'A0. '))}S{rng.randint(800, 9000)} M3",
        f"G43 H{tool} Z25. M8" if metric else f"G43 H{tool} Z2.", "Z5.", "G1 Z-1. F200.",
        "G0 Z5.", *profile(rng, point, feed="F400."), "G0 Z25.", "M5",
        "G91 G28 Z0. M9", rng.choice(("G28 X0. Y0.", "G28 X0. Y0. A0.")), "M30",
    ]  # fmt: skip
    head = [
        "%",
        f"O{rng.randint(0, 9999):04d}(BLOCK {rng.randint(1, 9)})",
        "(DATE=DD-MM-YY - 01-02-26 TIME=HH:MM - 10:45)",
        "(MCAM FILE - C:\\PARTS\\BLOCK.MCAM)",
        "(MATERIAL - ALUMINUM MM - 2024)",
        f"( T{tool} |  6. FLAT ENDMILL | H{tool} | XY STOCK TO LEAVE - .0 | D{tool} )",
    ]
    return (
        "\n".join(
            [*head, *(f"N{100 + 10 * index} {line}" for index, line in enumerate(lines)), "%"]
        )
        + "\n"
    )


def fanuc_macro(rng: random.Random) -> str:
    """A hand-written program with custom macro B: variables, WHILE, IF GOTO, G65."""
    depth, step = rng.randint(4, 12), rng.choice((0.5, 1.0))
    return f"""%
O{rng.randint(1000, 8999)} (DEPTH LOOP)
G21 G17 G40 G49 G80 G90
#1={depth}. (DEPTH)
#2={step} (STEP)
#3=0
T1 M6
G54 G0 X0. Y0. S2000 M3
G43 H1 Z20.
WHILE[#3 LT #1]DO1
#3=#3+#2
IF[#3 GT #1]THEN #3=#1
G1 Z-#3 F100.
G2 I{rng.randint(5, 15)}. F300.
END1
G0 Z20.
IF [#1 GT 100.] GOTO 90
G65 P9001 A{rng.randint(1, 9)}. B2.
N90 G91 G28 Z0.
M30
O9001 (SLOT)
G90 G0 X#1
G1 Z-#2 F80.
G0 Z20.
M99
%
"""


def fanuc_figures(rng: random.Random) -> str:
    """A hand-written program with rotation, mirroring, scaling, polar holes and subprograms."""
    angle = rng.randint(10, 80)
    return f"""%
O{rng.randint(300, 999)}
G21 G90 G17 G40 G49 G80 G69 G50 G15
T2 M6
S1500 M3
G54 G0 X0 Y0
G43 Z50. H2
G68 X0 Y0 R{angle}.
G0 X10. Y0.
M98 P200
G69
G51.1 X0
M98 P200
G50.1 X0
G51 X0 Y0 Z0 P{rng.choice(("1500", "500", "2."))}
M98 P200
G50
G16
G99 G81 X20. Y0. Z-3. R2. F100.
Y90.
Y180.
G80 G15
G05 P10000
G5.1 Q1
G5.1 Q0
G9 G1 X1. F200.
G4 P{rng.randint(100, 900)}
G0 Z50.
M30
O200
G90 G0 X10. Y0.
G1 Z-1. F100.
X20. Y5.
G3 X20. Y15. R5.
G0 Z5.
M99
%
"""


def handwritten_iso(rng: random.Random) -> str:
    """A teaching example: few comments, no %, program number without one."""
    tool = rng.randint(1, 9)
    d = rng.randint(20, 60)
    return f"""O{rng.randint(1000, 2000)}
T{tool} M6
(LINEAR / FEED - ABSOLUTE)
G0 G90 G40 G21 G17 G94 G80
G54 X-{d} Y-{d} S500 M3  (POSITION 6)
G43 Z100 H{tool}
Z5
G1 Z-{rng.randint(1, 9)} F100
G1 X-{d - 10}
G1 Y{d} M8
G1 X{d}
G3 X{d + 10} Y{d - 10} R10
G1 Y-{d}
G0 Z100
M30
"""


def hole_by_hole(rng: random.Random) -> str:
    """A small script's program: semicolons, A0, brackets in comments."""
    lines = [
        "%",
        "O0000(MY PART)",
        "(TOOL DIAMETER: 3.0)",
        "N1 G21; mm mode",
        "N2 G0 G17 G40 G49 G80 G90; rapid, XY plane, compensation off",
        f"N3 T{rng.randint(1, 300)} M6; tool select",
        "N4 G0 G90 G54 X0.0 Y0.0 Z10.0 A0 S3000 M3 F600; coordinates, spindle",
    ]
    count = 5
    for x, y in holes(rng):
        lines.append(f"( Drilling hole at ({x}, {y}) )")
        for text in ("Z10.0 F600.0", f"X{x} Y{y} ", "Z1.0", "Z-2.0 F2.0", "Z10.0 F600.0"):
            lines.append(f"N{count} {text}")
            count += 1
    lines += ["( Done )", f"N{count} M5; Turn off spindle", f"N{count + 1} M30; End", "%"]
    return "\n".join(lines) + "\n"


def four_axis_post(rng: random.Random) -> str:
    """HSMWorks generic ISO with finishing moves, G95 tapping and cutter compensation by D."""
    tool = rng.randint(1, 20)
    return "\n".join(
        [
            "%", f"({rng.randint(1000, 9999)})", f"(T{tool} D=6. CR=3. - ZMIN=-3. - BALL END MILL)",
            "N10 G90 G94 G17 G91.1", "N15 G21", "N20 G53 G0 Z0.", "(PARALLEL1)", "N25 M9",
            f"N30 T{tool} M6", "N35 S10000 M3", "N40 G54", "N45 G0 X10. Y30.",
            f"N50 G43 Z20. H{tool}", "N55 G0 Z10.", "N60 G1 Z-1.5 F254.",
            *(f"N{65 + 5 * i} {line}" for i, line in enumerate(short_moves(rng, fixed(3)))),
            "G0 Z20.", "M5", "G53 G0 Z0.", "M30", "%",
        ]
    ) + "\n"  # fmt: skip


STYLES: dict[str, Callable[[random.Random], str]] = {
    "fusion-fanuc": fusion_fanuc,
    "fusion-haas": fusion_haas,
    "mastercam": mastercam,
    "fanuc-macro": fanuc_macro,
    "fanuc-figures": fanuc_figures,
    "handwritten-iso": handwritten_iso,
    "hole-by-hole": hole_by_hole,
    "hsmworks": four_axis_post,
}
EXPECTED = {
    "fusion-fanuc": "fanuc",
    "fusion-haas": "haas",
    "mastercam": "fanuc",
    "fanuc-macro": "fanuc",
    "fanuc-figures": "fanuc",
    "handwritten-iso": "fanuc",
    "hole-by-hole": "fanuc",
    "hsmworks": "auto",
}
