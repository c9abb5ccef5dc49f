"""Our URScript carried out cycle by cycle: its text, translated to Python statement by statement.

Only what the script uses is known. Another function raises NameError, another statement SyntaxError.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from ronna_hw.wire.universal_robots import SCRIPT_NAME

FIRST_REGISTER = 24
_BLOCK = re.compile(r"(?:def|while|if|elif|else)\b")
_CYCLE = re.compile(r"(?:sync|servoj)\(")  # functions that last until the next cycle


def to_python(script: str) -> str:
    """Return Python in which each function that lasts until the next cycle is yielded."""
    lines: list[str] = []
    depth = 0
    for text in script.splitlines():
        statement = text.partition("#")[0].strip()
        if not statement:
            continue
        if statement == "end" or statement.startswith(("elif", "else")):
            depth -= 1
        if statement == "end":
            continue
        if _CYCLE.match(statement):
            statement = f"yield {statement}"
        opens = _BLOCK.match(statement) is not None
        lines.append("  " * depth + statement + (":" if opens and not statement.endswith(":") else ""))
        depth += opens
    if depth:
        raise SyntaxError("blocks and their ends are not balanced")
    return "\n".join(lines)


class RunningScript:
    """Script that runs on a controller which does nothing but hold the registers."""

    def __init__(self, script: str, target_rad: Sequence[float]) -> None:
        self.integers = [0, 0, 0]  # input registers, from the first one
        self.doubles = [0.0] * len(target_rad)
        self.outputs: dict[int, int] = {}
        self.goal = list(target_rad)  # of the last servoj
        functions = {
            "get_target_joint_positions": lambda: list(target_rad),
            "read_input_integer_register": lambda number: self.integers[number - FIRST_REGISTER],
            "read_input_float_register": lambda number: self.doubles[number - FIRST_REGISTER],
            "write_output_integer_register": self.outputs.__setitem__,
            "rtde_set_watchdog": lambda _input, _hz, _action: None,
            "norm": abs,
            "sync": lambda: None,
            "servoj": self._servo,
            "stopj": lambda _deceleration: None,
        }
        names: dict[str, Any] = {"__builtins__": {}, **functions}
        exec(to_python(script), names)
        self._cycles: Iterator[None] = names[SCRIPT_NAME]()

    def cycle(self) -> bool:
        """Run until the next cycle begins; returns whether the script goes on."""
        return next(self._cycles, self) is not self

    def _servo(self, goal: list[float], *_settings: float) -> None:
        self.goal = goal
