"""Styles of other posts and of machinists: routers, plasma, SINUMERIK, probing, job shops."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable

from tests.support.corpus.geometry import fixed, holes, point, profile, short_moves

THREE, FOUR, FIVE = fixed(3), fixed(4), fixed(5)


def _text(lines: Iterable[str], end: str = "\n") -> str:
    return end.join(lines) + end


def _cut(rng: random.Random, number: Callable[[float], str], feed: str, top: str) -> list[str]:
    """A profile with its approach and its retraction."""
    start, *rest = profile(rng, number, feed=feed)
    return [start, f"G1 Z{number(-1.5)} F250{'.' * (feed[-1] == '.')}", *rest, f"G0 Z{top}"]


def vectric_inch(rng: random.Random) -> str:
    """Vectric, GRBL inch post: T1, G20, no tool change, feeds with one digit."""
    start, *rest = profile(rng, FOUR, feed="F60.0")
    lines = ["T1", "G17", "G20", "G90", "G0Z0.8000", "G0X0.0000Y0.0000",
             f"S{rng.randint(8, 24)}000M3", start.replace(" ", ""), "G0Z0.2000",
             "G1Z-0.1250F20.0"]  # fmt: skip
    lines += [line.replace(" ", "") for line in rest]
    return _text([*lines, "G0Z0.8000", "G0X0.0000Y0.0000", "M5", "M2"], "\r\n")


def easel(rng: random.Random) -> str:
    """Easel: small header, every word in each line, G1 for the approach."""
    lines = ["G21", "G90", "M3 S10000", "G0 X0 Y0", "G1 Z3.81 F228.6"]
    for line in short_moves(rng, FIVE):
        lines.append(f"G1 {line} F{rng.choice(('762', '1016.00000'))}")
    return _text([*lines, "G1 Z3.81 F228.6", "M5", "G0 X0 Y0"])


def freecad_grbl(rng: random.Random) -> str:
    """FreeCAD, grbl post: block comments, M6 as a comment, feeds in each line."""
    start, *rest = profile(rng, THREE, feed="F420.000")
    lines = ["(Exported by FreeCAD)", "(Post Processor: grbl_post)", "(Output Time:2026-01-02)",
             "(Begin preamble)", "G17 G90", "G21", "(Begin operation: TC: Default Tool)",
             "(Path: TC: Default Tool)", "(TC: Default Tool)", "(Begin toolchange)", "( M6 T1 )",
             f"M3 S{rng.randint(5, 20)}000", "(Finish operation: TC: Default Tool)",
             "(Begin operation: Profile)", "G0 Z5.000", start, "G1 Z-1.000 F120.000"]  # fmt: skip
    return _text([*lines, *rest, "G0 Z5.000", "(Begin postamble)", "M5", "G17 G90", "M2"])


def fusion_siemens(rng: random.Random) -> str:
    """Fusion 360, SINUMERIK 840D post: MSG, CYCLE832, TRANS, SUPA, cycles by MCALL."""
    cycle = rng.choice((
        "CYCLE81(15,5,5,-6)", "CYCLE82(15,5,5,-6,,0.5)", "CYCLE85(15,5,5,-6,,0,100,200)",
        "CYCLE83(15,5,5,-9,,3,,0,0,0,1,1)", "CYCLE84(15,5,5,-6,,0,3,,1,0,300,300)",
    ))  # fmt: skip
    start, *rest = profile(rng, THREE, feed="F500")
    lines = ["%_N_1001_MPF", "; T1 D=6 CR=0 - ZMIN=-2 - FLAT END MILL", "N10 G90 G94", "N11 G71",
             "N12 G64", "N13 G17", "", 'N14 MSG("2D CONTOUR")', f"N15 T{rng.randint(1, 20)} D1",
             "N16 M6", f"N17 S{rng.randint(1000, 9000)} M3", "N18 G54", "N19 M8",
             "N20 CYCLE832(0.01,0,1)", f"N21 {start}", "N22 G0 Z15", "N23 G1 Z-1 F300", *rest,
             "G0 Z15", 'MSG("DRILL")', "F100", f"MCALL {cycle}"]  # fmt: skip
    lines += [f"X{x} Y{y}" for x, y in holes(rng)]
    lines += ["MCALL", "M9", "M5", "SUPA G0 Z0 D0", "SUPA G0 X0 Y0", "M30"]
    return _text(lines)


def siemens_shop(rng: random.Random) -> str:
    """A hand-written SINUMERIK program: R parameters, a subprogram, RND, CHR, a loop."""
    return f"""%_N_PLATE_MPF
