r"""A loose grammar of whole programs for random tests: most lines make sense, some do not.

A rule is a name, a colon and alternatives, one of which is chosen: ``name: this | that``.
``{name}`` is replaced by an expansion of that name, ``{name?}`` in every second case only. ``{A}``
to ``{D}`` are labels, equal within one alternative and new in the next. ``\n`` breaks the line.
A rule continues in lines that begin with ``|``, or after a backslash at the end of a line.
Names without a rule are expanded by :class:`tests.support.gcode.fuzzing.Author`.
"""

from __future__ import annotations

COMMON = r"""
axis: X | Y | Z | X | Y | Z | {anyaxis}
axes: @{p} ^{n} | ^{v} | X{v} | Y{v} | Z{v} | X{v} Y{v} | X{v} Y{v} | X{v} Z{v} | Y{v} Z{v}
   | X{v} Y{v} Z{v} | X{v} {axis}{v} | {axis}{v}
flat: X{v} | Y{v} | X{v} Y{v} | X{v} Y{v} | X{v} Y{v}
feed: F{p}
any: {letter}{v}
motion: G0 | G1 | G1 | G53 G0 | G91 G1 | G90 G1 | G90 | G91
plane: G17 | G18 | G19
turn: G2 | G3
system: G54 | G55 | G56 | G57 | G58 | G59 | G59.1 | G59.3

move: {motion?} {axes} {feed?} | {axes} | {axes} | {motion} {axes}
arc: {turn} I{p} J{p} {feed?} | {turn} X{s} Y{s} R{big} | {turn} X{s} R-{big}
   | {plane} {turn} {axes} R{big} | {turn} I{s} Z{v}
   | {turn?} {axes} I{v} J{v} K{v} | {plane} {turn} J{p} K{p} | {plane} {turn} I{p} K{p} P{small}
   | G17 G91 {turn} X{s} Y{s} R{big} G90 | G90.1 {turn} {flat} I{v} J{v} | {turn} {flat} I{v}
speed: S{p} M3 | S{p} M4 | M5 | M3 | S{p} | M8 | M7 | M9 | M7 M3 S{p}
tool: T{small} M6 | T{small} | M6 | M6 T{small}
mode: G93\nG1 {axes} F{p}\nG2 I{p} F{p}\nG94 {feed} | {plane} | G20 | G21 | G90 | G91 | G90.1
   | G91.1 | G93 | G94 | G61 | G61.1
   | G64 P{p} Q{p} | G64 | G40 | G49 | G80 | {system}
offset: G10 L2 P{small} {axes} | G10 L20 P{small} {axes} | G10 L{small} P{small} {axes}
   | G92 {axes} | G92.1 | G92.2 | G92.3 | G52 {axes}
   | G10 L2 P{small} R{v} | {system} | G53 G0 {axes} | G28 {axes?} | G30 {axes?} | G28.1 | G30.1
   | {system} {move}
length: G43 H{small} | G43.1 Z{v} | G43.2 H{small} | G49 | G43 | G44 H{small}
   | G10 L1 P{small} Z{v} R{p} | G10 L10 P{small} {axes}
   | G10 L11 P{small} {axes} | G43.2 {axes} | G10 L1 P{small} Q{small} I{v} J{v} | G10 L0
dwell: G4 P{p} | G4 P{p} | G4 P{v} | G4 P{p} {move}
output: M70\n{item}\nM72\n{move} | M62 P{small} | M63 P{small} | M64 P{small} | M65 P{small}
   | M66 P{small} L{small} Q{p}
   | M66 E{small} | M67 E{small} Q{v}
   | M68 E{small} Q{v} | M48 | M49 | M50 P{small} | M51 P{small} | M52 P{small} | M53 P{small}
   | M19 R{p} | M19 R{v} Q{p} P{small}
   | M60 | M61 Q{small} | M70 | M71 | M72 | M73 | M0 | M1
turning: G18 S500 M3\nG0 X20 Z5\nG76 P1.5 Z-20 I-1 J0.4 K0.8 {thread?} {thread?}
   | G95 F0.{digit}1\n{arc} | G7 | G8 | G95 | G96 S{p} D{p} | G97 S{p} | G33 Z{v} K{p}
   | G33.1 Z-{p} K{p} | G95 F{p} G1 {axes} | G18
   | G76 P{p} Z-{p} I-{p} J{p} K{big}
   | G76 P{p} Z-{p} I-{p} J{p} K{big} R{p} Q{p} H{small} E{p} L{small}
thread: R{p} | Q{digit}0 | H{small} | E{digit} L{small} | J{p} | I1 | R2 | E2 L3 | H2
probe: G38.2 {axes} F{p} | G38.3 {axes} | G38.4 {axes} | G38.5 {axes} F{p} | G38.2 Z-{p} F{p}
cycle: {hole} {flat} Z-{p} R{p} {cycleword?} {repeat?} | {hole} X{v} Y{v} Z-{big} R{p} Q{p} P{p}
   | {hole} Z-{p} R{p}\n{flat}\n{flat} {repeat?}
   | {plane} {hole} {axes} R{p} | G91 {hole} X{s} Y{s} Z-{p} R{p} L{small}
   | G99 {hole} X{v} Z-{p} R{p} {cycleword?}\nG98 Y{v}\nG80
   | {hole} X{v} Z-{p} R{p} F{p} {cycleword?}
hole: G81 | G82 | G83 | G73 | G84 | G74 | G85 | G86 | G87 | G88 | G89 | G76
cycleword: Q{p} | P{p} | P{p} Q{p} | I{v} J{v}
repeat: L{small} | K{small}
side: G41 | G42
comp: {side} D{small}\nG1 X-10 Y-20\nX0 Y0\nG3 X10 Y10 R10\nG2 X20 Y20 R{big}\n\
     X30 Y20 R-12\nG1 X50 {zword?}\nG40\nG0 X60
   | G18 {side}.1 D{p}\nG1 X-50 Z-90\nX0 Z0\nG2 X{p} Z{p} R99\nG1 X{n} Z{n}\nG40 X99
   | G0 {flat}\n{side} D{small} {flat}\nG1 {flat}\n{flat}\n{arc}\nG40\nG0 {flat}
   | {side} D{small} | G41.1 D{p} {flat}
   | G42.1 D{p} L{small}
   | G40 | {side} D{small}\nG1 X20\nY20\nX0\nY0\nG40\nG0 X-20 Y-20
   | {side} {flat}\n{move}\n{move}\nG40
   | {side}.1 D{p}\nG1 X{s}\nG3 X{s} Y{s} R{big}\n{mode}\n{flat}\nG40 {move}
zword: Z{v}
spline: G93\n{curve}\nG94 {feed} | {curve} | {curve} | {curve}
   | G5 I{v} J{v} P{v} Q{v} X{v} Y{v}\nG5 P{v} Q{v} {flat}
   | G5.1 X{v} Y{v} I{v} J{v}\nG5.1 I{v} {flat} | G5 P{v} Q{v} {flat}
   | G5.2 P{p} L{small}\nX{v} Y{v} P{p}\n{flat} P{p}\n{flat}\nG5.3
   | G5.2 X{v} Y{v} P{p}\nX{v} Y{v}\nX{v} Y{v}\nG5.3 | G5.3
   | {plane} G5.1 {axes} I{v} J{v} K{v}
   | {plane} G5.2 P1 L3\n{axes} P1\n{axes} P1\n{axes} P{p}\nG5.3 | {nurbs}
   | G5.2 P1 L3\n{flat} P1\n{any}\n{flat} P1\n{move}
bspline: BSPLINE SD={small} X{v} Y{v}\nX{v} Y{v} PL={p}\nX{v} Y{v} PW={p}\n{flat}\nG1 X{v}
   | BSPLINE X{v} Y{v} PW={p}\nX{v} PL=0\nG0 {axes}
   | BSPLINE {axes} | SD=3 {move} | BSPLINE SD=2 X1\nX2 PL=1\nX3 PL=1\nM2
words: {code} {any?} {any?} | G{v} {axes} | M{v} | {code} {code?} {axes?} {any?}
   | {any} {any?} {code?} {any?}
   | {code}{any} | {code} {axes} {feed?} {any?}
odd: / {move} | N{small} {move} (note) ; more | (MSG, {n}) | (a note) {move} | % | ; only a note
   | N{small} | /{item} | ({n} {move}
   | $H | $X
   | $J=G91 X{n} F{p} | O{small} | M2 | M30 | (print, {n} #5420) | (debug, #<{name}> {n})
   | (abort, #{n}) | (probeopen a.txt) | (log, {n})
item: {move} | {move} | {arc} | {speed} | {tool} | {mode} | {offset} | {length} | {dwell}
   | {output} | {turning} | {probe} | {cycle}
   | {cycle} | {comp} | {comp} | {spline} | {bspline} | {words} | {odd} | {flow} | {flow}
   | {assign} | {cross}
cross: {foreign}
lines: {move} | {item} | {move}\n{item} | {assign}\n{move} | {item}\n{item}\n{move}
tail: {move} | {arc} | {speed} | {tool} | {mode} | {offset} | {length} | {dwell} | {output}
   | {turning} | {probe} | {cycle} | {comp}
   | {spline}
   | {words} | {assign} | {move} {any} | {words}
head: F200 S1000 M3 | {set}\nF100 G0 X0 Y0 Z10 | {set}\nT1 M6\nS500 M3 F300
   | {set}\nG21 G90 G17\nG0 X{n} Y{n} Z5\nG1 F{p} | G1 F100
   | {set}\nT2 M6\nG43 H2\nG1 X0 Y0 Z0 F500\nS{p} M4 | {set}\nG1 F100
end: M2 | M30 | M2\n%
"""

