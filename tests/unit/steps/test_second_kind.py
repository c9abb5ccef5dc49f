"""A device of a kind that nothing in the tree knows, from the theatre file to record, replay and recovery."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from clinical_case import done_later
from force_sensor import DECLARED, UNSCALED_N, ScaledForceSensor, install
from prepared_results import mounted_guide
from recording_cell import (
    ENDPOINTS,
    GUIDE,
    RecordingArm,
    RecordingCell,
    RecordingStereo,
    RecordingTheatre,
    RecordingTracker,
)
from run_again import broken_off, opened_again

from drivers.basler_stereo.pair import BaslerStereoPair
from drivers.kuka_rsi.arm import KukaRsiArm
from drivers.ndi_polaris.driver import PolarisTracker
from procedures.cli.doctor.report import examine
from procedures.engine.engine import Engine
from procedures.engine.order import CaseOrder, order_of
from procedures.engine.replay.recorded_answers import read_answers, section_follower
from procedures.engine.replay.replay import ReplayedRecord, ReplayInput, ReplayVerdict, replay
from procedures.engine.setting import ClinicalInput
from procedures.journal.errors import StepRefused
from procedures.journal.journal import Entry, Journal
from procedures.runs.comparison import Comparison, compare_devices
from procedures.steps.clinical import set_up
from procedures.steps.clinical.set_up import CheckedSetUp
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig, TheatreFile, parse_theatre
from ronna_hw.devices.lifecycle import Device
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.recording.reading_tape import READINGS_FILE, READINGS_FOLDER, ReadingTape, tape_device
from ronna_hw.registry import make_device
from sim.theatre.theatre_file import theatre_content
from sim.world.scene.named_scenes import draw_scene

ROLE = "device.force"
SCALE = 0.2
FRAME = "robot_frame"


def with_sensor() -> TheatreFile:
    """The mini theatre with the table of the sensor."""
    content = theatre_content(draw_scene("mini", seed=3), ENDPOINTS, "host:", {FRAME: "robot_frame.rom"}, 1.0)
    del content["tools"]["guide"]["frame"]  # a replay makes the tracker, and no definition of it is at hand
    return parse_theatre({**content, **tomllib.loads(DECLARED.replace("2.0", str(SCALE)))})


class CaseWithSensor:
    """A case of set-up, tool change and the step of the page, with every device on the tape."""

    def __init__(self, folder: Path, step: ModuleType) -> None:
        self.cell = cell = RecordingCell(folder, theatre=with_sensor())
        self.tape = ReadingTape(folder / READINGS_FOLDER, lambda: 1.0, {"paced": True})
        (folder / "journal.jsonl").unlink()
        cell.journal = Journal(folder, section_follower(self.tape))
        cell.journal.write(Entry.OPENED, 0.0)
        cell.arm = RecordingArm("robot.master")
        others = (RecordingStereo("stereo", serials=cell.stereo.serials), RecordingTracker("tracker"))
        others[1].tools = cell.tracker.tools
        taped_ones = (self.on_tape(each) for each in (cell.arm, *others))
        cell.opened = RecordingTheatre(cell.theatre, *taped_ones, make=self.make)
        cell.workcell = cell.make_workcell()
        self.order: CaseOrder = order_of([set_up.STEP, done_later(mounted_guide()), step.STEP], ())
        self.result = step.UnloadedGuide
        file = cell.theatre
        setting = replace(cell.setting(), settings=file.procedure, surroundings=file.cell_with_tools)
        self.engine = Engine(self.order, cell.case, setting, cell.journal, recorders=(self.tape,))

    def on_tape(self, device: Any) -> Any:
        return tape_device(device, self.tape)

    def make(self, name: str, config: DeviceConfig, clock: Clock) -> Device:
        return tape_device(make_device(name, config, clock), self.tape)

    def replayed(self) -> list[ReplayedRecord]:
        cell = self.cell
        given = ReplayInput(self.order, ClinicalInput(cell.series, cell.plan, cell.strategy), cell.theatre)
        return list(replay(inspect_run(cell.folder), given, read_answers(cell.folder)))


@pytest.fixture
def case(tmp_path: Path, force_check: ModuleType, monkeypatch: pytest.MonkeyPatch) -> CaseWithSensor:
    install(
        monkeypatch,
        force=ScaledForceSensor,
        ndi_polaris=PolarisTracker,
        kuka_rsi=KukaRsiArm,
        basler_stereo=BaslerStereoPair,
    )
    return CaseWithSensor(tmp_path / "run", force_check)


def test_its_reading_is_in_the_record_of_a_step_and_its_identity_in_that_of_the_set_up(
    case: CaseWithSensor,
) -> None:
    case.engine.run_to()
    assert case.cell.case.get(case.result).result.force_N == SCALE * UNSCALED_N
    assert case.cell.case.get(CheckedSetUp).result.identities[ROLE].model == "F1"
    assert case.cell.workcell.devices[ROLE].state == "configured"


def test_a_case_does_not_begin_without_it(case: CaseWithSensor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ScaledForceSensor, "plugged_in", False)
    with pytest.raises(Exception, match="no reply"):
        case.engine.run_to()
    assert case.engine.machine.state == "held"
    with pytest.raises(StepRefused):
        case.engine.run_step(case.order.find("force_check"))


def test_a_replay_reads_it_from_the_tape(case: CaseWithSensor, monkeypatch: pytest.MonkeyPatch) -> None:
    case.engine.run_to()
    case.engine.close("done")
    monkeypatch.setattr(ScaledForceSensor, "read_force_N", None)  # the driver object is never asked
    assert {one.step: one.verdict for one in case.replayed()} == dict.fromkeys(
        ("set_up", "tool_change", "force_check"), ReplayVerdict.EQUAL
    )


def test_a_replay_shows_an_edited_reading_of_it(case: CaseWithSensor) -> None:
    case.engine.run_to()
    case.engine.close("done")
    path = case.cell.folder / READINGS_FOLDER / READINGS_FILE
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    (reading,) = (line for line in lines if line.get("call") == "read_force_N")
    assert (reading["device"], reading["answer"]) == (ROLE, SCALE * UNSCALED_N)
    reading["answer"] = 0.4
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert case.replayed()[-1].why == ("force_N: 0.30000000000000004 recorded, 0.4 computed",)


def another(case: CaseWithSensor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ScaledForceSensor, "serial", "8")


def removed(case: CaseWithSensor, monkeypatch: pytest.MonkeyPatch) -> None:
    case.cell.theatre = case.cell.theatre.model_copy(update={"device": {}})


@pytest.mark.parametrize(
    ("change", "different"),
    [
        (lambda _case, _patch: None, []),
        (another, [f"{ROLE}: recorded F1 7 with firmware 1.0, found F1 8 with firmware 1.0"]),
        (removed, [f"{ROLE}: recorded F1 7 with firmware 1.0, found none"]),
    ],
)
def test_a_resumed_run_reads_it_again_and_compares(
    case: CaseWithSensor,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[CaseWithSensor, pytest.MonkeyPatch], None],
    different: list[str],
) -> None:
    case.engine.run_to()
    case.tape.close()
    recorded = case.cell.case.get(CheckedSetUp).result
    change(case, monkeypatch)
    broken_off(case.cell)
    case.cell.arm.mounted = GUIDE
    again, engine, _left = opened_again(case.cell, case.order)
    again.arm.name, comparison = "arm", Comparison()
    identities = {
        **recorded.identities,
        "arm": recorded.identities["arm"].model_copy(update={"model": "a arm"}),
    }
    compare_devices(
        engine, recorded.model_copy(update={"identities": identities}), comparison, exchange_begun=False
    )
    assert [one for one in comparison.differences if one.startswith("device.")] == different
    assert (f"{ROLE} F1" in comparison.unchanged) is not different


def test_the_doctor_shows_it(case: CaseWithSensor, tmp_path: Path) -> None:
    path = tmp_path / "theatre.toml"
    path.write_text(f'theatre = "lab"\n{DECLARED}')
    assert [one.subject for one in examine(path).devices] == [f"device {ROLE}"]
