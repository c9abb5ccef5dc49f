"""The doctor's verdicts on serial numbers, and on a device of a kind that it does not know."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from force_sensor import DECLARED, ScaledForceSensor, install
from recording_cell import RecordingArm, RecordingCell, theatre_of

from procedures.cli.doctor import inspection
from procedures.cli.doctor.inspection import ARM_RECORD, OF_THIS_ARM, advise_on_serials, two_arm_diagnostics
from procedures.cli.doctor.report import Report, examine, verdicts
from procedures.engine.order import order_of
from procedures.steps.clinical import set_up
from procedures.workcell.errors import AnotherArm
from ronna_hw.config import DeviceConfig, TheatreFile
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.devices.probing import Diagnostic
from sim.world.process import load_scene


def theatre(serial: str | None) -> TheatreFile:
    """With a record of the arm with that serial number."""
    file = theatre_of(load_scene("mini", seed=3, calibrated=True))
    assert file.calibration is not None
    assert file.calibration.arm is not None
    arm = file.calibration.arm.model_copy(update={"serial": serial})
    return file.model_copy(update={"calibration": file.calibration.model_copy(update={"arm": arm})})


@pytest.mark.parametrize(
    ("recorded", "reported", "well", "advised"),
    [("A1", "A1", True, False), ("A1", "A2", False, True), ("A1", "", True, True), (None, "A1", True, True)],
)
def test_the_doctor_compares_serial_numbers_of_the_arm_or_says_that_there_are_none(
    monkeypatch: pytest.MonkeyPatch, recorded: str | None, reported: str, well: bool, advised: bool
) -> None:
    monkeypatch.setattr(inspection, "RobotArm", RecordingArm)
    monkeypatch.setattr(inspection, "require_interface", lambda *_: None)
    inspect = inspection.inspection("robot.master", theatre(recorded))
    arm: Any = RecordingArm("robot.master")
    found = {one.subject: one for one in inspect(arm, Identity("Lab", "A", reported, "1"))}
    of_arm = found["robot.master: calibration of the arm"]
    assert of_arm.well is well
    assert bool(of_arm.advice) is advised
    assert (of_arm.advice == OF_THIS_ARM) is (advised and well)
    assert ("CAL-013" in of_arm.seen) is not well


def test_a_case_is_refused_with_the_record_of_another_arm_of_the_model(tmp_path: Path) -> None:
    other = RecordingCell(tmp_path, theatre=theatre("2"))
    with pytest.raises(AnotherArm, match="CAL-013"):
        other.engine(order_of([set_up.STEP], ())).run_to()


HEAD = cast("Any", SimpleNamespace(left=SimpleNamespace(serial="4411"), right=SimpleNamespace(serial="4412")))
LEFT, RIGHT = "gev://127.0.0.1", "gev://127.0.0.2"
ELSEWHERE = "gev://127.0.0.9"
DRIVERS = "what the driver advises"
PAIRS_OWN = "what the driver advises for the pair"


def cameras(left_serial: str) -> DeviceConfig:
    return DeviceConfig(
        driver="basler_stereo",
        endpoints={"left": LEFT, "right": RIGHT},
        options={"left_serial": left_serial, "right_serial": "4412"},
    )


def _advised(
    found: str | None,
    configured: str,
    *others: str,
    subject: str = f"camera {LEFT}",
    pair_repeats: bool = True,
    probed: bool = True,
) -> str:
    """The advice for a left camera that replied with that number, or for the pair unless `probed`."""
    on_network = {RIGHT: "4412", **dict.fromkeys([ELSEWHERE] if others else [], *others)}
    findings = (
        Diagnostic("cameras on eth0", True, "the cameras there", serials=on_network),
        Diagnostic(subject, not probed, "refused", DRIVERS, serials={LEFT: found}),
        Diagnostic(f"camera {RIGHT}", True, "4412", serials={RIGHT: "4412"}),
        Diagnostic("device stereo", False, "refused", DRIVERS if pair_repeats else PAIRS_OWN),
    )
    network, left, right, pair = advise_on_serials(findings, cameras(configured), HEAD)
    assert (network, right) == (findings[0], findings[2])
    assert pair.advice == (left.advice if pair_repeats and probed else pair.advice)
    return left.advice if probed else pair.advice


@pytest.mark.hazard(26)
def test_a_silent_camera_is_not_found_and_the_serial_numbers_found_are_named() -> None:
    said = _advised(None, "4411")
    assert said == f"The left camera 4411 was not found (serial numbers found: 4412). {DRIVERS}"


@pytest.mark.hazard(26)
@pytest.mark.parametrize("typed", ["4417", "4141", "411", "44111", "9911", "1144"])
def test_only_a_typing_error_in_the_number_of_the_calibrated_camera_is_called_one(typed: str) -> None:
    said = _advised("4411", typed)
    if typed in ("9911", "1144"):
        assert said.startswith(f'left_serial = "{typed}" was not found (serial numbers found: 4411, 4412)')
        assert "mistyped" not in said
    else:
        assert said.startswith(f'left_serial = "{typed}" is probably mistyped: camera 4411 replied')
        assert "Correct it in the theatre file" in said


@pytest.mark.hazard(26)
def test_a_configured_camera_that_was_not_calibrated_was_exchanged_and_its_number_is_right() -> None:
    said = _advised("4417", "4417", subject="stereo: calibration of the left camera")
    assert said == (
        "The left camera was exchanged: 4417 replied, the calibration record is of 4411, which was not "
        "found. Mount 4411 again, or calibrate the head with 4417."
    )


def test_the_calibrated_camera_is_said_to_be_found_only_where_it_replied() -> None:
    assert f"of 4411, which replied at {ELSEWHERE}." in _advised("4417", "4417", "4411")


@pytest.mark.parametrize("configured", ["4411", "4410"])
def test_a_camera_that_neither_options_nor_records_name_was_exchanged(configured: str) -> None:
    said = _advised("4499", configured)
    assert said.startswith("The left camera was exchanged: 4499 replied")
    assert said.endswith('calibrate the head with 4499 and set left_serial = "4499".')


def test_where_the_configured_camera_is_at_another_address_the_driver_says_so() -> None:
    assert _advised("4499", "4411", "4411") == DRIVERS
    assert _advised("4412", "4411") == DRIVERS  # the right one: swapped


def test_a_camera_that_replied_elsewhere_is_told_once_with_the_endpoint_to_correct() -> None:
    network = Diagnostic("cameras on eth0", True, "", serials={ELSEWHERE: "4411", RIGHT: "4412"})
    left = Diagnostic(f"camera {LEFT}", False, "silent", DRIVERS, serials={LEFT: None})
    pair = Diagnostic("device stereo", False, "GEV-001", DRIVERS)
    _, camera, refused = advise_on_serials((network, left, pair), cameras("4411"), HEAD)
    assert camera.advice == (
        "4411 is at 127.0.0.9, not at 127.0.0.1: correct the endpoint stereo.endpoints.left."
    )
    assert (camera.explained, refused.explained) == (False, True)


def test_a_serial_number_given_to_both_cameras_is_named_and_not_called_swapped() -> None:
    right = Diagnostic(f"camera {RIGHT}", False, "4412", DRIVERS, serials={RIGHT: "4412"})
    left = Diagnostic(f"camera {LEFT}", True, "4411", serials={LEFT: "4411"})
    file = cameras("4411")
    file = file.model_copy(update={"options": {"left_serial": "4411", "right_serial": "4411"}})
    _, camera = advise_on_serials((left, right), file, HEAD)
    assert camera.advice == (
        'left_serial and right_serial are both "4411": two cameras have two serial numbers. '
        'Set right_serial = "4412", as in the calibration record.'
    )


def test_an_address_given_to_both_cameras_is_named_and_not_called_swapped() -> None:
    network = Diagnostic("cameras on eth0", True, "", serials={LEFT: "4411", RIGHT: "4412"})
    both = Diagnostic(f"camera {LEFT}", False, "4411", DRIVERS, serials={LEFT: "4411"})
    file = cameras("4411").model_copy(update={"endpoints": {"left": LEFT, "right": LEFT}})
    _, camera = advise_on_serials((network, both), file, HEAD)
    assert camera.advice == (
        f"stereo.endpoints.left and right are both {LEFT}: two cameras need two addresses. "
        f'Set stereo.endpoints.right to "{RIGHT}", camera 4412.'
    )


def test_with_another_cell_on_the_network_no_endpoint_is_called_wrong() -> None:
    replied = {ELSEWHERE: "4411", "gev://127.0.0.8": "4412", RIGHT: "4412"}
    network = Diagnostic("cameras on eth0", True, "", serials=replied)
    left = Diagnostic(f"camera {LEFT}", False, "silent", DRIVERS, serials={LEFT: None})
    _, camera = advise_on_serials((network, left), cameras("4411"), HEAD)
    assert camera.advice.startswith("The left camera 4411 was not found")


def test_swapped_cameras_are_told_once_by_the_pair() -> None:
    left = Diagnostic(f"camera {LEFT}", False, "4412", DRIVERS, serials={LEFT: "4412"})
    right = Diagnostic(f"camera {RIGHT}", False, "4411", "", serials={RIGHT: "4411"})
    pair = Diagnostic("device stereo", False, "GEV-004", DRIVERS)
    *both, refused = advise_on_serials((left, right, pair), cameras("4411"), HEAD)
    assert all(camera.explained for camera in both)
    assert not refused.explained
    assert "stereo.endpoints.left and stereo.endpoints.right" in refused.advice
    shown = Report((), (*both, refused), verdicts=tuple(verdicts((), {"stereo": (*both, refused)})))
    assert shown.problems == (refused,)
    assert shown.verdicts[0].because == ("device stereo: GEV-004",)


def test_a_pair_that_is_refused_as_a_whole_gets_the_verdict_on_its_camera() -> None:
    assert "probably mistyped" in _advised("4411", "4417", pair_repeats=False, probed=False)


def test_a_pair_refused_for_a_reason_of_its_own_keeps_its_advice() -> None:
    left = Diagnostic(f"camera {LEFT}", False, "4411", DRIVERS, serials={LEFT: "4411"})
    right = Diagnostic(f"camera {RIGHT}", False, "taken", "Stop that program.", serials={RIGHT: "4412"})
    pair = Diagnostic("device stereo", False, "refused", PAIRS_OWN)
    _, same, also = advise_on_serials((left, right, pair), cameras("4417"), HEAD)
    assert (same, also) == (right, pair)


@pytest.mark.parametrize(("assistant", "well"), [("601234", False), ("601235", True)])
def test_the_doctor_says_that_one_arm_has_both_roles(assistant: str, well: bool) -> None:
    serials = {"robot.master": "601234", "robot.assistant": assistant}
    found = {
        name: [Diagnostic(f"{name}: {ARM_RECORD}", True, "", serials={"KR 6": serial})]
        for name, serial in serials.items()
    }
    (one,) = two_arm_diagnostics(found)
    assert one.well is well
    assert ("DUAL-004" in one.seen) is not well
    assert not list(two_arm_diagnostics({"robot.master": found["robot.master"]}))


@pytest.mark.parametrize("plugged_in", [True, False])
def test_the_doctor_shows_a_device_of_an_unknown_kind(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, plugged_in: bool
) -> None:
    install(monkeypatch)
    monkeypatch.setattr(ScaledForceSensor, "plugged_in", plugged_in)
    path = tmp_path / "theatre.toml"
    path.write_text(f'theatre = "lab"\n{DECLARED}')
    (diagnostic,) = examine(path).devices
    assert (diagnostic.subject, diagnostic.well) == ("device device.force", plugged_in)
    assert ("F1 7 1.0" in diagnostic.seen) is plugged_in


def test_a_driver_that_is_not_of_the_kind_of_its_table_is_a_problem_that_names_what_it_lacks(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    install(monkeypatch)
    path = tmp_path / "theatre.toml"
    path.write_text(f'theatre = "lab"\n{DECLARED.replace("device.force", "tracker")}')
    report = examine(path)
    (verdict,) = (one for one in report.verdicts if one.of == "tracker")
    (cause,) = verdict.because
    assert "DEV-008 tracker: driver force does not provide OpticalTracker: it lacks markers_mm" in cause
