"""The page on the way from the wire to the report: one sphere's bytes, reading, record and number."""

from __future__ import annotations

import json
import re
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from traceback import walk_stack
from types import FrameType
from typing import Any

import numpy as np
import pytest
from clinical_case import CENTRES_CT_MM, FIRST, SCENE, SPHERES_MM, ClinicalCell
from painted_ct import FRAME_UID, SERIES_UID, Scan, write_series
from passing_clock import PassingClock
from polaris_unit_in_process import UnitInProcess, tracker_on
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_set_up,
    coarse,
    localized_fiducials,
    relocalization,
)
from pydantic import TypeAdapter
from pydicom import dcmread
from recording_cell import mini_theatre_file
from report_text import report_text

from procedures.exchange.dicom_objects import Origin, sphere_fiducials, write
from procedures.imaging import localize, read_series
from procedures.reporting.report import write_report
from procedures.runs.engine_setup import add_guards
from procedures.steps.clinical import correspondence, global_localization, registration
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.relocalization import STEP as RELOCALIZATION
from procedures.workcell import MountedTool
from procedures.workcell.motions import PlannedMotion
from procedures.workcell.supervised_motion import SupervisedMotion
from procedures.workcell.tracker_look import FRAMES, robot_from_marker
from ronna_hw.arrays import Array
from ronna_hw.config import read_theatre_file
from ronna_hw.devices.capabilities import Direction, PassedBytes
from ronna_hw.devices.readings import ArmReading
from ronna_hw.devices.robot import Motion
from ronna_hw.frames import Frame
from ronna_hw.recording.reading_tape import READINGS_FILE, READINGS_FOLDER, ReadingTape, tape_device

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "explanation" / "from-wire-to-report.md"
TRACKER = SCENE.tracker.robot_from_tracker.transform(Frame.ROBOT, Frame.TRACKER)
SPHERE = 1  # whose number is followed
LAYER = re.compile(rf"{ROOT}/(drivers|ronna_hw|procedures/\w+)/")
BX_BEGINS = b"\xc4\xa5"
# Of these links of the page nothing runs here: the unit is in this process, and an interface has no code.
NOT_RUN = {"drivers/ndi_polaris/transport.py", "ronna_hw/devices/sensors.py"}


class UnitInRoom(UnitInProcess):
    """Sees the frame on the arm where it is."""

    def __init__(self, frame: Sequence[float]) -> None:
        super().__init__()
        self._frame = tuple(frame)
        self.asked_by: set[tuple[str, ...]] = set()

    def pose_of(self, handle: int) -> tuple[float, ...]:
        self.asked_by.add(layers_on_stack())
        return (*self._frame, 0.1)


class Wire:
    """Keeps every BX reply as it came."""

    def __init__(self) -> None:
        self.replies: list[bytes] = []

    def on_bytes(self, link: str, direction: Direction, data: bytes) -> None:
        if direction is Direction.RECEIVED and data.startswith(BX_BEGINS):
            self.replies.append(data)

    def on_earlier_bytes(self, link: str, all_passed: Sequence[PassedBytes]) -> None:
        raise AssertionError(f"{link} has a process of its own")

    def note(self, link: str, **facts: str | float) -> None:
        pass


