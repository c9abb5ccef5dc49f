"""A tracker that reports tools alone is refused where a plan's spheres are no tool of its own."""

from __future__ import annotations

from typing import Any

import pytest
from plus_server import TOOLS, make_tracker

from procedures.planning.plan_model import FiducialKind
from procedures.workcell.tracker_look import require_tracked_spheres
from ronna_hw.errors import RonnaError
from ronna_hw.x_frame import SPHERE_CENTRES_MM

ON_HEAD = {"name": "frame", "markers_mm": [list(centre) for centre in SPHERE_CENTRES_MM]}


def served(*tools: dict[str, Any]) -> Any:
    return make_tracker("igtl://127.0.0.1:1", tools=list(tools))


def test_the_x_shaped_frame_as_a_tool_is_enough() -> None:
    require_tracked_spheres(served(TOOLS[0], ON_HEAD), FiducialKind.XFRAME)


def test_a_head_without_spheres_needs_no_tool_for_them() -> None:
    require_tracked_spheres(served(TOOLS[0]), FiducialKind.SURFACE)


@pytest.mark.parametrize(
    ("tools", "kind", "words"),
    [
        ((TOOLS[0], ON_HEAD), FiducialKind.FREE, "spheres are of kind free"),
        ((TOOLS[0], ON_HEAD), FiducialKind.MIXED, "spheres are of kind mixed"),
        (TOOLS, FiducialKind.XFRAME, "none of them is the x-shaped frame"),
    ],
)
def test_spheres_that_no_tool_shows_are_refused(tools: Any, kind: FiducialKind, words: str) -> None:
    with pytest.raises(RonnaError, match=f"PLAN-034.*{words}"):
        require_tracked_spheres(served(*tools), kind)
