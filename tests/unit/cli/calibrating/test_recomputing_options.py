"""With --from nothing is measured: options that say what to measure, and where, are refused."""

from __future__ import annotations

import pytest
import typer
from user_commands import in_this_process, one_error

from procedures.cli.arm.command import app as arm
from procedures.cli.calibrating.mount import app as mount
from procedures.cli.stereo.command import app as stereo

HEAD, ARM = (stereo, "calibrate"), (arm, "calibrate")
FRAME, TIP = (mount, "tracker-frame"), (mount, "tool-tip")


@pytest.mark.parametrize(
    ("command", "option"),
    [
        *((HEAD, one) for one in ("--ball 1 2 3", "--poses 61", "--visits 3")),
        *((ARM, one) for one in ("--looks 91", "--validation 25", "--calibrated", "--answers a.toml")),
        *((FRAME, one) for one in ("--scene mini", "--seed 1", "--calibration x", "--first-day")),
        *((TIP, one) for one in ("--readings 11", "--ball 1 2 3")),
    ],
)
def test_an_option_without_effect_on_recorded_measurements_is_named_and_refused(
    command: tuple[typer.Typer, str], option: str
) -> None:
    app, name = command
    done = in_this_process(app, name, "--from", "nowhere", "--days", "7", *option.split())
    assert done.returncode == 2
    (error, *_) = one_error(done.stderr)
    assert error.startswith(f"CLI-001: {option.split()[0]} and --from cannot be combined")
