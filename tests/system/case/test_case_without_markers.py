"""Whole cases that register on the skin, by a scan over the wire: within the predicted error, or refused."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pydicom
import pytest
from pydicom.dataelem import RawDataElement
from pydicom.tag import Tag
from run_folders import records_of
from simulated_case import LIMIT_S, SimulatedCase

from procedures.journal.journal import Line
from ronna_hw.errors import EXIT_DONE
from sim.world.options import Carrier
from sim.world.scene.model import ExchangedHead, Scene
from sim.world.scene.named_scenes import draw_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
SEED = 7
OTHER_SEED = 107  # of the head of another patient
HALF_A_HEAD = 90  # slices of the mini scene's CT, from the feet up to the middle of the face
SCANNING = "since step == surface_scan"


@pytest.mark.parametrize(
    ("options", "spheres"),
    [
        (("surface",), 0),
        (("surface", "--start", "scan"), 0),
        (("mixed", "--markers", "1", "--strategy", "jdms"), 1),
    ],
)
def test_a_case_on_the_skin_reaches_its_target_within_its_predicted_error(
    case: SimulatedCase, options: tuple[str, ...], spheres: int
) -> None:
    ran = case.run("--scene", "mini", "--seed", str(SEED), "--fiducials", *options)
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    records = {record.kind: record.payload for record in records_of(case.run_folder)}
    (predicted,) = records["surface_registration"]["predictions"]
    assert outcome["max_application_error_mm"] < predicted["limit_mm"]
    assert len(records["skin_in_ct"]["markers"]) == records["surface_registration"]["pairs"] == spheres
    assert "Registration on the skin" in (case.run_folder / "report.html").read_text()


def as_drawn(scene: Scene) -> Scene:
    return scene


def exchange_head(scene: Scene) -> Scene:
    other = draw_scene("mini", seed=OTHER_SEED, fiducials=Carrier.SURFACE).head
    assert other.face is not None
    exchanged = ExchangedHead(semi_axes_mm=other.semi_axes_mm, face=other.face)
    return scene.model_copy(update={"head": scene.head.model_copy(update={"exchanged": exchanged})})


def mirror_ct(scene: Scene) -> Scene:
    return scene.model_copy(update={"ct": scene.ct.model_copy(update={"mirrored": True})})


def halve_ct(scene: Scene) -> Scene:
    return scene.model_copy(update={"ct": scene.ct.model_copy(update={"missing_slices": HALF_A_HEAD})})


@dataclass(frozen=True)
class Bad:
    """Input that is refused in a step, with one of these codes."""

    step: str
    codes: tuple[str, ...]
    change: Callable[[Scene], Scene] = as_drawn
    faults: str = ""


BAD = {
    "a head of another patient": Bad("surface_start", ("PRO-007",), change=exchange_head),
    "a mirrored CT": Bad("surface_start", ("SRF-006",), change=mirror_ct),
    "half a head in the CT": Bad("skin_in_ct", ("SRF-037",), change=halve_ct),
    "a head that moves with its clamp": Bad(
        "surface_scan", ("PRO-020", "PRO-052"), faults=f"{SCANNING} after 30 s: room shift head 1 1 0.5 mm"
    ),
    "a projector that stays dark": Bad(
        "surface_scan", ("SRF-032",), faults=f"{SCANNING}: camera projector dark"
    ),
    "a projector that goes out": Bad(
        "surface_scan", ("SRF-032",), faults=f"{SCANNING} after 25 s: camera projector dark"
    ),
    "a hand in the scan": Bad(
        "surface_registration", ("SRF-005", "SRF-010"), faults=f"{SCANNING}: camera hand 2 mm"
    ),
    "a saturated camera": Bad("surface_scan", ("SRF-032",), faults=f"{SCANNING}: camera saturate left"),
}


def step_of(line: Line) -> str:
    """The step of a line of the journal, without its trajectory."""
    return str(line.get("step")).partition(":")[0]


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_with_the_arm_at_rest_and_nothing_lost(name: str, case: SimulatedCase) -> None:
    bad = BAD[name]
    scene = bad.change(draw_scene("mini", seed=SEED, fiducials=Carrier.SURFACE))
    ran = case.run(scene=scene, faults=bad.faults)
    assert ran.returncode != 0, ran.stdout
    lines = case.journal
    (failed,) = (line for line in lines if line["entry"] == "failed")
    assert step_of(failed) == bad.step
    assert failed["code"] in bad.codes
    assert ". " in ran.stderr.splitlines()[-1]  # the reason, then what to do
    entries = [line["entry"] for line in lines]
    assert entries.count("motion") == entries.count("moved")
    assert entries[-1] == "closed"
    assert "positioning" not in {step_of(line) for line in lines}
    kept = {record.kind for record in records_of(case.run_folder)}
    assert {step_of(line) for line in lines if line["entry"] == "result"} <= kept
    exported = case.commands.run(
        "ronna-procedure", "export", str(case.run_folder), "--out", str(case.folder / "exported")
    )
    assert exported.returncode == EXIT_DONE, exported.stderr


def test_a_scan_that_was_refused_is_taken_again_and_the_case_goes_on(case: SimulatedCase) -> None:
    slips = f"{SCANNING} after 20 s: room shift slipping_head 1 0 0 mm"
    ran = case.run("--scene", "mini", "--seed", str(SEED), "--fiducials", "surface", faults=slips)
    assert "SRF-008" in ran.stderr, ran.stderr
    assert "the skin is scanned again" in ran.stderr
    ended, _, errors = go_on(case, "")
    assert ended == EXIT_DONE, errors
    scans = [record for record in records_of(case.run_folder) if record.kind == "surface_scan"]
    assert len(scans) == 2  # the refused one, and another


def write_not_a_number(slice_file: Path) -> None:
    """Spoil the grey values of a slice as a faulty archive does: no writer of DICOM allows it."""
    data = pydicom.dcmread(slice_file)
    data[Tag("RescaleSlope")] = RawDataElement(Tag("RescaleSlope"), "DS", 4, b"NaN ", 0, False, True)
    data.save_as(slice_file)


def go_on(case: SimulatedCase, orders: str) -> tuple[int, str, str]:
    """Resume the case and give it orders; return how it ended, and what it said."""
    line = ("ronna-procedure", "resume", str(case.run_folder), "--accept")
    resumed = case.commands.start(*line, stdin=subprocess.PIPE)
    said, errors = resumed.communicate(orders, timeout=LIMIT_S)
    return resumed.returncode, said, errors


def test_grey_values_that_are_no_numbers_since_a_case_began_are_refused_and_it_goes_on_with_sound_ones(
    case: SimulatedCase,
) -> None:
    case.step("quit", words=("--scene", "mini", "--seed", str(SEED), "--fiducials", "surface"))
    spoilt = sorted((case.run_folder / "case" / "ct").iterdir())[HALF_A_HEAD]
    sound = spoilt.read_bytes()
    write_not_a_number(spoilt)
    _, said, errors = go_on(case, "next\nquit\n")
    assert "done ct_import" not in said
    assert "PRO-033" in errors  # what is imported like that from the start is CT-012
    assert f"case/ct/{spoilt.name}: changed" in errors
    assert "ronna-procedure verify RUN" in errors
    assert not any(line["entry"] == "motion" for line in case.journal)
    spoilt.write_bytes(sound)
    ended, said, errors = go_on(case, "to skin_in_ct\nquit\n")
    assert ended == EXIT_DONE, errors
    assert "done skin_in_ct" in said
