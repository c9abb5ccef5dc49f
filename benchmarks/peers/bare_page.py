"""A bare page built with the console's page library: one element showing a number at 20 Hz.

Its argument is the number of the listening socket that it inherits.
"""

from __future__ import annotations

import sys
import time

from nicegui import ui

PERIOD_S = 0.05


@ui.page("/")
def page() -> None:
    place = ui.html("", sanitize=False)

    def show() -> None:
        place.set_content(f'<div id="clock" data-n="{time.time_ns() // 1000}"></div>')

    ui.timer(PERIOD_S, show)


ui.run(fd=int(sys.argv[1]), reload=False, show=False, tailwind=False)
