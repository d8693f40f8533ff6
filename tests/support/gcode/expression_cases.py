"""Random expressions, and an oracle of their values.

The oracle is a recursion over the tree, in exact arithmetic where possible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from random import Random

UNARY = ["ABS", "ACOS", "ASIN", "COS", "EXP", "FIX", "FUP", "LN", "ROUND", "SIN", "SQRT", "TAN"]
LEVELS = [
    ["**"],
    ["*", "/", "MOD"],
    ["+", "-"],
    ["EQ", "NE", "GT", "GE", "LT", "LE"],
    ["AND", "OR", "XOR"],
]
MACRO_LEVELS = [
    ["*", "/", "MOD", "AND"],
    ["+", "-", "OR", "XOR"],
    ["EQ", "NE", "GT", "GE", "LT", "LE"],
]


class NoValue(Exception):
    """The expression has no value."""


@dataclass(frozen=True)
class Tree:
    """``kind``: number, parameter, name, sign, operator, function, atan."""

    kind: str
    text: str = ""
    parts: tuple[Tree, ...] = ()


def grow(rng: Random, depth: int, *, macro: bool = False) -> Tree:
    """A random tree."""
    kind = rng.random() if depth else 0.0
    if kind < 0.3:
        choice = rng.random()
        if choice < 0.6:
            return Tree(
                "number",
                rng.choice(
                    [
                        str(rng.randint(0, 9)),
                        f"{rng.uniform(0, 100):.3f}",
                        f".{rng.randint(0, 999)}",
                        "90.",
                        "0.5",
                    ]
                ),
            )
        if choice < 0.9 or macro:
            return Tree(
                "parameter", parts=(Tree("number", str(rng.choice([1, 2, 3, 30, 100, 101]))),)
            )
        return Tree("name", rng.choice(["a", "_g"]))
    if kind < 0.4:
        return Tree("sign", rng.choice("+--"), (grow(rng, depth - 1, macro=macro),))
    if kind < 0.6:
        return Tree("function", rng.choice(UNARY), (grow(rng, depth - 1, macro=macro),))
    if kind < 0.65:
        return Tree(
            "atan", "ATAN", (grow(rng, depth - 1, macro=macro), grow(rng, depth - 1, macro=macro))
        )
    operator = rng.choice([name for level in (MACRO_LEVELS if macro else LEVELS) for name in level])
    return Tree(
        "operator", operator, (grow(rng, depth - 1, macro=macro), grow(rng, depth - 1, macro=macro))
    )


def spell(tree: Tree, rng: Random | None = None, *, macro: bool = False) -> str:
    """The tree as text with minimal brackets; with ``rng`` also spare ones, blanks and any case."""
    text, _ = _spell(tree, rng, macro)
    if rng is None:
        return text
    spread = "".join(
        rng.choice(["", "", " ", "\t "]) + rng.choice([char.lower(), char.upper()]) for char in text
    )
    return spread


def _spell(tree: Tree, rng: Random | None, macro: bool) -> tuple[str, int]:
    """Text and level: -1 for an operand, 0 for one with a sign, else the level of the operator."""
    if tree.kind == "number":
        text, level = tree.text, -1
    elif tree.kind == "parameter":
        text, level = "#" + tree.parts[0].text, -1
    elif tree.kind == "name":
        text, level = f"#<{tree.text}>", -1
    elif tree.kind == "sign":
        text, level = tree.text + _within(tree.parts[0], -1, rng, macro), 0
    elif tree.kind == "function":
        text, level = f"{tree.text}[{_spell(tree.parts[0], rng, macro)[0]}]", -1
    elif tree.kind == "atan":
        text, level = (
            "ATAN" + "/".join(f"[{_spell(part, rng, macro)[0]}]" for part in tree.parts),
            -1,
        )
    else:
        levels = MACRO_LEVELS if macro else LEVELS
        level = 1 + next(index for index, names in enumerate(levels) if tree.text in names)
        # From left to right: what stands on the right of an equal level needs brackets.
        left, right = (
            _within(tree.parts[0], level, rng, macro),
            _within(tree.parts[1], level - 1, rng, macro),
        )
        text = f"{left}{tree.text}{right}"
    if rng is not None and rng.random() < 0.1:
        return f"[{text}]", -1
    return text, level


def _within(tree: Tree, most: int, rng: Random | None, macro: bool) -> str:
    text, level = _spell(tree, rng, macro)
    return text if level <= most else f"[{text}]"


def worth(tree: Tree, known: dict[str, float], *, macro: bool = False) -> float:
    """The value of a tree. Raises NoValue if it is undefined or not finite."""
    if tree.kind == "number":
        return float(tree.text)
    if tree.kind in ("parameter", "name"):
        return known.get(tree.text or tree.parts[0].text, 0.0)
    parts = [worth(part, known, macro=macro) for part in tree.parts]
    try:
        if tree.kind == "sign":
            value = -parts[0] if tree.text == "-" else parts[0]
        elif tree.kind == "function":
            value = float(_function(tree.text, parts[0], macro))
        elif tree.kind == "atan":
            value = math.atan2(*parts) * (180 / math.pi)
            if macro and value < 0:
                value += 360
        else:
            value = float(_operator(tree.text, *parts, macro))
    except (ValueError, ZeroDivisionError, OverflowError):
        raise NoValue from None
    if not math.isfinite(value):
        raise NoValue
    return value


def _function(name: str, x: float, macro: bool) -> float:
    exact = Fraction(x)
    match name:
        case "ABS":
            return math.copysign(x, 1)
        case "FIX":
            return exact.__trunc__() if macro else exact.__floor__()
        case "FUP":
            return math.copysign(-(-abs(exact) // 1), x) if macro else exact.__ceil__()
        case "ROUND":
            return math.copysign((abs(exact) + Fraction(1, 2)) // 1, x)
        case "SIN" | "COS" | "TAN" if exact % 90 == 0:
            quarter = int(exact / 90 % 4)
            if name == "TAN" and quarter % 2:
                raise ValueError
            return {"SIN": (0, 1, 0, -1), "COS": (1, 0, -1, 0), "TAN": (0, 0, 0, 0)}[name][quarter]
        case "SIN" | "COS" | "TAN":
            return {"SIN": math.sin, "COS": math.cos, "TAN": math.tan}[name](x * (math.pi / 180))
        case "ASIN" | "ACOS":
            angle = {"ASIN": math.asin, "ACOS": math.acos}[name](x) * (180 / math.pi)
            return angle + 360 if macro and angle < 0 else angle
        case _:
            return {"EXP": math.exp, "LN": math.log, "SQRT": math.sqrt}[name](x)


def _operator(name: str, a: float, b: float, macro: bool) -> float:
    match name:
        case "+":
            return a + b
        case "-":
            return a - b
        case "*":
            return a * b
        case "/":
            return a / b
        case "**":
            value = a**b
            if isinstance(value, complex):
                raise ValueError
            return value
        case "MOD" if macro:
            rest = abs(_function("ROUND", a, True)) % abs(_function("ROUND", b, True))
            return math.copysign(rest, a)
        case "MOD":
            # Exact: the sign of the left side first, then up by one divisor.
            rest = Fraction(a) % abs(Fraction(b))
            return float(rest) if rest == 0 or a >= 0 else math.fmod(a, b) + abs(b)
        case "AND" | "OR" | "XOR" if macro:
            i, j = int(_function("ROUND", a, True)), int(_function("ROUND", b, True))
            if max(abs(i), abs(j)) >= 1 << 62:  # a control has numbers of 32 bits
                raise NoValue
            return {"AND": i & j, "OR": i | j, "XOR": i ^ j}[name]
        case "AND" | "OR" | "XOR":
            return {
                "AND": bool(a) and bool(b),
                "OR": bool(a) or bool(b),
                "XOR": bool(a) is not bool(b),
            }[name]
    near = abs(a - b) < 1e-6 and not macro
    return {
        "EQ": a == b or near,
        "NE": a != b and not near,
        "GT": a > b,
        "GE": a >= b,
        "LT": a < b,
        "LE": a <= b,
    }[name]
