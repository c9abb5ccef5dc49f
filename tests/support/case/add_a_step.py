"""The step of the how-to page on adding a step, as the module that the page says to write."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

PAGE = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "extending" / "add-a-step.md"


def force_check() -> ModuleType:
    """The module of the page, outside the tree."""
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
    module = ModuleType("force_check")
    exec(compile(code, str(PAGE), "exec"), module.__dict__)
    return module
