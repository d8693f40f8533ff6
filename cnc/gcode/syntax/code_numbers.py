"""G- and M-codes of all dialects.

A member is named as the standard writes the code, with ``_`` for the point: ``G.G5_3`` is G5.3.
"""

from __future__ import annotations

from enum import IntEnum


class G(IntEnum):
    """G-codes; the value of a member is ten times the code."""

    G0 = 0
    G1 = 10
    G2 = 20
    G3 = 30
    G4 = 40
    G5 = 50
    G5_1 = 51
    G5_2 = 52
    G5_3 = 53
    G6_2 = 62
    G7 = 70
    G8 = 80
    G9 = 90
    G10 = 100
    G12 = 120
    G13 = 130
    G15 = 150
    G16 = 160
    G17 = 170
    G18 = 180
    G19 = 190
    G20 = 200
    G21 = 210
    G28 = 280
    G28_1 = 281
    G30 = 300
    G30_1 = 301
    G31 = 310
    G33 = 330
    G33_1 = 331
    G38_2 = 382
    G38_3 = 383
    G38_4 = 384
    G38_5 = 385
    G40 = 400
    G41 = 410
    G41_1 = 411
    G42 = 420
    G42_1 = 421
    G43 = 430
    G43_1 = 431
    G43_2 = 432
    G43_4 = 434
    G43_5 = 435
    G44 = 440
    G49 = 490
    G50 = 500
    G50_1 = 501
    G51 = 510
    G51_1 = 511
    G52 = 520
    G53 = 530
    G53_1 = 531
    G54 = 540
    G54_1 = 541
    G55 = 550
    G56 = 560
    G57 = 570
    G58 = 580
    G59 = 590
    G59_1 = 591
    G59_2 = 592
    G59_3 = 593
    G61 = 610
    G61_1 = 611
    G64 = 640
    G65 = 650
    G66 = 660
    G67 = 670
    G68 = 680
    G68_2 = 682
    G69 = 690
    G70 = 700
    G71 = 710
    G72 = 720
    G73 = 730
    G74 = 740
    G75 = 750
    G76 = 760
    G77 = 770
    G78 = 780
    G79 = 790
    G80 = 800
    G81 = 810
    G82 = 820
    G83 = 830
    G84 = 840
    G85 = 850
    G86 = 860
    G87 = 870
    G88 = 880
    G89 = 890
    G90 = 900
    G90_1 = 901
    G91 = 910
    G91_1 = 911
    G92 = 920
    G92_1 = 921
    G92_2 = 922
    G92_3 = 923
    G93 = 930
    G94 = 940
    G95 = 950
    G96 = 960
    G97 = 970
    G98 = 980
    G99 = 990
    BSPLINE = -10
    """Siemens' motion code that is a word. A program can read this number as #<_motion_mode>."""

    @property
    def code(self) -> float:
        """The number behind the letter: 5.3 of G5.3."""
        return self / 10

    @property
    def written(self) -> str:
        """The code as messages name it: "G5.3"."""
        return "BSPLINE" if self is G.BSPLINE else f"G{self / 10:g}"


class M(IntEnum):
    """M-codes."""

    M0 = 0
    M1 = 1
    M2 = 2
    M3 = 3
    M4 = 4
    M5 = 5
    M6 = 6
    M7 = 7
    M8 = 8
    M9 = 9
    M19 = 19
    M30 = 30
    M48 = 48
    M49 = 49
    M50 = 50
    M51 = 51
    M52 = 52
    M53 = 53
    M60 = 60
    M61 = 61
    M62 = 62
    M63 = 63
    M64 = 64
    M65 = 65
    M66 = 66
    M67 = 67
    M68 = 68
    M70 = 70
    M71 = 71
    M72 = 72
    M73 = 73
    M78 = 78
    M79 = 79
    M97 = 97
    M98 = 98
    M99 = 99
    M428 = 428
    M429 = 429
    M430 = 430


# Look-ups in these are faster than calls of the classes.
G_OF_TENTHS = {code.value: code for code in G}
M_OF_NUMBER = {code.value: code for code in M}
