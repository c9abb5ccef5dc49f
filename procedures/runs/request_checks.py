"""Checks of a request before its run folder is created: theatre, plan, answers, fault script.

What a check needs is imported by it: a simulated theatre starts only after them, and everything else can be
imported while that is under way.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.engine.methods import CaseMethods, HeadStart
from procedures.journal.free_space import NO_DISK, describe_shortage
from procedures.runs.fault_script import check_fault_lines, check_fault_script
from procedures.runs.request import FREE, PATIENT_SCENES, CaseProcedure
from ronna_hw.command_line.errors import DISK_FULL, PATH_PROBLEM, UsageMistake
from ronna_hw.command_line.messages import on_terminal, tell
from ronna_hw.config import ARM_RECORDS, TheatreFile, read_theatre_file
from ronna_hw.control_port import TRUTH_IS_TOLD, VARIABLE, require_theatre
from ronna_hw.devices.errors import NotInTheatre
from ronna_hw.mistakes import suggest_keys
from ronna_hw.phantom_identity import parse_patient_id
from ronna_hw.theatre_kind import is_simulated, require_one_kind

if TYPE_CHECKING:
    from procedures.planning.plan_model import FiducialKind
    from procedures.runs.request import RunRequest, SceneChoice


def check_theatre(request: RunRequest) -> None:
    """Check theatre file and records before anything is opened. Raises CFG-001, CAL-001, CAL-005.

    CTL-004 for a theatre that tells the truth, PRO-043 while another run has its devices, PRO-047 while the
    instrument of one may be inside, CLI-001 if nobody can be asked.
    """
    if request.config is not None:
        from procedures.runs.theatre_lock import require_ready_theatre

        require_ready_theatre(request.config, roles=request.roles)
        _require_truth_untold(request.config)
    check_asking(request)
    if request.choice.records:
        from procedures.runs.calibration_files import require_records

        require_records(request.choice.records)
    if request.config is not None:
        from procedures.calibration.arm_check import require_record

        theatre = read_theatre_file(request.config)
        if request.choice.calibrated:
            require_record(theatre.calibration.arm if theatre.calibration else None)
        if len(request.roles) > 1:
            require_two_arms(theatre)


def _require_truth_untold(config: Path) -> None:
    """Raise CTL-004 for a theatre that tells the truth: a good result in it would prove nothing."""
    if read_theatre_file(config).tells_truth:
        raise TRUTH_IS_TOLD(
            f"the theatre of {config} tells the truth about its room to whoever asks",
            expected="a theatre started without --tell-truth",
        )


def require_two_arms(theatre: TheatreFile) -> None:
    """Raise DEV-007 unless a theatre file has both arms, with the records that two arms need."""
    records = {} if theatre.calibration is None else theatre.calibration.records
    missing_roles = [role for role in ARM_RECORDS if role not in theatre.robot]
    needed = [name for names in ARM_RECORDS.values() for name in names]
    missing = [f"[robot.{role}]" for role in missing_roles]
    missing += [f"[calibration.{name}]" for name in needed if name not in records]
    if missing:
        unknown = [name for name in theatre.robot if missing_roles and name not in ARM_RECORDS]
        write = "Add or rename them"
        if len(unknown) == len(missing_roles) == 1:
            write = f"Write [robot.{missing_roles[0]}] in place of [robot.{unknown[0]}]"
            write += ", and add the others" if len(missing) > 1 else ""
        raise NotInTheatre(
            f"theatre {theatre.theatre} cannot work with two arms: it has no {', '.join(missing)}"
            + "".join(f"; [robot.{name}] is unknown{suggest_keys(name, missing_roles)}" for name in unknown),
            action=f"{write}, or omit --dual: docs/how-to/case/two-arms.md says how.",
        )


def check_asking(request: RunRequest, begun: Path | None = None) -> None:
    """Raise CLI-001 if a run with --ask has no terminal, or its theatre no staff who can be told by words.

    `begun` is the folder of a run that had begun before, for which nobody types --ask again.
    CTL-001 to CTL-003 unless the control port is that of the theatre: its staff would work in another room.
    """
    if not request.ask:
        return
    streams = {"standard input": sys.stdin, "standard error": sys.stderr}
    if away := [name for name, stream in streams.items() if not on_terminal(stream)]:
        got = f"{' and '.join(away)} {'are' if len(away) > 1 else 'is'} not a terminal"
        if begun is not None:
            raise UsageMistake(
                f"{begun.name} was begun with --ask: a person is asked and answers at a terminal",
                got=got,
                action="Nothing was moved. Run the command at a terminal: a run begun with --ask always asks "
                "again.",
            )
        raise UsageMistake(
            "--ask needs a terminal, where a person is asked and answers",
            got=got,
            action="Run it at a terminal; --answers FILE answers without one, in a run begun without --ask.",
        )
    if request.config is None:
        return
    theatre = read_theatre_file(request.config)
    if not is_simulated(theatre):
        raise UsageMistake(
            "--ask is for a simulated theatre",
            got=str(request.config),
            action="Omit it: on real devices every question is asked, and people do the manual work.",
        )
    if not (control := os.environ.get(VARIABLE)):
        raise UsageMistake(
            f"--ask needs the control port of the theatre in {VARIABLE}, where manual work is done by a word",
            action='Type eval "$(ronna-sim env THEATRE-FOLDER)"; a new run may omit --ask, and the work is '
            "done with ronna-sim.",
        )
    if theatre.identity:  # a file written by hand has none to compare
        require_theatre(control, theatre.identity, request.config)


def require_fitting_options(case: CaseProcedure, fiducials: FiducialKind) -> None:
    """Raise CLI-001 for options without effect with these fiducials, and as `require_one_change`."""
    require_one_change(case, fiducials)
    without_spheres = not fiducials.fewest_and_most[1]
    at_spheres = "spheres: on the skin alone, the same looks serve all targets"
    in_ct = "spheres in the CT"
    by_distances = "spheres paired by their distances; beside the skin, landmarks tell them apart"
    default = CaseProcedure()
    at_outlines = "spheres, whose outlines it changes: a line of light is read without it"
    for option, given, usual, is_idle, expected in (
        ("--strategy", case.strategy, default.strategy, without_spheres, at_spheres),
        ("--localizer", case.methods.localizer, default.methods.localizer, without_spheres, in_ct),
        ("--matcher", case.methods.matcher, default.methods.matcher, fiducials.has_skin, by_distances),
        ("--enhance-contrast", case.methods.enhance_contrast, False, without_spheres, at_outlines),
    ):
        if is_idle and given != usual:
            raise UsageMistake(
                f"{option}{'' if given is True else f' {given}'} has no effect with fiducials {fiducials}",
                expected=expected,
                action=f"Omit {option}.",
            )


def require_one_change(case: CaseProcedure, fiducials: FiducialKind) -> None:
    """Raise CLI-001 for a case on the skin with an assistant, or with a scan during the operation.

    The same holds for a start by the scan of a head with spheres.
    """
    from procedures.planning.plan_model import FiducialKind

    start = case.methods.start
    if start is not HeadStart.LANDMARKS and fiducials is not FiducialKind.SURFACE:
        raise UsageMistake(
            f"--start {start} and fiducials {fiducials} cannot be combined",
            expected="the skin alone: what spheres there are, landmarks tell apart",
            action="Omit --start, or register on the skin: --fiducials surface.",
        )
    if not fiducials.has_skin:
        return
    for option, is_given, expected in (
        ("--dual", len(case.roles) > 1, "one arm"),
        ("--intraoperative", case.intraoperative, "the CT from before, to which the skin is registered"),
    ):
        if is_given:
            raise UsageMistake(
                f"{option} and fiducials {fiducials} cannot be combined",
                expected=expected,
                action=f"Omit {option}, or register by spheres alone: fiducials {FREE}.",
            )


def _require_known_head(case: CaseProcedure, theatre: TheatreFile) -> None:
    """Raise CLI-001 for first looks at a patient whose head was only measured roughly."""

    if case.methods.start is HeadStart.SCAN and not is_simulated(theatre):
        raise UsageMistake(
            "--start scan sends the stereo head to a head whose place nothing but a tape has told",
            expected="a simulated theatre",
            action="Omit --start: nose and ears are touched with a pointer.",
        )


def check_case(request: RunRequest, out: Path) -> None:
    """Check theatre, plan, answers, fault script and free space of a case before its run folder is made."""
    case_procedure = request.case
    require_space(out)
    if case_procedure.strategy != CaseProcedure.strategy:
        from procedures.strategies.catalogue import find_strategy

        find_strategy(case_procedure.strategy)
    is_usual = request.choice.fiducials == FREE and case_procedure.methods.start == CaseMethods().start
    if request.config is None and not request.choice.has_own_fiducials and not is_usual:
        from procedures.planning.plan_model import FiducialKind

        require_fitting_options(case_procedure, FiducialKind(request.choice.fiducials))
    check_theatre(request)
    if request.config is not None:
        theatre = read_theatre_file(request.config)
        require_one_kind(theatre)
        _require_known_head(case_procedure, theatre)
        if theatre.procedure.assistant_drills and len(request.roles) == 1:
            tell(f"warning: a hand drills: assistant_drills of {request.config} is for --dual")
        case = case_procedure.case or Path()
        around = case.resolve().parent
        if case.resolve() == around / "ct" and (around / "plan.toml").exists():
            raise PATH_PROBLEM(
                f"{case} is the ct folder of a case", action=f"Give the case folder, {around}."
            )
        if case.is_file():
            raise PATH_PROBLEM(
                f"{case} is a file", expected="a case folder with ct/ and plan.toml", action=f"Give {around}."
            )
        for part in ("ct", "plan.toml"):
            path = case / part
            if not path.exists():
                raise PATH_PROBLEM(f"{path} does not exist", expected="a case folder with ct/ and plan.toml")
        if request.answers is not None:
            from procedures.planning.plan_file import read_plan

            plan = read_plan(case / "plan.toml")
            request.answers.check_trajectories([one.id for one in plan.trajectories])
    if case_procedure.plan is not None:
        from procedures.planning.plan_file import read_plan

        plan = read_plan(case_procedure.plan)
        if request.answers is not None:
            request.answers.check_trajectories([one.id for one in plan.trajectories])
        if request.config is None:
            require_planned_fiducials(case_procedure.plan, plan.fiducials, request.choice)
            require_simulated_patient(case_procedure.plan, plan.series_instance_uid, request.choice)
    if request.faults is not None:
        from procedures.engine.order import Scope
        from procedures.planning.plan_model import FiducialKind
        from procedures.steps.catalogue import clinical_steps

        stated = FiducialKind(request.choice.fiducials)
        kinds = tuple(FiducialKind) if request.choice.has_own_fiducials else (stated,)
        steps = [
            step
            for kind in kinds
            for step in clinical_steps(
                measure_targets=case_procedure.measure_targets,
                intraoperative=case_procedure.intraoperative,
                roles=case_procedure.roles,
                fiducials=kind,
                start=case_procedure.methods.start,
            )
        ]
        once = {step.name for step in steps if step.scope is Scope.CASE}
        once -= {step.name for step in steps if step.scope is not Scope.CASE}
        check_fault_script(request.faults, tuple(dict.fromkeys(step.name for step in steps)), once)
        check_fault_lines(request.faults)


def require_space(out: Path) -> None:
    """Raise CLI-003 unless the disk that a run in `out` will be written to has room for a whole case."""
    resolved = out.resolve()
    folder = next(path for path in (resolved, *resolved.parents) if path.exists())  # a run makes the others
    if shortage := describe_shortage(folder):
        room = "" if shortage == NO_DISK else "Make room there, or "
        choose = f"{room}choose another folder with --out."
        raise DISK_FULL(
            f"no case was started in {out}: {shortage}",
            action=f"Nothing was written. {choose[0].upper()}{choose[1:]}",
        )


def require_planned_fiducials(plan_file: Path, planned: FiducialKind, choice: SceneChoice) -> None:
    """Raise CLI-001 if a plan is for other fiducials than a simulated patient has.

    Those of a scene file are read only later.
    """
    if choice.has_own_fiducials or planned == choice.fiducials:
        return
    raise UsageMistake(
        f"{plan_file.name} has fiducials {planned}, and the simulated patient --fiducials {choice.fiducials}",
        expected="a patient with the fiducials of the plan",
        action=f'Add --fiducials {planned}, or write fiducials = "{choice.fiducials}" into the plan.',
    )


def require_simulated_patient(plan_file: Path, series_instance_uid: str, choice: SceneChoice) -> None:
    """Raise PLAN-003 if the plan lies beside the CT of another simulated patient.

    The patient ID of a phantom's series names scene and seed. Without a CT beside it, the import of the
    series judges the plan.
    """
    from procedures.imaging.dicom.attributes import read_attribute_text
    from procedures.imaging.dicom.slice_headers import CT_FOLDER, iterate_images
    from procedures.planning.errors import WRONG_SERIES

    ct = plan_file.resolve().parent / CT_FOLDER
    tags = ("PatientID", "SeriesInstanceUID")
    path, header = next(iterate_images(ct, tags), (ct, None)) if ct.is_dir() else (ct, None)
    if header is None or read_attribute_text(path, header, tags[1]) != series_instance_uid:
        return
    patient = parse_patient_id(read_attribute_text(path, header, tags[0]))
    if patient is None or patient == (choice.scene, choice.scene_seed):
        return
    scene, seed = patient
    if scene in PATIENT_SCENES:
        same_scene = scene == choice.scene
        raise WRONG_SERIES(
            f"{plan_file.name} belongs to the simulated patient of scene {scene}, seed {seed}",
            expected=f"a plan of scene {choice.scene}, seed {choice.scene_seed}",
            action=f"For its own patient add {'' if same_scene else f'--scene {scene} '}--seed {seed}.",
        )
