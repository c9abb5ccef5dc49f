"""The verifier, on runs whose errors are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from user_commands import in_this_process, one_error

from procedures.engine.case import StepKey
from procedures.engine.run_folder import close_run
from procedures.journal.journal import JOURNAL_FILE, Entry, Journal
from procedures.runs.simulated_theatre import ask_verifier
from ronna_hw.errors import EXIT_FAILED
from ronna_hw.evidence.inspection import Inspection, inspect_run
from ronna_hw.evidence.journal_reading import RUN_CHANGED, read_chain
from ronna_hw.evidence.manifest import RECORDS_FOLDER, hash_truth_files
from ronna_hw.records import Record, write_record
from sim.cli import app as ronna_sim
from sim.errors import NOTHING_TO_VERIFY
from sim.theatre import verify
from sim.theatre.verify import verify_run
from sim.world.rigid import apply, inverse, matrix_of
from sim.world.scene.named_scenes import draw_scene
from sim.world.truth import SCENE_FILE, THEATRE_FOLDER, TRUTH_FILE, TipSample, append_sample

SCENE = draw_scene("mini")
TRAJECTORY = "left-STN"  # by the plan; no trajectory of the scene has this name
FIDUCIALS_MM = [fiducial.centre_ct_mm for fiducial in SCENE.head.fiducials]
ENTRY_MM, TARGET_MM = (10.0, 20.0, 80.0), (10.0, 20.0, 30.0)  # straight down, 50 mm deep


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run in which nothing has happened yet."""
    (tmp_path / THEATRE_FOLDER).mkdir()
    (tmp_path / RECORDS_FOLDER).mkdir()
    (tmp_path / THEATRE_FOLDER / SCENE_FILE).write_text(SCENE.model_dump_json(by_alias=True))
    ct_from_robot = inverse(matrix_of(SCENE.head.robot_from_ct))
    entry_mm, target_mm = (apply(ct_from_robot, end).tolist() for end in (ENTRY_MM, TARGET_MM))
    plan = {"trajectories": [{"id": TRAJECTORY, "entry_mm": entry_mm, "target_mm": target_mm}]}
    leave(tmp_path, Record("01-plan_check", "plan_check", {}, {"plan": plan}))
    return tmp_path


def leave(run: Path, record: Record) -> None:
    """A record and its line of the journal, as a run leaves them before it is closed."""
    write_record(record, run / RECORDS_FOLDER)
    path = run / JOURNAL_FILE
    journal = Journal.reopen_run(run, read_chain(path)) if path.exists() else Journal(run)
    step = str(StepKey(record.kind, record.trajectory))
    journal.write(Entry.RESULT, 0.0, step=step, record=record.identifier, sha256=record.sha256)
    journal.close()


def sample(theatre: Path, tip_mm: tuple[float, float, float], **changes: object) -> None:
    """Append a sample of the tip at the first target."""
    guide = SCENE.mount.tool_number_guide
    values = {"mounted_tool": guide, "arm_at_rest": True, "axis": (0.0, 0.0, -1.0), "target": TRAJECTORY}
    append_sample(
        TipSample.model_validate({**values, "theatre_time_s": 1.0, "tip_mm": tip_mm, **changes}), theatre
    )


@pytest.fixture
def at_target(run: Path) -> Callable[..., None]:
    return partial(sample, run / THEATRE_FOLDER)


@pytest.fixture
def localize(run: Path) -> Callable[[Sequence[Sequence[float]]], None]:
    """Leave the record of a localization in the run."""

    def record(centres_mm: Sequence[Sequence[float]]) -> None:
        payload = {"markers": [{"centre_mm": list(centre)} for centre in centres_mm]}
        leave(run, Record("02-fiducial_localization", "fiducial_localization", {}, payload))

    return record


def test_the_error_at_a_target_is_split_along_and_across_the_trajectory(
    run: Path, at_target: Callable[..., None]
) -> None:
    at_target((10.3, 20.4, 28.8))  # 0.5 mm beside it and 1.2 mm too deep
    (target,) = verify_run(run)["targets"]
    assert target["application_error_mm"] == pytest.approx(1.3)
    assert target["lateral_mm"] == pytest.approx(0.5)
    assert target["axial_mm"] == pytest.approx(1.2)
    assert target["depth_mm"] == pytest.approx(50.0)
    assert target["guide_mounted"]


