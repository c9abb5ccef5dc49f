"""Evaluation of GenICam formulas: arithmetic on named values."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from lark import Lark, Token, Tree
from lark.exceptions import LarkError

from drivers.basler_stereo.errors import BAD_DESCRIPTION
from drivers.basler_stereo.features.description import LONGEST_SHOWN, Number

LONGEST_FORMULA = 4000  # characters; real ones have some hundred
MAX_DEPTH = 200  # nested operations
LARGEST_WHOLE = 1 << 64  # limit for intermediate results, as for registers
CACHED_FORMULAS = 64

_GRAMMAR = r"""
?start: choice
?choice: either | either "?" choice ":" choice -> choose
?either: both | either "||" both -> or_
?both: bits | both "&&" bits -> and_
?bits: flips | bits "|" flips -> bit_or
?flips: masks | flips "^" masks -> bit_xor
?masks: equal | masks "&" equal -> bit_and
?equal: order | equal ("="|"==") order -> eq | equal ("<>"|"!=") order -> ne
?order: shift | order "<" shift -> lt | order ">" shift -> gt
    | order "<=" shift -> le | order ">=" shift -> ge
?shift: sum | shift "<<" sum -> lshift | shift ">>" sum -> rshift
?sum: product | sum "+" product -> add | sum "-" product -> sub
?product: sign | product "*" sign -> mul | product "/" sign -> div | product "%" sign -> mod
?sign: power | "-" sign -> neg | "+" sign | "~" sign -> invert
?power: atom | atom "**" sign -> pow
?atom: NUMBER -> number | HEX -> hexadecimal | NAME "(" choice ")" -> call | NAME -> name | "(" choice ")"
HEX.2: /0[xX][0-9a-fA-F]+/
NUMBER: /(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?/
NAME: /[A-Za-z_][A-Za-z0-9_.]*/
%import common.WS
%ignore WS
"""

LARGEST_SHIFT = 64  # beyond this, a value is out of range or zero


def _divide(first: Number, second: Number) -> Number:
    """Divide exactly, rounding towards zero: a float holds only 53 of a register's 64 bits."""
    if not isinstance(first, int) or not isinstance(second, int):
        return math.trunc(first / second)
    quotient = abs(first) // abs(second)
    return quotient if (first < 0) == (second < 0) else -quotient


def _remainder(first: Number, second: Number) -> Number:
    """Return the remainder of truncating division, with the sign of the dividend."""
    if not isinstance(first, int) or not isinstance(second, int):
        return math.fmod(first, second)
    return first - second * int(_divide(first, second))


def _power(base: Number, exponent: Number) -> Number:
    """Raise to a power, exactly for integers; raises OverflowError for more than 64 bits."""
    if not isinstance(base, int) or not isinstance(exponent, int) or exponent < 0:
        return math.pow(base, exponent)
    if abs(base) > 1 and exponent * base.bit_length() > 2 * LARGEST_SHIFT:  # 2 has two bits
        raise OverflowError("a power of more than 64 bits")
    return int(base**exponent)


_BINARY: dict[str, Callable[[Any, Any], Number]] = {
    "bit_or": lambda a, b: int(a) | int(b),
    "bit_xor": lambda a, b: int(a) ^ int(b),
    "bit_and": lambda a, b: int(a) & int(b),
    "lshift": lambda a, b: int(a) << min(int(b), LARGEST_SHIFT),
    "rshift": lambda a, b: int(a) >> min(int(b), LARGEST_SHIFT),
    "eq": operator.eq,
    "ne": operator.ne,
    "lt": operator.lt,
    "gt": operator.gt,
    "le": operator.le,
    "ge": operator.ge,
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "mod": _remainder,
    "pow": _power,
    "or_": lambda a, b: int(bool(a) or bool(b)),
    "and_": lambda a, b: int(bool(a) and bool(b)),
}
_FUNCTIONS: dict[str, Callable[[Any], Number]] = {
    "ABS": abs,
    "NEG": operator.neg,
    "SGN": lambda value: (value > 0) - (value < 0),
    "TRUNC": math.trunc,
    "FLOOR": math.floor,
    "CEIL": math.ceil,
    "ROUND": lambda value: math.floor(value + 0.5),
    "SQRT": math.sqrt,
    "EXP": math.exp,
    "LN": math.log,
    "LG": math.log10,
}


def evaluate(formula: str, values: Mapping[str, Number], *, whole: bool) -> Number:
    """Evaluate a formula; `whole` selects integer arithmetic with truncating division.

    Raises GEV-009 for a formula that cannot be parsed, an unknown name, or an undefined result.
    """
    try:
        result = _evaluate(_parse(formula), values, whole, MAX_DEPTH)
    except (ArithmeticError, ValueError, TypeError) as error:
        raise BAD_DESCRIPTION(f"formula {formula[:LONGEST_SHOWN]!r} has no value: {error}") from error
    return int(result) if whole else float(result)


@lru_cache(maxsize=1)
def _parser() -> Lark:
    return Lark(_GRAMMAR, parser="lalr")


@lru_cache(maxsize=CACHED_FORMULAS)
def _parse(formula: str) -> Tree[Token] | Token:
    if len(formula) > LONGEST_FORMULA:
        raise BAD_DESCRIPTION("a formula is too long", limit=f"{LONGEST_FORMULA} characters")
    try:
        return _parser().parse(formula)
    except LarkError as error:
        raise BAD_DESCRIPTION(f"formula {formula[:LONGEST_SHOWN]!r} cannot be read") from error


def _evaluate(node: Tree[Token] | Token, values: Mapping[str, Number], whole: bool, depth: int) -> Number:
    assert isinstance(node, Tree), "every rule of the grammar makes a tree"
    if depth == 0:
        raise BAD_DESCRIPTION("a formula is nested too deep", limit=f"{MAX_DEPTH} levels")
    number = _evaluate_operation(node, values, whole, depth - 1)
    if isinstance(number, int) and abs(number) >= LARGEST_WHOLE:
        raise OverflowError("a number of more than 64 bits")
    if not math.isfinite(number):
        raise OverflowError("a number that is not finite")
    return number


def _evaluate_operation(node: Tree[Token], values: Mapping[str, Number], whole: bool, depth: int) -> Number:
    """Evaluate one operation without checking the magnitude of its value."""
    kind, parts = str(node.data), node.children
    if kind == "number":
        text = str(parts[0])
        return int(text) if text.isdigit() else float(text)
    if kind == "hexadecimal":
        return int(str(parts[0]), 16)
    if kind == "name":
        if str(parts[0]) not in values:
            raise BAD_DESCRIPTION(f"formula uses the unknown name {parts[0]}")
        return values[str(parts[0])]
    if kind == "call":
        if (function := _FUNCTIONS.get(str(parts[0]).upper())) is None:
            raise BAD_DESCRIPTION(f"formula uses the unknown function {parts[0]}")
        return function(_evaluate(parts[1], values, whole, depth))
    if kind == "choose":
        return _evaluate(parts[1 if _evaluate(parts[0], values, whole, depth) else 2], values, whole, depth)
    first = _evaluate(parts[0], values, whole, depth)
    if kind == "neg":
        return -first
    if kind == "invert":
        return ~int(first)
    second = _evaluate(parts[1], values, whole, depth)
    if kind == "div":
        return _divide(first, second) if whole else first / second
    return _BINARY[kind](first, second)
