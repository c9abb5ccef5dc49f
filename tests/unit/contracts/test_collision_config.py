"""The cell table of the theatre file: strict, with defaults, and the how-to's example is valid."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from ronna_hw.collision_config import AROUND_THE_PATIENT, BodyFrame, CollisionConfig
from ronna_hw.config import BadTheatreFile, parse_theatre

HOW_TO = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "devices" / "describe-the-cell.md"
BODY = {"name": "stand", "start_mm": [0.0, 0.0, 0.0], "end_mm": [0.0, 0.0, 9.0], "radius_mm": 5.0}


def _cell(**keys: Any) -> CollisionConfig:
    return parse_theatre({"theatre": "lab", "cell": keys}).cell


def test_the_defaults_apply_without_a_cell() -> None:
    cell = parse_theatre({"theatre": "lab"}).cell
    assert cell == CollisionConfig()
    assert cell.bodies == AROUND_THE_PATIENT
    assert cell.live_margin_mm < cell.margin_mm
    assert not any(body.enters_head for body in (*cell.guide, *cell.stereo_head))  # hands bring in what does


def test_the_example_in_the_how_to_is_a_valid_cell() -> None:
    example = re.search(r"```toml\n(.*?)```", HOW_TO.read_text(encoding="utf-8"), re.DOTALL)
    assert example is not None
    cell = parse_theatre({"theatre": "lab", **tomllib.loads(example[1])}).cell
    assert cell.bodies[0].frame is BodyFrame.ROBOT
    assert cell.guide[0].name == "tube of the guide"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"margin_mm": 3.0}, "live_margin_mm must be less than margin_mm"),
        ({"zone": {"near_mm": 500.0}}, "far_mm must exceed near_mm"),
        ({"bodies": [{**BODY, "radius_mm": 0.0}]}, "cell.bodies 1.radius_mm"),
        ({"bodies": [{**BODY, "radius_mm": 0.03}]}, "radius_mm: give millimetres, not metres (found 0.03)"),
        ({"bodies": [{**BODY, "frame": "table"}]}, "'head' or 'robot'"),
        ({"bodies": [{**BODY, "colour": "red"}]}, "cell.bodies 1.colour"),
        ({"guide": [{**BODY, "end_mm": [0.0, 0.0]}]}, "cell.guide 1.end_mm"),
    ],
)
def test_a_mistake_is_reported_with_its_location(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(BadTheatreFile, match=re.escape(said)):
        _cell(**keys)
