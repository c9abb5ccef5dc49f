"""The slider through a recorded case: each page has its own playback position."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from console.feed.recorded import RecordedCase
from console.feed.view import CaseView


class MomentPanel:
    """At the end of its range it follows the live case."""

    def __init__(self, recorded: RecordedCase, changed: Callable[[], None]) -> None:
        self._recorded = recorded
        self._changed = changed
        with ui.element("section").classes("moment card").props('aria-label="Playback position"'):
            self._back = self._button("◀", -1, "previous event")
            self._slider = ui.slider(min=0, max=len(recorded), value=len(recorded), step=1)
            self._slider.on_value_change(self._moved).props('aria-label="Playback position"').classes("slide")
            self._on = self._button("▶", +1, "next event")
            self._text = ui.label("").classes("num")

    def view(self, latest: CaseView) -> CaseView:
        """The view at the selected moment."""
        count, chosen = len(self._recorded), int(self._slider.value)
        if self._slider.props["max"] != count:
            at_end = chosen >= self._slider.props["max"]
            self._slider.props(f"max={count}")
            self._slider.props["max"] = count
            if at_end:
                self._slider.set_value(count)
                chosen = count
        goes_on = "" if self._recorded.over else ", running"
        self._text.set_text(f"{self._recorded.time_s(chosen):.1f} s, event {chosen} of {count}{goes_on}")
        return latest if chosen >= count else self._recorded.at(chosen)

    def _button(self, sign: str, by: int, name: str) -> ui.button:
        def move() -> None:
            self._slider.set_value(min(max(int(self._slider.value) + by, 0), len(self._recorded)))

        return (
            ui.button(sign, on_click=move, color=None)
            .classes("plain")
            .props(f'unelevated aria-label="{name}"')
        )

    def _moved(self) -> None:
        self._changed()
