"""Small planner controls: number fields and buttons.

A number is committed on Enter or on leaving its field; an invalid entry shows the reason next to it. Emptied,
the field shows the present value again.
"""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from ronna_hw.text import parse_typed_number


class NumberField:
    """Number field with the given number of decimals. `on_value` receives the entered value."""

    def __init__(self, label: str, name: str, on_value: Callable[[float], None], decimals: int = 1) -> None:
        self._on_value, self._decimals = on_value, decimals
        self._shown = ""
        self.name = name
        self.is_wrong = False  # the entry is no number: the field does not show the value
        self._field = (
            ui.input()
            .classes("number")
            .props(f'dense outlined hide-bottom-space autocomplete=off maxlength=20 prefix="{label}"')
            .props(f'inputmode=decimal data-field="{name}" aria-label="{name}"')
        )
        self._field.on("blur", self._commit)
        self._field.on("keydown.enter", self._commit)

    def show(self, value: float | None) -> None:
        """Show the present value. Text being typed stays unless the value changes otherwise."""
        words = "" if value is None else f"{value:.{self._decimals}f}"
        if words != self._shown:
            self._shown = words
            self._field.set_value(words)
            self._show_mistake("")

    def enable(self, enabled: bool) -> None:
        self._field.set_enabled(enabled)

    def _commit(self) -> None:
        words = str(self._field.value or "").strip()
        if words in ("", self._shown):
            self._field.set_value(self._shown)
            self._show_mistake("")
            return
        try:
            value = parse_typed_number(words)
        except ValueError as mistake:
            self._show_mistake(f"expected a number such as -12.5, got {mistake}")
            return
        if not self._decimals and not value.is_integer():
            self._show_mistake(f"expected a whole number, got {words}")
            return
        self._show_mistake("")
        self._shown = words
        self._on_value(value)
        self._field.update()  # the previous value may still be on its way, and would overwrite this one

    def _show_mistake(self, mistake: str) -> None:
        self.is_wrong = bool(mistake)
        self._field.props(remove="error error-message")
        if mistake:
            self._field.props("error").props(f'error-message="{mistake.replace(chr(34), chr(39))}"')