;$PATH=/_N_MPF_DIR
N10 G17 G54 G71 G90 G94
N20 T="FACE_{rng.randint(20, 80)}" D1
N30 M6
N40 S2000 M3 F400
R1={rng.randint(2, 5)} R2=0
WHILE R2<R1
G0 X=R2*15 Y0 Z2
L50 P2
R2=R2+1
ENDWHILE
G0 Z2
G1 Z-1 F200
X95 RND=3
Y40 CHR=2
X0
Y0
G0 Z50
G4 S20
M5
M30
%_N_L50_SPF
G91 G1 Z-1 F100
G1 Z1
G90
M17
"""


def mazak_iso(rng: random.Random) -> str:
    """Mazak in EIA/ISO: T with M06, G43, G91 G28, G90 in lines of their own."""
    lines = ["%", f"O{rng.randint(1, 9999):04d}(MAZAK VCN)", "G17G21G40G49G54G80G90G94",
             f"T{rng.randint(1, 30):02d}M06", "G91G28Z0", "G90",
             f"G00X0.Y0.S{rng.randint(1000, 9000)}M03", "G43Z50.H01M08", "Z5."]  # fmt: skip
    lines += [line.replace(" ", "") for line in _cut(rng, point, "F400.", "50.")]
    return _text([*lines, "M09", "M05", "G91G28Z0.", "G91G28X0.Y0.", "G90", "M30", "%"])


def brother(rng: random.Random) -> str:
    """Brother Speedio by a Mastercam post: several tools, G98 drilling, spaces left out."""
    lines = ["%", f"O{rng.randint(1000, 9999)}", "(SPEEDIO)", "G00G17G21G40G49G80G90"]
    for tool in rng.sample(range(1, 21), 2):
        lines += [f"(T{tool})", f"T{tool}M06", f"G00G90G54X0.Y0.S{rng.randint(2000, 12000)}M03",
                  f"G43H{tool}Z25.M08"]  # fmt: skip
        cycle = rng.choice(
            ("G98G81Z-5.R1.F300.", "G98G83Z-9.R1.Q1.5F200.", "G98G73Z-9.R1.Q2.F200.")
        )
        lines += [
            (cycle if not index else "") + f"X{point(x)}Y{point(y)}"
            for index, (x, y) in enumerate(holes(rng))
        ]
        lines += ["G80", "M09", "M05", "G91G28Z0.", "G90", "M01"]
    return _text([*lines, "M30", "%"])


def haas_by_hand(rng: random.Random) -> str:
    """Hand-written for a Haas: bolt circle, M97, chamfers, G4 P with a point."""
    return f"""%
O0{rng.randint(1000, 9999)} (PLATE, HAAS VF-2)
G20 G17 G40 G49 G80 G90
T1 M06
G00 G54 X0. Y0. S{rng.randint(1000, 7500)} M03
G43 H01 Z1. M08
G81 G99 Z-.25 R.1 F12. L0
G70 I{rng.randint(1, 3)}. J{rng.randint(0, 90)}. L{rng.randint(3, 8)}
G80
G4 P0.5
M97 P1000 L2
G00 Z1. M09
G28 G91 Z0.
G90
M30
N1000 G91 G01 X.5 F20. ,C.1
Y.5 ,R.1
X-.5
Y-.5
G90
M99
%
"""


def fanuc_dimensions(rng: random.Random) -> str:
    """Hand-written: drawing dimensions, block delete inside a line, a repeated G90."""
    return f"""O{rng.randint(100, 999):04d}(DRAWING DIMENSIONS)
G21 G90 G40 G80
T1 M6
/M1
G90 G54 G90 G00 X0. Y0. S3000 M3
G43 H1 Z20. /M8
G01 Z-1. F200.
X{rng.randint(20, 40)}. ,A{rng.randint(10, 30)}. ,R2.
Y40. ,A120. ,C1.
X-40.
G00 Z20. /M9
G91 G28 Z0.
M30
"""


def fanuc_probing(rng: random.Random) -> str:
    """A routine that finds the height of a surface by G31 and sets G54."""
    return f"""%
