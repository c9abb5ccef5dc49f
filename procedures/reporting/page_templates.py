"""Templates of the pages about a case: one style, one set of number formats, no control characters."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from procedures.reporting import numbers
from ronna_hw.text import escape_controls, format_count

if TYPE_CHECKING:
    import jinja2


def load_template(name: str) -> jinja2.Template:
    """Return a template of the folder `template`."""
    return _environment().get_template(name)


def _without_controls(value: Any) -> Any:
    """Escape control characters in plain text. Markup declared safe is generated here and stays unchanged."""
    return "\n".join(map(escape_controls, value.split("\n"))) if type(value) is str else value


def _css_text(text: str) -> str:
    """Escape a text for a string in a style sheet, where entities do not count."""
    return "".join(one if one.isalnum() or one in " .-_" else f"\\{ord(one):06x}" for one in text)


@cache
def _environment() -> jinja2.Environment:
    import jinja2

    from procedures.reporting.compiled_templates import CompiledTemplates

    here = Path(__file__)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("procedures.reporting", "template"),
        bytecode_cache=CompiledTemplates(here.with_name("template"), here),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_without_controls,
    )
    environment.filters.update(
        count_of=format_count,
        css_text=_css_text,
        mm=numbers.millimetres,
        point=numbers.point,
        degrees=numbers.degrees,
        tenths=numbers.tenths,
        um=numbers.micrometres,
        s=numbers.seconds,
    )
    return environment