def test_the_error_at_a_target_is_the_sum_of_that_of_the_registration_and_that_of_the_arm(
    run: Path, at_target: Callable[..., None]
) -> None:
    true = matrix_of(SCENE.head.robot_from_ct)
    registered = {
        **SCENE.head.robot_from_ct.model_dump(),
        "translation_mm": (true[:3, 3] + (0.6, 0, 0)).tolist(),
    }
    used = Record("02-registration", "registration", {}, {"robot_from_ct": registered})
    leave(run, used)
    leave(
        run,
        Record("03-positioning", "positioning", {used.identifier: used.sha256}, {}, trajectory=TRAJECTORY),
    )
    at_target((10.1, 20.0, 29.9))
    (target,) = verify_run(run)["targets"]
    assert target["parts"]["registration_mm"] == pytest.approx([0.6, 0.0, 0.0])
    assert target["parts"]["intrinsic_mm"] == pytest.approx([-0.5, 0.0, -0.1])


def test_a_target_to_which_no_valid_registration_led_is_not_split(
    run: Path, at_target: Callable[..., None]
) -> None:
    at_target(TARGET_MM)
    assert "parts" not in verify_run(run)["targets"][0]


def test_the_last_sample_at_a_target_counts(run: Path, at_target: Callable[..., None]) -> None:
    at_target((15.0, 20.0, 30.0))
    at_target((10.0, 20.0, 30.1))
    assert [target["axial_mm"] for target in verify_run(run)["targets"]] == pytest.approx([-0.1])


def test_a_target_reached_with_the_stereo_head_is_marked(run: Path, at_target: Callable[..., None]) -> None:
    at_target(TARGET_MM, mounted_tool=SCENE.mount.tool_number_stereo)
    assert not verify_run(run)["targets"][0]["guide_mounted"]


OFF_MM = [np.add(centre, (0.0, 0.03, 0.04)).tolist() for centre in FIDUCIALS_MM[1:]]
COUNT = len(FIDUCIALS_MM)


@pytest.mark.parametrize(
    ("centres_mm", "counts"),
    [([*OFF_MM, (500.0, 0.0, 0.0)], (COUNT - 1, 1, 1, pytest.approx(0.05))), ([], (0, COUNT, 0, None))],
)
def test_spheres_are_counted_as_found_missed_and_false(
    run: Path, localize: Callable[..., None], centres_mm: list[Sequence[float]], counts: tuple[object, ...]
) -> None:
    localize(centres_mm)
    names = ("found", "missed", "false", "rms_error_mm")
    assert verify_run(run)["ct"] == dict(zip(names, counts, strict=True))


@pytest.mark.parametrize("centre_mm", [["x", 0.0, 0.0], [1.0], None])
def test_a_record_that_no_run_writes_is_refused(run: Path, centre_mm: list[object] | None) -> None:
    payload = {"markers": [{"centre_mm": centre_mm}]}
    leave(run, Record("02-fiducial_localization", "fiducial_localization", {}, payload))
    with raises(NOTHING_TO_VERIFY, match="is not what a run writes"):
        verify_run(run)


def test_a_run_without_spheres_or_targets_cannot_be_verified(run: Path) -> None:
    with raises(NOTHING_TO_VERIFY, match="located no sphere and reached no target"):
        verify_run(run)


def test_a_folder_of_runs_is_refused_with_their_names(tmp_path: Path) -> None:
    for number in range(6):
        (tmp_path / f"{number}-mini").mkdir()
        (tmp_path / f"{number}-mini" / JOURNAL_FILE).touch()
    with raises(NOTHING_TO_VERIFY, match=r"is not a run; it holds 6 runs: 0-mini.* and 1 more") as caught:
        verify_run(tmp_path)
    assert caught.value.advice == f"Give one of them: {tmp_path / '5-mini'}."