NGC = r"""
set: #1=2 #2=[#1+1] #<foo>=1.5 #<_bar>=2\n#<depth>=-3 #<f oo>=4 #<_x1>=5 #31=6
   | #1=1 #<foo>=[#1*2] #<_bar>=#1 #<depth>=1
v: {n} | {n} | {n} | {n} | {n} | {n} | [{expr}] | [{expr}] | #{par} | #<{name}> | -[{expr}]
   | {fn}[{expr}] | #{par}
p: {positive} | {positive} | {positive} | {positive} | {positive} | [ABS[{expr}]+1] | [{positive}*2]
s: {short} | {short} | {short} | {short} | [{short}/2]
small: {digit} | {digit} | {digit} | {digit} | [{digit}+1] | #1
fn: SIN | COS | TAN | ASIN | ACOS | EXP | LN | SQRT | ABS | FIX | FUP | ROUND
op: + | - | * | / | + | - | * | ** | MOD | AND | OR | XOR | EQ | NE | GT | GE | LT | LE
expr: {n} | #{par} | {n} {op} {n} | #{par} {op} {n} | {v} {op} {v} | {n}+{n}*{n}
   | ATAN[{expr}]/[{expr}] | EXISTS[#<{name}>] | {fn}[{v}]
   | #<{name}> {op} {n} | {n} {op} {v} {op} {v} | -{v} | [{expr}] | #[{digit}+1] | ##1
   | 2*#{par}-{n}
cond: {n} {op} {n} | #{par} LT {n} | #{par} GT {n} | 0 | 1 | #1 EQ {n} | {expr}
   | EXISTS[#<{name}>] AND 1
assign: #{par}={v} | #{par} = {v} #{par} = {v} | #<{name}>={v} | #<{name}>=[{expr}] {move}
   | #[{expr}]={n} | ##1={n} | #{par}=[#{par}+1]
   | #5220={small} | #5399 = 1 | #<_{name}>={v}
label: {digit} | <{name}> | {digit} | {digit}
flow: o{A} if [{cond}]\n{lines}\no{A} endif
   | o{A} if [{cond}]\n{lines}\no{A} elseif [{cond}]\n{lines}\no{A} else\n{lines}\no{A} endif
   | #1=0\no{A} while [#1 LT {digit}]\n{lines}\n#1=[#1+1]\no{A} endwhile
   | #2=0\no{A} do\n{lines}\n#2=[#2+1]\no{A} while [#2 LT {digit}]
   | o{A} repeat [{digit}]\n{lines}\no{A} endrepeat
   | o{A} sub\n{lines}\no{A} endsub [{v}]\no{A} call [{v}] [{v}]\n{lines}
   | o<{A}> sub\nG1 X#1 Y[#2+1]\n{lines}\no<{A}> return [{v}]\no<{A}> endsub\n\
     o<{A}> call [{v}] [{v}] [{v}]\n#3=#<_value>
   | o{A} repeat [{v}]\n{lines}\no{B} if [{cond}]\no{A} break\no{B} endif\n{lines}\no{A} endrepeat
   | #1=0\no{A} while [#1 LT 5]\n#1=[#1+1]\no{B} if [#1 EQ 2]\no{A} continue\no{B} else\n\
     o{A} break\no{B} endif\n{lines}\no{A} endwhile
   | o{A} {keyword} [{v}] | o{label} {keyword} | o<{file}> call [{v}] [{v}] | o<{file}> call
   | o[{A}] call | M98 P{digit} L{small}
   | o{A} while [1]\n{lines}\no{A} endwhile | o{A} sub\no{A} call\no{A} endsub\no{A} call
   | o{A} sub\nM99\no{A} endsub\no{A} call [{v}]
   | o{A} if [{cond}]\n{lines}\no{B} endif | o{A} do\n{lines}\n{flow}\no{A} while [0]
   | M98 P{label} | O{A}\n{lines}\nM99
   | #5=[{digit}+1]\no#5 call | o{A} endsub | o{A} if [{cond}]\n{flow}\n{flow}\no{A} endif
keyword: sub | endsub | call | return | if | elseif | else | endif | while | endwhile | do
   | repeat | endrepeat | break | continue
   | cal | loop
foreign: G4 X{p} | IF [{cond}] GOTO {digit} | GOTO 10 | WHILE [{cond}] DO1\nEND1
   | G65 P{digit} A{v} | #1=#0 | G6.2 P3 K0 X0 R1 | $H
sub: o{A} sub\n{lines}\no{A} endsub\n{lines}\no{A} call [{v}] [{v}]
"""

