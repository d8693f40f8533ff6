"""Programs of lathes for FANUC, Haas, SINUMERIK, LinuxCNC and Mach3, made from a seed.

Each program has two to five operations: facing, turning, boring, a groove, a thread, a finished
contour with the compensation of the nose, a roughing cycle. X is a diameter.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field

from cnc.model.choices import DialectName
from tests.support.corpus.geometry import point

TOOLS = "".join(
    f"T{number} P{number} X{-10 - number} Z{number / 2} D0.8 Q{2 if number < 7 else 3}\n"
    for number in range(1, 13)
)
"""A tool table for these programs: tools from 7 on turn the inside."""
DIALECTS: tuple[DialectName, ...] = ("fanuc", "haas", "siemens", "linuxcnc", "mach3")
_FANUC = ("fanuc", "haas")
_NGC = ("linuxcnc", "mach3")


@dataclass
class _Maker:
    """Makes one program."""

    rng: random.Random
    dialect: str
    lines: list[str] = field(default_factory=list)
    profiles: list[str] = field(default_factory=list)

    @property
    def fanuc(self) -> bool:
        return self.dialect in _FANUC

    def add(self, *lines: str) -> None:
        self.lines += lines

    def begin(self) -> None:
        rng = self.rng
        if self.fanuc:
            self.add("%", f"O{rng.randint(1000, 9999)} (PART)", "G21 G18 G40 G99")
            self.add("G28 U0 W0" if rng.random() < 0.5 else "G0 X150. Z80.")
        elif self.dialect == "siemens":
            self.add("G18 G71 G90 G95 G40 DIAMON", rng.choice(("G54", "G500", "G55")))
        else:
            self.add("G18 G21 G40 G90 G95 G54" + (" G7" if self.dialect == "linuxcnc" else ""))

    def end(self) -> None:
        self.add("M9", "M5", *(["M30", "%"] if self.fanuc else ["M30"]), *self.profiles)

    def tool(self, *, inside: bool = False) -> None:
        number = self.rng.randint(7, 12) if inside else self.rng.randint(1, 6)
        if self.fanuc:
            self.add(f"T{number:02d}{number:02d}")
        elif self.dialect == "siemens":
            self.add(f"T{number} D1")
        else:
            self.add(f"T{number} M6", f"G43 H{number}")

    def speed(self, *, constant: bool = False) -> None:
        rng = self.rng
        turns, most = rng.choice(("M3", "M4")), 100 * rng.randint(10, 30)
        if constant or rng.random() < 0.4:
            self.add(f"G97 S{10 * rng.randint(30, 150)} {turns}")
        elif self.fanuc:
            self.add(f"G50 S{most}", f"G96 S{rng.randint(80, 250)} {turns}")
        elif self.dialect == "siemens":
            self.add(f"G96 S{rng.randint(80, 250)} LIMS={most} {turns}")
        else:
            self.add(f"G96 D{most} S{rng.randint(80, 250)} {turns}")

    def feed(self) -> str:
        return f"F{self.rng.choice((0.05, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3)):g}"

    def arc(self, clockwise: bool, x: float, z: float, radius: float) -> str:
        code = "G2" if clockwise else "G3"
        word = "CR=" if self.dialect == "siemens" else "R"
        return f"{code} X{point(x)} Z{point(z)} {word}{point(radius)}"

    def away(self) -> None:
        self.add(f"G0 X{point(self.rng.randint(80, 120))} Z{point(self.rng.randint(30, 60))}")

    # Operations

    def face(self) -> None:
        self.tool()
        self.speed()
        feed, x = self.feed(), 44.0
        self.add(f"G0 X{point(x)} Z2. M8")
        for z in (1.0, 0.5, 0.0):
            if self.fanuc and self.rng.random() < 0.5:
                self.add(f"G94 X-1.6 Z{point(z)} {feed}")
            else:
                self.add(f"G0 Z{point(z)}", f"G1 X-1.6 {feed}", f"G0 Z{point(z + 2.0)}", f"X{x:g}.")
        self.away()

    def turn(self) -> None:
        self.tool()
        self.speed()
        depth, z = self.rng.choice((1.0, 1.5, 2.0)), -self.rng.uniform(10, 50)
        taper = self.rng.choice((0.0, 0.0, 1.5))
        self.add("G0 X44. Z2. M8")
        for cut in range(1, self.rng.randint(2, 5)):
            x = 44.0 - 2.0 * depth * cut
            if self.fanuc and self.rng.random() < 0.5:
                self.add(f"G90 X{point(x)} Z{point(z)} R{point(-taper)} {self.feed()}")
                continue
            self.add(f"G0 X{point(x - 2.0 * taper)}", f"G1 X{point(x)} Z{point(z)} {self.feed()}")
            self.add("G0 X46.", "Z2.")
        self.away()

    def bore(self) -> None:
        self.tool(inside=True)
        self.speed()
        z = -self.rng.uniform(8, 30)
        self.add("G0 X18. Z3.", "M8")
        for x in (20.0, 22.0, 23.5):
            self.add(f"G0 X{point(x + 2.0)}", f"G1 Z0. {self.feed()}")
            self.add(f"X{point(x)} Z-1.", f"Z{point(z)}", "X17.", "G0 Z3.")
        self.away()

    def groove(self) -> None:
        self.tool()
        self.speed(constant=True)
        z = -self.rng.uniform(10, 30)
        self.add(f"G0 X36. Z{point(z)}")
        if self.fanuc and self.rng.random() < 0.5:
            if self.dialect == "fanuc":
                self.add("G75 R0.3", f"G75 X26. Z{point(z - 3)} P1500 Q1500 F0.06")
            else:
                self.add(f"G75 X26. Z{point(z - 3)} I1.5 K1.5 F0.06")
        else:
            pause = {"fanuc": "G4 P500", "haas": "G4 P500", "siemens": "G4 F0.5"}
            self.add("G1 X26. F0.06", pause.get(self.dialect, "G4 P0.5"), "G1 X36. F0.3")
        self.away()

    def thread(self) -> None:
        rng, start = self.rng, rng_start(self.rng)
        self.tool()
        self.speed(constant=True)
        lead, z = rng.choice((1.0, 1.25, 1.5, 2.0)), -float(rng.randint(12, 25))
        self.add(f"G0 X24. Z{point(start)}")
        kind = rng.random()
        if kind < 0.35 and self.fanuc:
            height = 0.6134 * lead
            x = point(20.0 - 2.0 * height)
            if self.dialect == "fanuc":
                self.add(f"G76 P02{rng.choice(('00', '10'))}60 Q80 R0.02")
                self.add(f"G76 X{x} Z{z:g}. P{1000 * height:.0f} Q300 F{lead:g}")
            else:
                self.add(f"G76 X{x} Z{z:g}. K{height:.3f} D0.3 A60 F{lead:g}")
        elif kind < 0.35 and self.dialect == "siemens":
            self.add(
                f"CYCLE97({lead:g},,0,{z:g},20,20,{start:g},2,{0.6134 * lead:.3f},"
                f"0.05,{rng.choice((0, 30))},0,{rng.randint(3, 6)},1,3,1)"
            )
        elif kind < 0.35 and self.dialect == "linuxcnc":
            taper = rng.choice(("", " E1. L2", " E0.5 L3"))
            self.add(f"G76 P{lead:g} Z{z:g} I-4. J0.4 K{1.2268 * lead:.4f} R2. Q29.5{taper}")
        elif kind < 0.6 and self.fanuc:
            self.add(f"G92 X19.4 Z{z:g}. F{lead:g}", "X18.8", "X18.4")
        else:
            self._passes(lead, z, start)
        self.away()

    def _passes(self, lead: float, z: float, start: float) -> None:
        """Single moves that follow the spindle, some of them with a cone at the end."""
        rng = self.rng
        cone, angle = rng.random() < 0.5, rng.random() < 0.3
        for x in (19.4, 18.8, 18.4):
            self.add(f"G0 X{point(x)}")
            if self.fanuc:
                self.add(f"G32 Z{z:g}. F{lead:g}" + (" Q180000" if angle else ""))
            elif self.dialect == "siemens":
                self.add(f"G33 Z{z:g} K{lead:g}" + (" SF=180" if angle else ""))
            else:
                self.add(f"G33 Z{z:g} K{lead:g}")
            if cone:
                end = f"X{point(x + 3.0)} Z{point(z - 3.0)}"
                word = "F" if self.fanuc else "K"
                self.add(f"{end} {word}{lead:g}")
            self.add("G0 X24.", f"Z{point(start)}")

    def contour(self) -> None:
        """A finished contour with lines, arcs, a cone, and mostly the compensation of the nose."""
        rng = self.rng
        compensated = rng.random() < 0.7
        self.tool()
        self.speed()
        self.add("G0 X10. Z4. M8")
        self.add(f"{'G42 ' if compensated else ''}G1 X14. Z2. {self.feed()}")
        self.add(*self._contour())
        self.add(f"G40 G0 X{point(60)}" if compensated else "G0 X60.")
        self.away()

    def _contour(self) -> list[str]:
        rng = self.rng
        x, z, lines = 16.0, 0.0, ["G1 X16. Z0."]
        for _ in range(rng.randint(2, 5)):
            kind, step = rng.randrange(4), rng.choice((2.0, 3.0, 4.0))
            if kind == 0:
                x, z = x + 2.0 * step, z - step
                lines.append(self.arc(rng.random() < 0.5, x, z, step))
                z -= 4.0
                lines.append(f"G1 Z{point(z)}")
            elif kind == 1:
                x, z = x + 2.0, z - step
                lines.append(f"G1 X{point(x)} Z{point(z)}")
            elif kind == 2:
                z -= 3.0 * step
                lines.append(f"G1 Z{point(z)} {self.feed()}")
            else:
                x += 2.0 * step
                lines.append(f"G1 X{point(x)}")
        return [*lines, f"G1 X{point(x + 6.0)}"]

    def rough(self) -> None:
        """G71 and G70, CYCLE95, or LinuxCNC's G71 and G70."""
        rng = self.rng
        self.tool()
        self.speed(constant=self.dialect == "linuxcnc")
        at = 100 + 10 * len(self.lines)
        shape = [
            "G1 Z0. F0.1",
            "X20. Z-2.",
            "Z-18.",
            "X26.",
            self.arc(True, 32, -21, 3),
            "G1 Z-40.",
        ]
        depth = rng.choice((1.0, 1.5, 2.0))
        if self.dialect == "fanuc":
            self.add("G0 X46. Z2.", f"G71 U{depth:g} R0.5", f"G71 P{at} Q{at + 1} U0.4 W0.1 F0.25")
            self.add(f"N{at} G0 X16.", *shape, f"N{at + 1} X46.", f"G70 P{at} Q{at + 1}")
        elif self.dialect == "haas":
            self.add("G0 X46. Z2.", f"G71 P{at} Q{at + 1} U0.4 W0.1 D{depth:.1f} F0.25")
            self.add(f"N{at} G0 X16.", *shape, f"N{at + 1} X46.", f"G70 P{at} Q{at + 1}")
        elif self.dialect == "siemens":
            self.add("G0 X46 Z2", f'CYCLE95("A{at}:B{at}",{depth:g},0.1,0.2,,0.25,0.15,0.1,9)')
            self.add(f"A{at}:", "G1 X16 Z0 F0.1", *shape[1:], "X46", f"B{at}:")
        elif self.dialect == "linuxcnc":
            self.add("G0 X46. Z2.", f"G71 Q{at} D0.2 I{depth:g} R0.5 F0.25", f"G70 Q{at} F0.1")
            body = ["G1 X16. Z0.", *(line.replace(" F0.1", "") for line in shape[1:]), "X46."]
            self.profiles += [f"o{at} sub", *body, f"o{at} endsub"]
        self.away()


def rng_start(rng: random.Random) -> float:
    """Return the place along Z where a thread begins, mm."""
    return float(rng.randint(4, 8))


OPERATIONS: tuple[Callable[[_Maker], None], ...] = (
    _Maker.face, _Maker.turn, _Maker.bore, _Maker.groove, _Maker.thread, _Maker.contour,
    _Maker.rough,
)  # fmt: skip


def program(rng: random.Random, dialect: str) -> str:
    """Return a program of a lathe in a dialect."""
    maker = _Maker(rng, dialect)
    maker.begin()
    # Mach3 has neither G33 nor roughing cycles.
    choice = OPERATIONS[:4] + OPERATIONS[5:6] if dialect == "mach3" else OPERATIONS
    for operation in rng.sample(choice, rng.randint(2, 5)):
        operation(maker)
    maker.end()
    body = maker.lines
    if maker.profiles:
        # LinuxCNC's subroutines stand before their calls.
        last = body.index("M30")
        body = [*maker.profiles, *body[: last + 1]]
    return "\n".join(body) + "\n"
