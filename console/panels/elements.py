"""Elements of which all panels are built: HTML, cards, labelled groups and buttons."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui


def html(content: str = "") -> ui.html:
    """Add HTML as made by `console.panels.html`, which escapes all text."""
    return ui.html(content, sanitize=False)


def card(name: str, title: str, *, heading: bool = True) -> ui.element:
    """Add a section called `title`, with that as its heading; `name` is its CSS class."""
    section = ui.element("section").classes(f"card {name}").props(f'aria-label="{title}"')
    if heading:
        with section:
            html(f"<h2>{title}</h2>")
    return section


def group(name: str, label: str) -> ui.element:
    """Add a group of controls, which screen readers announce as `label`; `name` is its CSS class."""
    return ui.element("div").classes(name).props(f'role=group aria-label="{label}"')


def button(words: str, act: Callable[[], Any], name: str, kind: str = "plain") -> ui.button:
    """Add a button for what `name` says; `kind` is its CSS class."""
    added = ui.button(words, on_click=act, color=None).classes(kind)
    return added.props(f"no-caps unelevated data-do={name}")


def small_button(words: str, act: Callable[[], object], name: str = "") -> ui.button:
    """Add a small button to a row of a panel. Screen readers announce it as `name`, or by its words."""
    added = ui.button(words, on_click=act, color=None).classes("plain small").props("no-caps unelevated")
    return added.props(f'aria-label="{name}"') if name else added