MACRO = r"""
set: #1=2\n#2=#1+1\n#100=3. | #500=-1.5\n#1=3 | #30=1
v: {n} | {n} | {n} | {n} | {n} | {n} | [{expr}] | [{expr}] | #{par} | #0 | -#{par} | {fn}[{expr}]
   | -[{expr}]
p: {positive} | {positive} | {positive} | {positive} | {positive} | [ABS[{expr}]+1]
s: {short} | {short} | {short} | [{short}/2]
small: {digit} | {digit} | {digit} | {digit} | [{digit}+1] | #1
fn: SIN | COS | TAN | ASIN | ACOS | EXP | LN | SQRT | ABS | FIX | FUP | ROUND | BIN | BCD | RND
   | SQR
op: + | - | * | / | + | - | * | MOD | AND | OR | XOR | EQ | NE | GT | GE | LT | LE
expr: {n} | #{par} | {n} {op} {n} | #{par} {op} {n} | {v} {op} {v} | {n}+{n}*{n}
   | ATAN[{expr}]/[{expr}] | ATAN[{expr}] | {fn}[{v}] | -{v}
   | [{expr}] | #[{digit}+1] | ##1
cond: {n} {op} {n} | #{par} LT {n} | #{par} EQ #0 | #{par} NE #0 | #1 EQ {n} | {expr}
   | #{par} GT {n}
assign: #{par}={v} | #{par}={expr} | #[{expr}]={n} | ##1={n} | #{par}=#{par}+1 | #{par}=#0
   | #500={v}
flow: IF [{cond}] GOTO {A}\n{lines}\nN{A} {move} | IF [{cond}] THEN {assign}
   | #1=0\nWHILE [#1 LT {digit}] DO1\n{lines}\n#1=#1+1\nEND1
   | #2=0\nWHILE [#2 LT 3] DO2\n#2=#2+1\n#1=0\nWHILE [#1 LT 2] DO1\n#1=#1+1\n{lines}\nEND1\nEND2
   | GOTO {A}\n{lines}\nN{A}
   | GOTO #{par} | N{A} {move}\n#100=#100+1\nIF [#100 LT {digit}] GOTO {A}
   | DO1\n{lines}\nIF [{cond}] GOTO {A}\nEND1\nN{A}
   | G65 P{prog} A{v} B{v} X{v} | G65 P{prog} L{small} I{v} J{v} K{v} I{v} | M98 P{prog} L{small}
   | M98 P{prog} | M98 P{digit}000{digit}
   | WHILE [{cond}] DO1\n{lines}\nEND1 | END1 | DO4 | WHILE [1 EQ 1] DO3\n{lines}\nEND3
   | G65 A{v} | M99 | M99 P{A}\nN{A}
   | IF [{cond}] {move}
   | IF [{cond}] GOTO #{par} | G65 P{prog} A{v} A{v}
   | WHILE [{cond}] DO1\nWHILE [{cond}] DO1\nEND1\nEND1
foreign: o{digit} sub | o{digit} if [1 EQ 1] | #<{name}>=1 | [2**2] | o{digit} call | #1=1 #2=2
   | EXISTS[#1]
sub: {lines}
"""

