"""The planner's images: cuts through the CT, and the surface of the head."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from console.pictures.cuts import WINDOWS_HU, Cut, cut_png
from console.planning.desk import PlanDesk

FARTHEST_MM = 10_000.0
LEAST_STEP_MM, MOST_STEP_MM = 0.001, 100.0
UNIT = 1e-3  # tolerance on the length of a direction, and on the right angle between two


def add_pictures(app: Any, desk: PlanDesk) -> None:
    """Serve the images of a plan's CT; no address reveals whose it is."""

    async def cut(request: Request) -> Response:
        try:
            wanted, window = _read(dict(request.query_params))
        except (KeyError, ValueError):
            return PlainTextResponse("No such picture.", 404)
        picture = await asyncio.to_thread(cut_png, desk.volume, wanted, window)
        return Response(picture, media_type="image/png")

    async def head(_request: Request) -> Response:
        return Response(desk.head, media_type="model/stl") if desk.head else PlainTextResponse("", 404)

    app.add_route("/cut.png", cut, methods=["GET"])
    app.add_route("/picture/head.stl", head, methods=["GET"])


def _read(given: dict[str, str]) -> tuple[Cut, tuple[float, float]]:
    """Raises KeyError, ValueError for an invalid request."""
    middle, right, down = (_three(given[name]) for name in "mrd")
    step_mm = float(given["s"])
    square = abs(right @ down) < UNIT and all(abs(np.linalg.norm(one) - 1.0) < UNIT for one in (right, down))
    if not (square and LEAST_STEP_MM <= step_mm <= MOST_STEP_MM and np.abs(middle).max() <= FARTHEST_MM):
        raise ValueError("no picture")
    return Cut(middle, right, down, step_mm), WINDOWS_HU[given["w"]]


def _three(words: str) -> Any:
    values = [float(one) for one in words.split(",")]
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError("expected three numbers")
    return np.array(values)
