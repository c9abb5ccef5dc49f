"""Faults of a Universal Robots arm in the doctor's words: code or condition, reason and action."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from handmade_ur import HandmadeController
from user_commands import in_this_process

from procedures.cli.procedure import app
from ronna_hw.errors import EXIT_NOT_FOUND

NOWHERE = "tcp://127.0.0.1:1"
FILE = """
schema = 1
theatre = "bench"

[clock]
endpoint = "host:"

[robot.master]
driver = "universal_robots"

[robot.master.endpoints]
{endpoints}

[robot.master.options]
{options}
"""


@pytest.fixture
def controller() -> Iterator[HandmadeController]:
    made = HandmadeController()
    yield made
    made.close()


def doctor(controller: HandmadeController, folder: Path, options: str) -> str:
    """Return what the doctor says about an arm that is not ready, on one line."""
    endpoints = "\n".join(f'{role} = "{address}"' for role, address in controller.endpoints.items())
    file = folder / "bench.toml"
    file.write_text(FILE.format(endpoints=endpoints, options=options))
    done = in_this_process(app, "doctor", "--config", file)
    assert done.returncode == EXIT_NOT_FOUND
    return " ".join((done.stdout + done.stderr).split())


@pytest.mark.parametrize(
    ("change", "options", "says", "advises"),
    [
        pytest.param({}, 'model = "ur5"', "URD-003", "the options model and serial", id="model"),
        pytest.param({"endpoints": NOWHERE}, "", "URD-002", f"Nothing listens at {NOWHERE}", id="address"),
        pytest.param(
            {"is in remote control": "false"}, "", "local", "Choose remote control", id="local mode",
            marks=pytest.mark.hazard(55),
        ),
        pytest.param(
            {"safety_mode": 7}, "", "pressed", "Release the emergency stop", id="emergency stop"
        ),
        pytest.param(
            {"IN_USE": True}, "", "URD-012", "End the other client", id="registers",
            marks=pytest.mark.hazard(54),
        ),
        pytest.param(
            {}, 'calibration = "0123456789abcdef"', "URD-005", "Check that this is the arm", id="calibration"
        ),
    ],
)  # fmt: skip
def test_the_doctor_says_what_is_wrong_and_what_to_do(
    controller: HandmadeController,
    tmp_path: Path,
    change: dict[str, Any],
    options: str,
    says: str,
    advises: str,
) -> None:
    for name, value in change.items():
        if name == "endpoints":
            controller.endpoints["dashboard"] = value
        elif name == "safety_mode":
            controller.safety_mode = value
        elif name == "IN_USE":
            controller.input_types = controller.input_types.replace("DOUBLE", "IN_USE")
        else:
            controller.answers[name] = value
    said = doctor(controller, tmp_path, options)
    assert says in said
    assert advises in said