NONE = r"""
set: G21
tool: T{small} | M5 | M30
length: G43.1 Z{v} | G49
output: M0 | M1
turning: G18 | G94
cycle: G0 {axes}\nG80
comp: G40
spline: {arc}
bspline: {arc}
system: G54 | G55 | G59
offset: G10 L2 P{small} {axes} | G10 L20 P{small} {axes} | G92 {axes} | G92.1 | {system}
   | G53 G0 {axes} | G28 {axes?} | G30 | G28.1 | G30.1
plane: G17 | G18
v: {n}
p: {positive}
s: {short}
small: {digit}
assign: {move} | {move} | {move} | #{par}={n}
flow: {move} | {arc} | {mode} | {offset}
foreign: o{digit} call | #1=2 | X[1+2] | IF [1] GOTO 2 | G65 P{digit} | M98 P{digit} | X#{par}
cond: 1
expr: {n}
sub: {lines}
"""

LINUXCNC = r"""
bspline: {curve}
"""

PAPER = r"""
bspline: {nurbs}
"""

FANUC = r"""
bspline: {nurbs}
spline: {nurbs}
mode: {plane} | G20 | G21 | G90 | G91 | G94 | G61 | G64 | G40 | G49 | G80 | {system}
arc: {turn} I{p} J{p} {feed?} | {turn} X{s} Y{s} R{big} | {turn} X{s} R-{big}
   | {plane} {turn} {axes} R{big} | {turn} I{s} Z{v}
system: G54 | G55 | G56 | G57 | G58 | G59
offset: G10 L2 P{small} {axes} | G10 L1{small} P{small} R{v} | G92 {axes} | G52 {axes} | {system}
   | G53 G0 {axes}
   | G28 {axes} | G30 P2 {axes}
length: G43 H{small} | G43 Z{v} H{small} | G49 | G44 H{small}
dwell: G4 P{digit}00 | G4 X{p} | G4 P{p}
output: M0 | M1 | M19 | M48 | M49 | M19 R{p}
turning: G95 | G96 S{p} | G97 S{p} | G95 F{p} G1 {axes} | G18 | G98 | G99
probe: {move}
comp: G0 {flat}\n{side} D{small} {flat}\nG1 {flat}\n{flat}\n{arc}\nG40\nG0 {flat}
   | {side} D{small} | G40
   | {side} D{small}\nG1 X20\nY20\nX0\nY0\nG40\nG0 X-20 Y-20
   | {side} {flat} D{small}\n{move}\n{move}\nG40
"""

