"""A running case as a program beside it reads it, and the log that the case leaves."""

from __future__ import annotations

import asyncio
import json
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
import pydicom
import pytest
from mcap.reader import make_reader
from run_folders import records_of, run_folder
from undisturbed import MINI_SEED_3, finished_mini, undisturbed_mini
from user_commands import Commands
from waiting import HANG_LIMIT_S, eventually

from procedures.journal.results import FramedPose
from procedures.live.feed_reader import read_feed
from procedures.live.feed_socket import SOCKET_FILE
from procedures.live.flight_log import FIRST_FILE
from procedures.live.records import (
    Began,
    CameraPicture,
    DeviceStatus,
    Fiducials,
    FramePose,
    LiveRecord,
    PlannedLines,
    RunState,
)
from ronna_hw import load_run
from ronna_hw.frames import Frame, Transform

NUMBERS = 1e-9
SETTLED_RAD = 1e-4  # noise of the encoders


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out, printed = finished_mini(tmp_path_factory)
    return out / str(json.loads(printed)["run"])


def _payload_pose(run: Path, kind: str, field: str) -> Transform:
    (record,) = (one for one in records_of(run) if one.kind == kind)
    return FramedPose.model_validate(record.payload[field]).transform


def test_a_reader_sees_the_whole_case_and_changes_nothing_of_it(
    commands: Commands, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    undisturbed = undisturbed_mini(tmp_path_factory)
    process = commands.start("ronna-procedure", *MINI_SEED_3, "--out", str(tmp_path))
    eventually(lambda: (run := run_folder(tmp_path)) is not None and (run / SOCKET_FILE).exists())
    run = run_folder(tmp_path)
    assert run is not None

    async def read() -> list[LiveRecord]:
        return [record async for record in read_feed(run)]

    records = asyncio.run(asyncio.wait_for(read(), HANG_LIMIT_S))
    printed, _ = process.communicate(timeout=HANG_LIMIT_S)
    assert json.loads(printed)["targets"] == undisturbed["targets"]
    assert isinstance(records[0], Began)
    assert records[0].run == run.name
    of: dict[type, list[LiveRecord]] = defaultdict(list)
    for record in records:
        of[type(record)].append(record)
    states = [one for one in of[RunState] if isinstance(one, RunState)]
    assert (states[-1].state, states[-1].run) == ("finished", run.name)
    assert {one.device for one in of[DeviceStatus] if isinstance(one, DeviceStatus)} >= {
        "tracker",
        "arm",
        "stereo",
    }
    assert {one.side for one in of[CameraPicture] if isinstance(one, CameraPicture)} == {"left", "right"}
    (plan, *_), (*_, spheres) = of[PlannedLines], of[Fiducials]
    assert isinstance(plan, PlannedLines)
    assert [line.name for line in plan.lines] == ["T1"]
    assert isinstance(spheres, Fiducials)
    assert all(
        one.is_used and one.residual_mm is not None and one.residual_mm < 1.0 for one in spheres.spheres
    )
    poses = [one for one in of[FramePose] if isinstance(one, FramePose)]
    latest = {one.about: one for one in poses}
    registered = _payload_pose(run, "registration", "robot_from_ct").inverse()
    robot = latest["robot in ct"]
    assert robot.translation_mm == pytest.approx(registered.translation_mm, abs=NUMBERS)
    assert robot.rotation == pytest.approx(registered.quaternion_wxyz, abs=NUMBERS)
    tracker = _payload_pose(run, "global_localization", "robot_from_tracker")
    assert latest["tracker in robot"].translation_mm == pytest.approx(tracker.translation_mm, abs=NUMBERS)
    assert {"flange in robot", "tool in flange", "robot_frame in tracker"} <= set(latest)
    assert not (run / SOCKET_FILE).exists()
    verified = commands.run("ronna-procedure", "verify", str(run))
    assert verified.returncode == 0, verified.stdout


def test_the_log_shows_the_frames_of_the_records_and_every_cycle_of_the_arm(finished: Path) -> None:
    run = load_run(finished)
    fixed = run.stream("/tf_static")
    robot = fixed[(fixed.parent == Frame.CT) & (fixed.child == Frame.ROBOT)]
    registered = _payload_pose(finished, "registration", "robot_from_ct").inverse()
    np.testing.assert_allclose(robot.position_mm[-1], registered.translation_mm, atol=1e-6)
    np.testing.assert_allclose(robot.rotation_wxyz[-1], registered.quaternion_wxyz, atol=1e-9)
    joints, commanded = run.stream("/measured_js"), run.stream("/setpoint_js")
    assert (np.diff(joints.time_s) >= 0.0).all()
    assert len(commanded) > 1000
    parents = defaultdict(set)
    for row in (*fixed, *run.stream("/tf")):
        parents[row.child].add(row.parent)
    assert all(len(of_one) == 1 for of_one in parents.values()), parents
    (looked,) = (one for one in records_of(finished) if one.kind == "relocalization")
    for at_look_rad in looked.payload["joints_rad"]:
        assert np.abs(joints.joints_rad - at_look_rad).max(axis=1).min() < SETTLED_RAD


@pytest.mark.hazard(35)
def test_the_log_has_neither_the_name_nor_the_number_of_the_patient(finished: Path) -> None:
    header = pydicom.dcmread(next(finished.rglob("*.dcm")), stop_before_pixels=True)
    with (finished / FIRST_FILE).open("rb") as file:
        messages = [(c.topic, m.data) for _, c, m in make_reader(file, validate_crcs=True).iter_messages()]
    text = b" ".join(data for topic, data in messages if "image" not in topic).decode(errors="replace")
    assert "registration:1" in text
    for secret in (header.PatientName.family_name, header.PatientID):
        assert not re.search(rf"(?<![\w-]){re.escape(str(secret))}\b", text)