@pytest.mark.parametrize("as_json", [True, False])
@pytest.mark.parametrize(("inserted_at", "said"), [(None, "of its plan"), ("left-SNT", ", but at left-SNT")])
def test_a_run_that_reached_no_target_is_no_success(
    run: Path, localize: Callable[..., None], inserted_at: str | None, said: str, as_json: bool
) -> None:
    localize(FIDUCIALS_MM)
    if inserted_at is not None:
        sample(run / THEATRE_FOLDER, TARGET_MM, target=inserted_at)
    done = in_this_process(ronna_sim, "verify", run, *(["--json"] if as_json else []))
    assert done.returncode == EXIT_FAILED
    shown = " ".join(one_error(done.stderr))
    assert "SIM-006" in shown
    assert said in shown
    assert "--trajectory" in shown
    assert bool(done.stdout) == as_json


def test_a_case_may_ask_for_the_truth_of_a_run_that_reached_no_target(
    run: Path, localize: Callable[..., None]
) -> None:
    localize(FIDUCIALS_MM)
    truth = ask_verifier(run)
    assert truth.ct is not None
    assert truth.ct.found == len(FIDUCIALS_MM)
    assert truth.targets == ()


@pytest.fixture
def theatre(run: Path) -> Path:
    """The theatre as it is after a run by hand: a folder of its own."""
    return (run / THEATRE_FOLDER).rename(run.parent / f"{run.name}-theatre")


def test_a_manual_run_is_compared_with_the_samples_its_theatre_took_during_it(
    run: Path, theatre: Path
) -> None:
    sample(theatre, (10.0, 20.0, 30.1), theatre_time_s=0.0)
    sample(theatre, (15.0, 20.0, 30.0), theatre_time_s=3600.0)  # by a later run
    with raises(NOTHING_TO_VERIFY, match=r"no simulated theatre.*--theatre"):
        verify_run(run)
    assert [target["axial_mm"] for target in verify_run(run, theatre)["targets"]] == pytest.approx([-0.1])


def test_a_manual_run_is_not_compared_with_a_theatre_of_another_patient(
    run: Path, theatre: Path, localize: Callable[[Sequence[Sequence[float]]], None]
) -> None:
    localize([(500.0, 0.0, 0.0)])
    with raises(NOTHING_TO_VERIFY, match="another patient"):
        verify_run(run, theatre)


@pytest.mark.hazard(39)
@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("name", [SCENE_FILE, TRUTH_FILE])
def test_truth_that_changes_after_the_check_is_not_compared(
    run: Path, at_target: Callable[..., None], monkeypatch: pytest.MonkeyPatch, name: str, closed: bool
) -> None:
    at_target(TARGET_MM)
    journal = Journal.reopen_run(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.FOUND, 1.0, **hash_truth_files(run))
    if closed:
        close_run(run, journal, 2.0, "done", None)
    else:
        journal.close()

    def then_exchanged(folder: Path) -> Inspection:
        found = inspect_run(folder)
        path = run / THEATRE_FOLDER / name
        path.write_bytes(path.read_bytes().replace(b"0", b"1"))
        return found

    assert verify_run(run)["targets"]
    monkeypatch.setattr(verify, "inspect_run", then_exchanged)
    with raises(RUN_CHANGED, match=f"PRO-033: .*{name}: changed"):
        verify_run(run)


@pytest.mark.hazard(39)
def test_a_record_altered_after_the_run_is_not_compared_with_the_truth(
    run: Path, localize: Callable[[Sequence[Sequence[float]]], None]
) -> None:
    localize(FIDUCIALS_MM)
    (run / RECORDS_FOLDER / "99-fiducial_localization.json").write_text("{}")  # nobody asks for it
    assert verify_run(run)["ct"]["found"] == len(FIDUCIALS_MM)
    path = run / RECORDS_FOLDER / "02-fiducial_localization.json"
    path.write_text(path.read_text().replace('"created": "2', '"created": "1'))
    with raises(RUN_CHANGED, match=r"PRO-033: .*02-fiducial_localization"):
        verify_run(run)
