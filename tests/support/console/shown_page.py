"""A page of the console without a browser."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable
from typing import Any

from nicegui import Client, ui


def on_a_page(do: Callable[[], Any]) -> Any:
    """Do it at once, or as a coroutine; returns what it returns."""

    async def page() -> Any:
        with Client(ui.page("/of-a-test"), request=None):
            done = do()
            return await done if inspect.isawaitable(done) else done

    return asyncio.run(page())