Parts = list[str | tuple[str, bool]]


def _read(text: str) -> dict[str, list[Parts]]:
    """Parse a table; each alternative is a list of text and of (name, whether it is optional)."""
    table: dict[str, list[Parts]] = {}
    for line in text.replace("\\\n     ", "").replace("\n   |", " |").strip().split("\n"):
        if not line:
            continue
        name, _, rest = line.partition(": ")
        table[name] = [
            _parts(alternative.strip(" ").replace("\\n", "\n")) for alternative in rest.split(" | ")
        ]
    return table


def _parts(alternative: str) -> Parts:
    parts: Parts = []
    while alternative:
        text, brace, alternative = alternative.partition("{")
        if text:
            parts.append(text)
        if brace:
            name, _, alternative = alternative.partition("}")
            parts.append((name.removesuffix("?"), name.endswith("?")))
    return parts


FLAVOURS = {
    "ngc": _read(COMMON) | _read(NGC),
    "macro-b": _read(COMMON) | _read(MACRO),
    "none": _read(COMMON) | _read(NONE),
    "siemens": _read(COMMON) | _read(NONE),
}
"""The grammar of each flavour."""
DIALECTS = {
    "linuxcnc": _read(LINUXCNC),
    "paper": _read(PAPER),
    "fanuc": _read(FANUC),
    "haas": _read(FANUC),
    "auto": {},
    "grbl": {},
    "mach3": {},
    "siemens": {},
    "marlin": {},
    "fagor": {},
}
"""Differences of the dialects."""
