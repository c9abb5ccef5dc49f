"""The known arms: an unknown one is refused before anything moves, and a package may bring its own."""

from __future__ import annotations

from importlib import metadata
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from arm_looks import ENDPOINTS
from packaged_arm import PackagedArm
from recording_cell import RecordingCell

from procedures.workcell.tools import calibrated_arm
from ronna_hw import registry
from ronna_hw.arm import catalogue
from ronna_hw.arm.catalogue import ArmChoice, find_arm, list_drivers
from ronna_hw.arm.errors import UnknownArm
from ronna_hw.config import BadTheatreFile, parse_theatre
from sim.theatre.theatre_file import theatre_content
from sim.world.process import load_scene
from sim.world.scene.arm_design import CHOSEN

KNOWN = "kr6_r900_2, kr6_r900_sixx, ur10e, ur16e, ur3e, ur5, ur5e"
FOREIGN = PackagedArm().name
UNKNOWN = f"there is no arm named '{FOREIGN}'; expected one of {KNOWN}"


@pytest.fixture
def arm_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "PackagedArm")


def install(monkeypatch: pytest.MonkeyPatch, made_by: str) -> None:
    point = EntryPoint(FOREIGN, f"packaged_arm:{made_by}", catalogue.GROUP)
    monkeypatch.setattr(metadata, "entry_points", lambda *, group: [point] * (group == catalogue.GROUP))


@pytest.mark.parametrize("name", KNOWN.split(", "))
def test_an_arm_is_found_by_its_name(name: str) -> None:
    assert find_arm(name).name == name


@pytest.mark.usefixtures("arm_installed")
def test_a_package_brings_an_arm_of_its_own_and_a_theatre_file_may_calibrate_it() -> None:
    assert isinstance(find_arm(FOREIGN).kinematics, PackagedArm)
    calibrations = parse_theatre(with_record_of(FOREIGN)).calibration
    assert calibrations is not None
    assert calibrated_arm(PackagedArm(), calibrations.arms).nominal.name == FOREIGN


@pytest.mark.usefixtures("arm_installed")
def test_an_arm_that_is_kinematics_alone_is_as_repeatable_as_the_least_one_and_tells_no_load() -> None:
    described = find_arm(FOREIGN)
    assert described.repeatability_mm == max(arm.repeatability_mm for arm in catalogue.ARMS.values())
    assert described.load is None


def test_a_package_may_describe_its_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "describe_packaged_arm")
    assert find_arm(FOREIGN).make == "Packager"
    assert find_arm(FOREIGN).repeatability_mm == 0.02


def test_each_arm_of_a_command_line_is_described_once_and_drawn_as_its_model() -> None:
    described = {arm.choice: arm.name for arm in catalogue.ARMS.values() if arm.choice}
    assert described == {choice: design.variant for choice, design in CHOSEN.items()}
    assert set(described) == set(catalogue.ArmChoice)


def with_record_of(arm: str) -> dict[str, Any]:
    content = theatre_content(load_scene("mini", seed=3, calibrated=True), ENDPOINTS, "host:", {}, 1.0)
    content["calibration"]["arm"]["arm"] = arm
    return content


def test_a_theatre_file_with_the_record_of_an_unknown_arm_is_refused_with_the_known_names() -> None:
    with pytest.raises(BadTheatreFile, match=f"arm: {UNKNOWN}"):
        parse_theatre(with_record_of(FOREIGN))


def test_a_driver_of_an_unknown_arm_is_refused_before_anything_is_connected(tmp_path: Path) -> None:
    cell = RecordingCell(tmp_path)
    cell.arm.kinematics = PackagedArm()
    with pytest.raises(UnknownArm, match=f"ARM-009: {UNKNOWN}"):
        cell.make_workcell()
    assert cell.arm.state == "disconnected"


def test_every_arm_of_a_command_line_has_a_registered_driver_of_its_make() -> None:
    assert list_drivers(["ur5e", "kr6", "ur5"]) == ("kuka_rsi", "universal_robots")
    assert set(list_drivers(tuple(ArmChoice))) <= set(registry.list_driver_names())