O{rng.randint(9000, 9099)} (PROBE Z)
G90 G21 G54
T20 M6
G0 X10. Y10.
G43 H20 Z50.
G0 X12.
Z30.
#101=#5043
G31 Z-5. F{rng.randint(50, 200)}.
#102=#5063
IF[#102LT-4.9]GOTO900
G91 G0 Z2.
G90
G10 L2 P1 Z[#5223+#102]
G0 Z20.
M30
N900#3000=1(NO CONTACT)
M30
%
"""


def linuxcnc_probing(rng: random.Random) -> str:
    """A LinuxCNC probing routine: G38.2, named parameters, O-word call, G10 L20."""
    return f"""; find a corner
o<touch> sub
  G91
  G38.2 Z-#1 F{rng.randint(20, 90)}
  G0 Z1
  G38.2 Z-2 F10
  G90
  #<_height> = #5063
o<touch> endsub
G21 G90 G40
G0 X5 Y5
o<touch> call [10]
G0 X10
Y10
G1 X12 F100
X5 Y5
(DEBUG, height #<_height>)
G10 L20 P1 Z0
G0 Z10
M2
"""


def sheetcam_plasma(rng: random.Random) -> str:
    """SheetCAM, Mach3 plasma with touch-off: G31, G92 Z0, pierce dwell, THC by M-comments."""
    lines = ["(Filename: part.tap)", "(Post processor: Mach3 plasma.scpost)", "G21 (Units: Metric)",
             "G53 G90 G91.1 G40", "F1", "S500", "(Part: Part)", "(Operation: Outside Offset)",
             "M06 T101  (Plasma 45A)", "G00 Z15.0000"]  # fmt: skip
    for _ in range(rng.randint(1, 3)):
        start, *rest = profile(rng, FOUR, feed="F2500.0")
        lines += [start, "G00 Z5.0000", "G31 Z-100 F500.0", "G92 Z0.0", "G00 Z3.8000", "M03",
                  "G04 P0.5", "G01 Z1.5000 F1000.0", *rest, "M05", "G04 P1",
                  "G00 Z15.0000"]  # fmt: skip
    return _text([*lines, "M05 M30"])


def cambam(rng: random.Random) -> str:
    """CamBam: comments by section, G64, T with M6, feeds with one digit."""
    start, *rest = profile(rng, THREE, feed="F800.0")
    lines = ["( Made using CamBam - http://www.cambam.co.uk )", "( part 1/2/2026 3:04:05 PM )",
             "( T0 : 3.175 )", "G21 G90 G91.1 G64 G40", "G0 Z3.0", "( T0 : 3.175 )", "T0 M6",
             "( Profile1 )", "G17", f"M3 S{rng.randint(1000, 20000)}", start, "G0 Z1.0",
             "G1 F300.0 Z-0.5"]  # fmt: skip
    return _text([*lines, *rest, "G0 Z3.0", "M5", "M30"])


def meshcam(rng: random.Random) -> str:
    """MeshCAM: line numbers, G1 with F in the first line, no spindle code."""
    lines = ["N1 G21", "N2 G90", "N3 G0 Z5.000", "N4 T1 M6", f"N5 S{rng.randint(8, 20)}000 M3"]
    moves = short_moves(rng, THREE)
    lines += [f"N6 G0 {moves[0].rpartition(' ')[0]}", "N7 G1 Z-0.500 F381.0"]
    lines += [f"N{8 + index} {move}" for index, move in enumerate(moves)]
    return _text([*lines, "N9990 G0 Z5.000", "N9991 M5", "N9992 M30"])


def deskproto(rng: random.Random) -> str:
    """DeskProto, plain ISO: percent, comments with brackets, G1 for each move."""
    lines = ["%", "(DeskProto file, ISO plain)", "G21", "G90", "G00 Z5.00", "M03 S12000"]
    lines += [f"G01 {move} F{rng.choice((600, 900))}" for move in short_moves(rng, fixed(2))]
    return _text([*lines, "G00 Z5.00", "M05", "M30", "%"])


def lasergrbl(rng: random.Random) -> str:
    """LaserGRBL: raster lines with S in each word group, M3 S0, relative moves at the end."""
    lines = ["G90 (use absolute coordinates)", "G0 X0 Y0", "M3 S0", "F1000"]
    for row in range(rng.randint(5, 15)):
        lines += [f"G1 X{20 if row % 2 == 0 else 0} S{rng.randint(0, 255)}", f"G0 Y{row * 0.2:.1f}"]
    return _text([*lines, "M5 S0", "G0 X0 Y0 Z0"])


def solidcam(rng: random.Random) -> str:
    """SolidCAM, FANUC post: N by tens, comments with dashes, G5.1, cutter compensation."""
    lines = ["%", f"O{rng.randint(5000, 5999)} (P-1)", "(MCV-OP) (01-JAN-2026)", "G90 G17",
             "G80 G49 G40", "G54", "G91 G28 Z0", "G90", "M01", "N1 M6 T1",
             "(TOOL -1- MILL DIA 10.0 R0. MM )", "G90 G00 G40 G54", f"G43 H1 D31 G0 X0. Y0. Z50. "
             f"S{rng.randint(1000, 6000)} M3", "M8", "G5.1 Q1", "(------------------)",
             "(F-CONTOUR - PROFILE)", "(------------------)"]  # fmt: skip
    lines += _cut(rng, point, "F300", "50.")
    return _text([*lines, "G5.1 Q0", "M9", "G91 G28 Z0", "M30", "%"])


def bobcad(rng: random.Random) -> str:
    """BobCAD, Mach3 post: dates in comments, M06 before T, drilling with G99."""
    lines = ["%", "O100", "(PROGRAM NAME - PART.NC)", "(DATE - FRI. 01/02/2026)", "G20 G40 G49 G80",
             "G90 G54", "M06 T2", f"M03 S{rng.randint(1000, 5000)}", "G00 X0. Y0.",
             "G43 H2 Z1."]  # fmt: skip
    lines += [
        f"{'G99 G81 Z-.25 R.1 F10. ' if not index else ''}X{point(x)} Y{point(y)}"
        for index, (x, y) in enumerate(holes(rng))
    ]
    return _text([*lines, "G80", "G00 Z1.", "M05", "M30", "%"])


def masso(rng: random.Random) -> str:
    """Fusion 360, MASSO post: G53 G0 Z0 between tools, G43 H, G4 P in seconds."""
    lines = ["(1001)", "(MACHINE)", "(  VENDOR: MASSO)", "G90 G94", "G17", "G21", "G53 G0 Z0.", "",
             "(CONTOUR)", f"T{rng.randint(1, 9)} M6", f"S{rng.randint(5, 18)}000 M3", "G4 P2.",
             "G54"]  # fmt: skip
    start, *rest = profile(rng, point, feed="F1000.")
    lines += [start, "G43 Z15. H1", "G0 Z5.", "G1 Z-1. F300.", *rest, "G0 Z15."]
    return _text([*lines, "M5", "G53 G0 Z0.", "G53 X0. Y0.", "M30"])


def training_mill(rng: random.Random) -> str:
    """A student's program for a training mill: billet lines, S and M3 apart, no points."""
    return f"""O{rng.randint(1000, 9999)}
[BILLET X100 Y60 Z10
[TOOLDEF T1 D6
N10 G21
N20 G91 G28 X0 Y0 Z0
N30 M6 T1
N40 G43 H1
N50 M3 S2500
N60 G90 G00 X-10 Y-10
N70 Z2
N80 G01 Z-2 F50
N90 X{rng.randint(40, 80)} F150
N100 G03 X40 Y40 R{rng.randint(60, 90)}
N110 G00 Z2
N120 G99 G83 X20 Y20 Z-8 Q2 R2 F60
N130 G98 X30
N140 G91 G80 G28 X0 Y0 Z0 M05
N150 M30
"""


STYLES: dict[str, Callable[[random.Random], str]] = {
    "vectric-inch": vectric_inch,
    "easel": easel,
    "freecad-grbl": freecad_grbl,
    "fusion-siemens": fusion_siemens,
    "siemens-shop": siemens_shop,
    "mazak-iso": mazak_iso,
    "brother": brother,
    "haas-by-hand": haas_by_hand,
    "fanuc-dimensions": fanuc_dimensions,
    "fanuc-probing": fanuc_probing,
    "linuxcnc-probing": linuxcnc_probing,
    "sheetcam-plasma": sheetcam_plasma,
    "cambam": cambam,
    "meshcam": meshcam,
    "deskproto": deskproto,
    "lasergrbl": lasergrbl,
    "solidcam": solidcam,
    "bobcad": bobcad,
    "masso": masso,
    "training-mill": training_mill,
}
EXPECTED = {
    "vectric-inch": "auto",
    "easel": "auto",
    "freecad-grbl": "grbl",
    "fusion-siemens": "siemens",
    "siemens-shop": "siemens",
    "mazak-iso": "fanuc",
    "brother": "fanuc",
    "haas-by-hand": "haas",
    "fanuc-dimensions": "fanuc",
    "fanuc-probing": "fanuc",
    "linuxcnc-probing": "linuxcnc",
    "sheetcam-plasma": "mach3",
    "cambam": "auto",
    "meshcam": "auto",
    "deskproto": "auto",
    "lasergrbl": "auto",
    "solidcam": "fanuc",
    "bobcad": "fanuc",
    "masso": "auto",
    "training-mill": "fanuc",
}