def strays_in(reply: bytes) -> Array:
    """Decoded as the protocol's reference says, for one tool that is seen."""
    after_tool = 6 + 1 + 2 + 8 * 4 + 8 + 11
    count = reply[after_tool]
    numbers = struct.unpack_from(f"<{3 * count}f", reply, after_tool + 1 + (count + 7) // 8)
    return np.array(numbers).reshape(-1, 3)


@contextmanager
def modules_run() -> Iterator[set[str]]:
    """Files of the project of which code runs within the block."""
    found: set[str] = set()

    def note(frame: FrameType, _event: str, _argument: object) -> None:
        found.add(frame.f_code.co_filename)

    sys.setprofile(note)
    try:
        yield found
    finally:
        sys.setprofile(None)
        inside = {Path(name) for name in found if name.startswith(str(ROOT))}
        found |= {str(path.relative_to(ROOT)) for path in inside}


def modules_of(walk: str) -> list[str]:
    """Modules that the page names on a walk, in order; an interface is no hop."""
    text = PAGE.read_text(encoding="utf-8").split(f"## {walk}")[1].split("\n## ")[0]
    links = re.findall(r"\(\.\./\.\./([\w/]+\.py)\)", text)
    if walk == "A pose of the tracker":  # its end is that of an image
        image = modules_of("An image")
        links += image[image.index("procedures/engine/engine.py") :]
    return [path for path in dict.fromkeys(links) if not path.startswith(("ronna_hw/devices/", "tests/"))]


def links() -> set[str]:
    """Modules on the tracker's way, and from the registration on those on the image's, which it joins."""
    text = PAGE.read_text(encoding="utf-8")
    of_image, of_tracker = (
        text.split(f"## {title}")[1].split("\n## ")[0] for title in ("An image", "A pose")
    )
    shared = of_image[of_image.index("| [registration]") :]
    return {str(path) for path in re.findall(r"\(\.\./\.\./([\w/]+\.py)\)", of_tracker + shared)}


def layers_on_stack() -> tuple[str, ...]:
    """Of the code that led here, the nearest first."""
    files = (LAYER.match(frame.f_code.co_filename) for frame, _ in walk_stack(None))
    return tuple(layer for layer, _ in groupby(file[1] for file in files if file))


def layers_of(walk: str) -> tuple[str, ...]:
    """As the page has them, each once."""
    text = PAGE.read_text(encoding="utf-8").split(f"## {walk}")[1].split("\n## ")[0]
    rows = re.findall(r"^\| \*?\[[^]]*\]\(\.\./\.\./(drivers|ronna_hw|procedures/\w+)/", text, re.MULTILINE)
    layers = tuple(layer for layer, _ in groupby(rows))
    assert len(layers) == len(set(layers)) > 3
    return layers


def above_workcell(files: set[str]) -> set[str]:
    """Their rooms that no module of the workcell imports."""
    own = ROOT / "procedures" / "workcell"
    imports = re.compile(r"^ *from procedures\.(\w+)", re.MULTILINE)
    known = {room for path in own.glob("*.py") for room in imports.findall(path.read_text(encoding="utf-8"))}
    rooms = {file.split("/")[1] for file in files if file.startswith("procedures/")}
    return rooms - known - {own.name}


def test_a_motion_goes_down_by_the_layers_of_the_page_and_asks_upwards_only_where_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = ClinicalCell(tmp_path).carrying(MountedTool.STEREO_HEAD)
    cell.clock = PassingClock()
    cell.series.mkdir()
    cell.plan.touch()
    before = (checked_paths(cell), *coarse(), checked_plan(), localized_fiducials())
    engine = cell.begin(*before, RELOCALIZATION)
    file = mini_theatre_file(tmp_path, simulated=True)
    add_guards(engine, file, read_theatre_file(file))
    led_here: set[tuple[str, ...]] = set()
    ran: set[str] = set()
    move, carry_out = cell.arm.move, SupervisedMotion.carry_out

    def moved(motion: Motion, **more: Any) -> ArmReading:
        led_here.add(layers_on_stack())
        return move(motion, **more)

    def carried_out(self: SupervisedMotion, motion: PlannedMotion) -> ArmReading:
        with modules_run() as run:
            reading = carry_out(self, motion)
        ran.update(run)
        return reading

    monkeypatch.setattr(cell.arm, "move", moved)
    monkeypatch.setattr(SupervisedMotion, "carry_out", carried_out)
    engine.run_to()
    *above, interface, below = layers_of("A motion")
    assert (interface, below) == ("ronna_hw", "drivers")  # of which a recording arm has neither
    assert led_here == {(*reversed(above), "procedures/engine")}
    asked = PAGE.read_text(encoding="utf-8").split("asks upwards")[1].split("\n\n")[0]
    linked = set(re.findall(r"\(\.\./\.\./(procedures/[\w/]+\.py)\)", asked))
    assert linked <= ran
    assert above_workcell(linked) == above_workcell(ran)


def numbers_of(report: str, sphere: int) -> str:
    """What the page says of a sphere: its distance from the tracker's point, mm."""
    found = re.search(
        rf"<tr><td>{sphere + 1}</td><td>[\d.]+</td><td>([\d.]+)</td>(<td>[\d.]+</td>){{2}}<td>yes</td>",
        report,
    )
    assert found
    return found[1]


def place_in(report: str, sphere: int) -> str:
    """What the page says of a sphere: where the tracker measured it, mm."""
    table = report.partition("Spheres in the CT")[2].partition("</table>")[0]
    found = re.search(rf'<tr><td>{sphere + 1}</td>.*<td class="point">([-\d. ]+)</td></tr>', table)
    assert found
    return found[1]


def test_the_way_of_an_image_crosses_no_layer_twice() -> None:
    assert layers_of("An image")


@pytest.mark.parametrize("aside_mm", [0.0, 0.4])
def test_a_number_of_the_report_is_that_of_the_trackers_bytes(tmp_path: Path, aside_mm: float) -> None:
    cell = ClinicalCell(tmp_path).carrying(MountedTool.STEREO_HEAD)
    frame = TRACKER.inverse() @ robot_from_marker(cell.workcell, cell.arm.joints_rad)
    unit, wire = UnitInRoom((*frame.quaternion_wxyz, *frame.translation_mm)), Wire()
    seen_mm = TRACKER.inverse().apply(SPHERES_MM)
    seen_mm[SPHERE] += (aside_mm, 0.0, 0.0)
    unit.strays = [(x, y, z) for x, y, z in seen_mm.tolist()]
    driver: Any = tracker_on(unit, cell.clock, "serial:///dev/null")
    driver.record_bytes(wire)
    tape = ReadingTape(tmp_path / READINGS_FOLDER, lambda: 0.0, {})
    cell.opened.replace_tracker(tape_device(driver, tape))
    tape.begin(0)
    before = (localized_fiducials(), checked_plan(), checked_set_up(cell))
    looked = (relocalization(), checked_paths(cell))
    engine = cell.begin(*before, global_localization.STEP, correspondence.STEP, *looked, registration.STEP)
    with modules_run() as run:
        driver.connect()
        driver.configure()
        engine.run_to(engine.order.find(f"registration:{FIRST}"))
        engine.close("left")
        report = report_text(write_report(tmp_path))
    tape.close()
    assert links() - NOT_RUN <= run
    assert unit.asked_by == {(*layers_of("A pose"), "procedures/engine")}

    on_wire_mm = strays_in(wire.replies[-1])[SPHERE]
    assert on_wire_mm == pytest.approx(seen_mm[SPHERE], abs=1e-4)  # single precision
    tape_lines = (tmp_path / READINGS_FOLDER / READINGS_FILE).read_text().splitlines()
    lines = [json.loads(line) for line in tape_lines if line]
    frames = [line["answer"] for line in lines if line.get("call") == "read_frame"]
    assert len(frames) == len(wire.replies) == FRAMES
    assert frames[-1]["strays"][SPHERE]["position_mm"] == on_wire_mm.tolist()
    record = cell.case.get(GlobalLocalization).record
    payload = json.loads((tmp_path / "records" / f"{record.identifier}.json").read_text())["payload"]
    away_mm = np.linalg.norm(np.array(payload["points_tracker_mm"]) - on_wire_mm, axis=1)
    place = int(away_mm.argmin())
    assert away_mm[place] < 1e-9
    localized, matched = cell.case.get(GlobalLocalization).result, cell.case.get(Correspondence).result
    in_room_mm = localized.robot_from_tracker.transform.apply(on_wire_mm)
    assert payload["points_robot_mm"][place] == pytest.approx(in_room_mm, abs=1e-9)
    from_ct_mm = matched.robot_from_ct.transform.apply(CENTRES_CT_MM[SPHERE])
    assert numbers_of(report, SPHERE) == f"{np.linalg.norm(from_ct_mm - in_room_mm):.3f}"
    assert (float(numbers_of(report, SPHERE)) > 0.05) is (aside_mm > 0.0)
    assert place_in(report, SPHERE) == " ".join(f"{value:.3f}" for value in on_wire_mm)


@pytest.mark.parametrize(
    ("walk", "most"), [("A motion", 18), ("A pose of the tracker", 14), ("A marker of the CT", 12)]
)
def test_a_walk_has_few_modules_and_each_of_them_exists(walk: str, most: int) -> None:
    modules = modules_of(walk)
    assert 5 < len(modules) <= most, modules
    assert [path for path in modules if not (ROOT / path).is_file()] == []


# These run on a whole run, in tests/unit/exchange/test_run_export.py; a model has no code.
OF_A_RUN = {
    "procedures/steps/clinical/fiducial_localization.py",
    "procedures/exchange/run_export.py",
    "procedures/exchange/allowed_fields.py",
}


def test_a_sphere_of_the_slices_is_that_of_the_dicom_item(tmp_path: Path) -> None:
    scan = Scan()
    scan.marker(np.array([20.0, 20.0, 20.0]), np.array([0.0, 0.0, 1.0]), skin=False)
    slices = write_series(tmp_path / "ct", scan.voxels(), origin_mm=(-20.0, -30.0, 40.0))
    with modules_run() as run:
        (marker,) = localize(read_series(slices), expected=1).markers
        kept = LocalizedFiducials.model_fields["markers"].annotation
        (read_back,) = TypeAdapter(kept).validate_json(TypeAdapter(kept).dump_json((marker,)))
        origin = Origin(SERIES_UID, FRAME_UID, datetime(2026, 11, 25, tzinfo=UTC), "a hash")
        file = write(sphere_fiducials({1: read_back}, origin), tmp_path / "spheres.dcm")
    assert set(modules_of("A marker of the CT")) - OF_A_RUN <= run
    (item,) = dcmread(file).FiducialSetSequence[0].FiducialSequence
    centre_mm = [float(value) for value in item.ContourData]
    assert centre_mm == pytest.approx(marker.centre_mm, abs=1e-9)
    assert centre_mm == pytest.approx((0.0, -10.0, 60.0), abs=0.2)
