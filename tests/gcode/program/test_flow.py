"""Control flow of RS274/NGC: programs of O-words.

The expected moves were worked out by hand.
"""

from __future__ import annotations

import pytest

from tests.support.gcode.flow_moves import xs

COUNTED = "#1 = [#1 + 1]\n"

CASES: dict[str, tuple[str, list[float]]] = {
    # if
    "if": ("o1 if [1]\nG0 X1\no1 endif\no2 if [0]\nG0 X2\no2 endif\nG0 X3", [1, 3]),
    "else": (
        "o1 if [0]\nG0 X1\no1 else\nG0 X2\no1 endif\no2 if [1]\nG0 X3\no2 else\nG0 X4\no2 endif",
        [2, 3],
    ),
    "elseif": (
        "#1=0\no9 while [#1 LT 4]\n#1=[#1+1]\no1 if [#1 EQ 1]\nG0 X10\no1 elseif [#1 LT 3]\n"
        "G0 X20\no1 elseif [#1 LT 3]\nG0 X30\n"
        "o1 else\nG0 X40\no1 endif\no9 endwhile",
        [10, 20, 40, 40],
    ),
    "elseif without else": ("o1 if [0]\nG0 X1\no1 elseif [0]\nG0 X2\no1 endif\nG0 X3", [3]),
    "any number but 0 is true": (
        "o1 if [-0.25]\nG0 X1\no1 endif\no2 if [0.0]\nG0 X2\no2 endif",
        [1],
    ),
    "if in if": (
        "o1 if [1]\no2 if [0]\nG0 X1\no2 else\no3 if [1]\nG0 X2\no3 endif\no2 endif\nG0 X3\n"
        "o1 else\nG0 X4\no1 endif",
        [2, 3],
    ),
    "a condition that is not asked is not computed": (
        "o1 if [1]\nG0 X1\no1 elseif [1/0]\no1 endif",
        [1],
    ),
    "what is skipped is not read": ("o1 if [0]\nthis is no G-code\n)(\no1 endif\nG0 X1", [1]),
    # loops
    "while": (f"#1=0\no1 while [#1 LT 3]\nG0 X#1\n{COUNTED}o1 endwhile", [0, 1, 2]),
    "while never": ("o1 while [0]\nG0 X1\no1 endwhile\nG0 X2", [2]),
    "while in while": (
        f"#1=0\no1 while [#1 LT 2]\n{COUNTED}#2=0\no2 while [#2 LT 2]\n#2=[#2+1]\nG0 X[10*#1+#2]\n"
        f"o2 endwhile\no1 endwhile",
        [11, 12, 21, 22],
    ),
    "do while": (f"#1=5\no1 do\nG0 X#1\n{COUNTED}o1 while [#1 LT 3]", [5]),
    "do while again": (f"#1=0\no1 do\n{COUNTED}G0 X#1\no1 while [#1 LT 3]", [1, 2, 3]),
    "do in do": (
        f"#1=0\no1 do\n{COUNTED}#2=0\no2 do\n#2=[#2+1]\nG0 X[10*#1+#2]\no2 while [#2 LT 2]\n"
        f"o1 while [#1 LT 2]",
        [11, 12, 21, 22],
    ),
    "while in do": (
        f"#1=0\no1 do\n{COUNTED}o2 while [#1 EQ 1]\nG0 X#1\n{COUNTED}o2 endwhile\n"
        f"o1 while [#1 LT 4]",
        [1],
    ),
    "repeat": ("o1 repeat [3]\nG0 X1\no1 endrepeat", [1, 1, 1]),
    "repeat rounds, halves to the even number": (
        "".join(
            f"o{n} repeat [{count}]\nG0 X{n}\no{n} endrepeat\n"
            for n, count in enumerate(["2.4", "2.5", "3.5", "0.5", "0.6"], 1)
        ),
        [1, 1, 2, 2, 3, 3, 3, 3, 5],
    ),
    "repeat never": (
        "o1 repeat [0]\nG0 X1\no1 endrepeat\no2 repeat [-5]\nG0 X2\no2 endrepeat\nG0 X3",
        [3],
    ),
    "repeat in repeat": (
        f"o1 repeat [2]\no2 repeat [2]\n{COUNTED}G0 X#1\no2 endrepeat\no1 endrepeat",
        [1, 2, 3, 4],
    ),
    "the count of repeat is asked once": (
        f"#1=2\no1 repeat [#1]\n{COUNTED}G0 X#1\no1 endrepeat",
        [3, 4],
    ),
    "break": (
        f"o1 while [1]\n{COUNTED}o2 if [#1 GT 2]\no1 break\no2 endif\nG0 X#1\no1 endwhile\nG0 X9",
        [1, 2, 9],
    ),
    "break of do": (
        f"o1 do\n{COUNTED}o2 if [#1 GT 2]\no1 break\no2 endif\nG0 X#1\no1 while [1]\nG0 X9",
        [1, 2, 9],
    ),
    "break out of two": (
        "o1 while [1]\no2 while [1]\nG0 X1\no1 break\no2 endwhile\nG0 X2\no1 endwhile\nG0 X3",
        [1, 3],
    ),
    "break out of a repeat": (
        f"o9 repeat [2]\no1 while [1]\no2 repeat [5]\n{COUNTED}G0 X#1\no1 break\no2 endrepeat\n"
        f"o1 endwhile\no9 endrepeat",
        [1, 2],
    ),
    "continue": (
        f"o1 while [#1 LT 4]\n{COUNTED}o2 if [#1 EQ 2]\no1 continue\no2 endif\nG0 X#1\no1 endwhile",
        [1, 3, 4],
    ),
    "continue of do asks the condition": (
        f"o1 do\n{COUNTED}G0 X#1\no1 continue\nG0 X99\no1 while [#1 LT 3]",
        [1, 2, 3],
    ),
    "continue of the outer loop": (
        f"o1 while [#1 LT 2]\n{COUNTED}o2 while [1]\nG0 X#1\no1 continue\no2 endwhile\nG0 X9\n"
        f"o1 endwhile",
        [1, 2],
    ),
    "do after a break": (
        f"o1 while [1]\no1 break\no1 endwhile\n#1=0\no2 do\n{COUNTED}G0 X#1\no2 while [#1 LT 2]",
        [1, 2],
    ),
    # calls
    "sub": ("o1 sub\nG0 X1\no1 endsub\nG0 X2\no1 call\nG0 X3\no1 call", [2, 1, 3, 1]),
    "a sub behind the end": ("o1 call\nG0 X2\nM2\no1 sub\nG0 X1\no1 endsub", [1, 2]),
    "a sub that is never closed is of no concern where it is never called": (
        "G0 X1\nM2\no1 sub\nG0 X2",
        [1],
    ),
    "arguments": (
        "o1 sub\nG0 X[#1 + 10*#2]\no1 endsub\no1 call [1] [2]\no1 call [3]\no1 call",
        [21, 3, 0],
    ),
    "arguments are computed before the call": (
        "#1=5\n#2=6\no1 sub\nG0 X[#1 + 10*#2]\no1 endsub\no1 call [#2] [#1]",
        [56],
    ),
    "thirty arguments": (
        f"o1 sub\nG0 X#30\no1 endsub\no1 call {''.join(f'[{n}]' for n in range(1, 31))}",
        [30],
    ),
    "numbers to 30 are the sub's own": (
        "o1 sub\n#1=[#1+1]\n#31=[#31+1]\nG0 X#1\no1 endsub\n#1=50\no1 call [7]\nG0 X#1\nG0 X#31",
        [8, 50, 1],
    ),
    "names are the sub's own": (
        "o1 sub\n#<a>=2\n#<_mine>=3\nG0 X#<a>\no1 endsub\n#<a>=1\no1 call\nG0 X#<a>\nG0 X#<_mine>",
        [2, 1, 3],
    ),
    "return": (
        "o1 sub\no2 if [#1]\no1 return\no2 endif\nG0 X1\no1 endsub\no1 call [1]\nG0 X2\no1 call",
        [2, 1],
    ),
    "a return of any label": (
        "o1 sub\no2 if [#1]\no2 return [7]\no2 endif\nG0 X1\no1 endsub\no1 call [1]\n"
        "G0 X#<_value>\no1 call",
        [7, 1],
    ),
    "return out of loops": (
        "o1 sub\no2 repeat [5]\no3 while [1]\nG0 X1\no1 return\no3 endwhile\no2 endrepeat\n"
        "o1 endsub\no1 call\no1 call",
        [1, 1],
    ),
    "a value": (
        "o1 sub\no1 return [#1 * 2]\no1 endsub\no1 call [4]\nG0 X#<_value>\nG0 X#<_value_returned>",
        [8, 1],
    ),
    "a value at the end": ("o1 sub\no1 endsub [#1 * 3]\no1 call [4]\nG0 X#<_value>", [12]),
    "no value": (
        "o1 sub\no1 endsub\no2 sub\no2 endsub [5]\no2 call\no1 call\nG0 X#<_value>\n"
        "G0 X#<_value_returned>",
        [0, 0],
    ),
    "the last value is still there when the arguments are computed": (
        "o1 sub\no1 endsub [#1 + 1]\no1 call [1]\no1 call [#<_value>]\nG0 X#<_value>",
        [3],
    ),
    "recursion": (
        "o1 sub\no2 if [#1 LE 1]\no1 return [1]\no2 endif\no1 call [#1 - 1]\n"
        "o1 endsub [#1 * #<_value>]\no1 call [5]\nG0 X#<_value>",
        [120],
    ),
    "repeat loops of calls count for themselves": (
        "o1 sub\no2 repeat [2]\nG0 X#1\no3 if [#1 GT 0]\no1 call [#1 - 1]\no3 endif\no2 endrepeat\n"
        "o1 endsub\no1 call [1]",
        [1, 0, 0, 1, 0, 0],
    ),
    "subs call each other": (
        "o1 sub\nG0 X1\no2 call\no1 endsub\no2 sub\nG0 X2\no2 endsub\no1 call",
        [1, 2],
    ),
    "a computed label": (
        "o7 sub\nG0 X7\no7 endsub\no8 sub\nG0 X8\no8 endsub\n#1=6\no[#1+1] call\n#1=8\no#1 call\n"
        "o[7] call",
        [7, 8, 7],
    ),
    "leading zeros": ("o007 sub\nG0 X1\no7 endsub\no07 call", [1]),
    "names": ("O<Drill Hole> SUB\nG0 X1\no<drillhole>endsub\no<DRILL HOLE> call", [1]),
    "labels of subs and of the main program are apart": (
        "o1 sub\no2 if [1]\nG0 X1\no2 endif\no1 endsub\no2 if [1]\no1 call\no1 call\no2 endif\n"
        "o1 if [1]\nG0 X3\no1 endif",
        [1, 1, 3],
    ),
    "M2 in a sub": ("o1 sub\nG0 X1\nM2\no1 endsub\no1 call\nG0 X2", [1]),
    # programs
    "M98": ("G0 X1\nM98 P100\nG0 X3\nM30\nO100\nG0 X2\nM99", [1, 2, 3]),
    "M98 of a main program with a number": ("O1 (main)\nM98 P100\nM30\nO100\nG0 X2\nM99", [2]),
    "M98 L": (f"M98 P100 L3\nM98 P100 L0\nG0 X9\nM2\nO100\n{COUNTED}G0 X#1\nM99", [1, 2, 3, 9]),
    "M98 shares the numbers": (
        "#1=1\n#31=1\nM98 P100\nG0 X#1\nG0 X#31\nM2\nO100\n#1=5\n#31=6\nM99",
        [5, 6],
    ),
    "M98 has names of its own": (
        "#<a>=1\nM98 P100\nG0 X#<a>\nM2\nO100\n#<a>=2\nG0 X#<a>\nM99",
        [2, 1],
    ),
    "M98 behind a computed move": ("#1=3\nG0 X[#1 * 2] M98 P100\nM2\nO100\nG0 X2\nM99", [6, 2]),
    "M98 behind a move": ("G0 X1 M98 P100\nM2\nO100\nG0 X2\nM99 X4", [1, 2, 4]),
    "M98 with what was computed before its line": (
        "#1=100 \nM98 P#1 L[#1-98] #1=7\nG0 X#1\nM2\nO100\nG0 X#1\nM99",
        [7, 7, 7],
    ),
    "M98 within M98": (
        "M98 P1 L2\nM2\nO1\nG0 X1\nM98 P2 L2\nM99\nO2\nG0 X2\nM99",
        [1, 2, 2, 1, 2, 2],
    ),
    "M98 in the order of the file or not": ("M98 P2\nM2\nO1\nG0 X1\nM99\nO2\nM98 P1\nM99", [1]),
    "loops in M98": ("M98 P1 L2\nM2\nO1\no5 repeat [2]\nG0 X1\no5 endrepeat\nM99", [1, 1, 1, 1]),
    "M99 beside M30": ("M98 P1\nG0 X9\nM2\nO1\nG0 X1 M30 M99", [1]),
    "five times five": (
        "O1\n#1=0\nM98 P100 L5\nG0 X#1\nM30\n\nO100\n#1=[#1 + 1]\nM98 P200 L5\nM99\n\nO200\n"
        "#1=[#1 + 0.25]\nM99",
        [11.25],
    ),
    "M99 in a loop": ("M98 P1 L2\nM2\nO1\no5 repeat [5]\nG0 X1\nM99\no5 endrepeat\nM99", [1, 1]),
    "a sub calls a program": (
        "o1 sub\nM98 P5\nG0 X#1\no1 endsub\no1 call [3]\nM2\nO5\nG0 X[#1 * 2]\nM99",
        [6, 3],
    ),
    # the program as a whole
    "text behind the second percent": ("%\nG0 X1\n%\nthis is not read", [1]),
    "program number behind a percent": ("%\nO12\nG0 X1\n%", [1]),
    "no control in comments": ("(o1 if [0])\nG0 X1\n; o1 endif", [1]),
    "line numbers": ("N10 o1 repeat [2]\nN20 G0 X1\nN30 o1 endrepeat", [1, 1]),
    "comments beside": ("o1 repeat [2] (twice)\nG0 X1\no1 endrepeat ; done", [1, 1]),
    "blanks and case": ("O 1 Re Peat[ 2 ]\nG0 X1\n\to1EndRepeat", [1, 1]),
    "empty lines": ("o1 repeat [2]\n\n  \nG0 X1\n\no1 endrepeat\n\n", [1, 1]),
}


@pytest.mark.parametrize(("source", "moves"), CASES.values(), ids=CASES)
def test_programs_make_the_expected_moves(source: str, moves: list[float]) -> None:
    assert xs(source) == moves
