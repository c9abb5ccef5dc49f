"""`ronna-ct postoperative`: comparison of the postoperative CT with the plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_output_folder

if TYPE_CHECKING:
    from procedures.exchange.ct_study import CtStudy
    from procedures.imaging.volume import Volume
    from procedures.planning.plan_model import Plan
    from procedures.postoperative.summary import PostoperativeCheck
    from procedures.reporting.files import PostoperativeResult

READING_SHARE = 0.3  # of the progress bar, for each series


def postoperative(
    pre_dir: Annotated[Path, typer.Argument(metavar="PRE", help="Folder of the planning CT.")],
    post_dir: Annotated[Path, typer.Argument(metavar="POST", help="Folder of the postoperative CT.")],
    plan_file: Annotated[Path, typer.Option("--plan", metavar="PLAN", help="The plan.toml.")],
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only", metavar="ID", help="A trajectory that was carried out; repeatable [all of the plan]."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Also write JSON, DICOM objects and pictures into DIR."),
    ] = None,
    identity: Annotated[
        bool,
        typer.Option(
            "--identity",
            help="Name patient and study of PRE in the DICOM objects, so that an archive files them there.",
        ),
    ] = False,
    run: Annotated[
        Path | None, typer.Option("--run", metavar="RUN", help="Add the result to the report of this run.")
    ] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Register both CTs on bone, find the inserted instruments and report their errors against the plan.

    Along each trajectory an electrode, a needle or otherwise a drilled hole is searched for, within 10 mm of
    the plan. The errors are in the coordinates of the planning CT; only DICOM objects name the patient, with
    --identity. Exit codes: 0
    every trajectory was found, 1 a CT or the plan is unusable, 2 usage, 3 refused: another patient or head,
    nothing found along a trajectory, 130 interrupted.
    """
    import procedures.imaging as imaging
    from procedures.exchange.ct_study import read_ct_study
    from procedures.planning.plan_file import read_plan
    from procedures.postoperative.comparison import compare_with_plan
    from procedures.postoperative.summary import summarize_comparison

    if out is not None:
        require_output_folder(out)
    elif identity:
        raise UsageMistake(
            "--identity is for DICOM objects, which need a folder",
            expected="--out DIR",
            got="none",
            action="Name a folder with --out, or omit --identity.",
        )
    plan = read_plan(plan_file)
    known = [one.id for one in plan.trajectories]
    for name in only or ():
        if name not in known:
            raise UsageMistake(
                f"--only: {plan_file} has no trajectory {name}",
                expected=", ".join(known),
                action="Name a trajectory of the plan, or omit --only for all.",
            )
    if run is not None:
        _require_same_plan(run, plan)
    warnings = _check_same_patient(pre_dir, post_dir)
    with terminal.progress_bar("reading and comparing") as advance:
        pre = imaging.read_series(pre_dir, progress=lambda share: advance(READING_SHARE * share))
        post = imaging.read_series(post_dir, progress=lambda share: advance(READING_SHARE * (1.0 + share)))
        study = read_ct_study(pre_dir, pre.series_instance_uid) if identity else None
        proof = compare_with_plan(plan, pre, post, only or ())
    found = summarize_comparison(proof, plan, pre, post, warnings)
    for sentence in found.warnings:
        terminal.tell(f"warning: {sentence}")
    if out is not None or run is not None:
        from procedures.postoperative.summary import draw_trajectory
        from procedures.reporting.files import PostoperativeResult

        pose = proof.registration.post_from_pre
        after = PostoperativeResult(
            found, {one.id: draw_trajectory(post, one, pose) for one in found.trajectories}
        )
        if out is not None:
            _write_files(out, after, pre, post, study)
        if run is not None:
            from procedures.runs.finishing import rebuild_report

            terminal.tell(f"report {rebuild_report(run, after=after)}")
    if as_json:
        terminal.print_json(found.model_dump(mode="json", by_alias=True))
        return
    _print_check(found)


def _check_same_patient(pre_dir: Path, post_dir: Path) -> tuple[str, ...]:
    """Raise POST-005 if the patient identifiers differ; return a warning if one is missing."""
    from procedures.imaging.dicom.slice_headers import read_identity
    from procedures.postoperative.errors import OTHER_PATIENT

    before, after = (read_identity(folder).identifier for folder in (pre_dir, post_dir))
    if before and after and before != after:  # messages never name patients
        raise OTHER_PATIENT("the two CTs have different patient identifiers")
    if before and after:
        return ()
    return ("not both CTs have a patient identifier: only the skull shows that they are of the same patient",)


def _require_same_plan(run: Path, plan: Plan) -> None:
    """Raise POST-008 if the run followed another plan, or PRO-033 if its files were changed."""
    from procedures.engine.case import results_of
    from procedures.postoperative.errors import RUN_OF_ANOTHER_PLAN
    from procedures.steps.clinical.plan_check import CheckedPlan
    from ronna_hw.evidence.inspection import inspect_run

    checked = results_of(CheckedPlan, inspect_run(run).require_unchanged().valid_records)
    if not checked:
        raise RUN_OF_ANOTHER_PLAN("the run has no checked plan")
    if checked[-1].result.plan != plan:
        followed = checked[-1].result.plan
        fields = type(plan).model_fields
        differing = [name for name in fields if getattr(followed, name) != getattr(plan, name)]
        raise RUN_OF_ANOTHER_PLAN(
            f"the run {run.name} followed another plan: it differs in {' and '.join(differing)}"
        )


def _write_files(
    out: Path, after: PostoperativeResult, pre: Volume, post: Volume, study: CtStudy | None
) -> None:
    """Write the files of a check. DICOM objects name the patient of the `study`, if it is given."""
    from procedures.exchange.errors import NOT_WRITABLE
    from procedures.exchange.postoperative_objects import write_postoperative
    from procedures.reporting.files import store_check

    try:
        store_check(out, after)
    except OSError as error:
        raise NOT_WRITABLE(f"cannot write into {out}: {error.strerror}") from error
    frames = (pre.frame_of_reference_uid, post.frame_of_reference_uid)
    absent = write_postoperative(after.found, frames, pre.study_instance_uid, out, study)
    if study is not None:
        terminal.tell(f"patient: {study.describe()}")
    for name, reason in absent.items():
        terminal.tell(f"warning: {name} was not written: {reason}")


def _print_check(found: PostoperativeCheck) -> None:
    def format_mm(value: float | None) -> str:
        return "-" if value is None else f"{value:.2f}"

    headings = ["trajectory", "found", "entry mm", "target mm", "across mm", "depth mm", "angle deg"]
    rows = []
    for one in found.trajectories:
        errors = map(format_mm, (one.entry_error_mm, one.target_error_mm, one.lateral_mm))
        depth = "-" if one.depth_error_mm is None else f"{one.depth_error_mm:+.2f}"
        rows.append([one.id, one.kind.value, *errors, depth, format_mm(one.angle_deg)])
    title = f"skulls agree to {found.bone_agreement:.3f} over {found.bone_overlap:.0%} of the bone"
    terminal.print_table(title, headings, rows)
