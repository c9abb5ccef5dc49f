"""Errors in plans, PLAN-001 to PLAN-035, and in tool records, TOOL-002 and TOOL-003.

Several errors of one check are raised as one error; if they are all of one kind it has that kind's
code, otherwise PLAN-002.
"""

from __future__ import annotations

from collections.abc import Sequence

from ronna_hw.errors import ConfigurationError, DataError, ErrorCode, RefusedError, RonnaError

PLAN_UNREADABLE = ErrorCode(
    "PLAN-001",
    ConfigurationError,
    "The plan file is missing, unreadable or not valid TOML.",
    "Give the path of a plan.toml that can be read; where the message shows a line of it, correct that line.",
)


class PlanError(DataError):
    """Base class of all errors in a plan."""


class PlanMistakes(PlanError):
    """The plan has invalid keys or values, or several kinds of mistakes, all listed in the message."""

    code = "PLAN-002"
    action = "Correct every line listed; docs/reference/plan-file.md describes every key."


WRONG_SERIES = ErrorCode(
    "PLAN-003",
    PlanError,
    "The plan belongs to a different CT series.",
    (
        "Load the series that the plan was made on (with --sim: give --scene and --seed of the run that it "
        "came from), or re-plan on this one."
    ),
)


BAD_TRAJECTORY_GEOMETRY = ErrorCode(
    "PLAN-004",
    PlanError,
    "Entry and target coincide, or the depth is impossible.",
    "Correct entry and target; coordinates are LPS millimetres of the series.",
)


DUPLICATE_TRAJECTORY = ErrorCode(
    "PLAN-005",
    PlanError,
    "Two trajectories have the same id and cannot be told apart.",
    "Give every trajectory a unique id.",
)


OUTSIDE_FIELD = ErrorCode(
    "PLAN-006",
    PlanError,
    "An entry or target is outside the CT.",
    "Check the coordinates: LPS millimetres of this series, not of another frame or in RAS.",
)


class NotReachable(RefusedError):
    """The arm cannot reach a pose of the procedure, or cannot follow the line to it."""

    code = "PLAN-007"
    action = (
        "Change the free angle, move the cart, the head or the obstacle, plan a larger standoff_mm where the "
        "guide comes too near, or give the arm a wider range in the theatre file; then check again."
    )


class WrongMarkerCount(PlanError):
    """The number of fiducials in the CT differs from the number implanted."""

    code = "PLAN-008"
    action = "Look at the candidates in the CT; correct the count in the plan only after counting the screws."


WRONG_ORIENTATION = ErrorCode(
    "PLAN-009",
    PlanError,
    "The CT was acquired in a different patient position from the plan's.",
    "First find out which is right: left and right may be swapped.",
)


class NotIntoHead(PlanError):
    """According to the CT, a trajectory does not lead from outside the head to a target inside it."""

    code = "PLAN-011"
    action = "Check entry and target in the CT: they may be swapped, or given in RAS."


class UnknownTool(PlanError):
    """The plan names an unknown tool."""

    code = "PLAN-012"
    action = "Name the tool that the plan was made for; other tools have other lengths."


NOT_THE_FRAME = ErrorCode(
    "PLAN-013",
    PlanError,
    "The CT shows only part of the planned x-shaped frame, or none of it.",
    'Check the spheres in the CT; for single spheres on screws, set fiducials = "free".',
)


NO_HEAD_IN_CT = ErrorCode(
    "PLAN-014",
    PlanError,
    "No head was found in the CT, so clearance to it cannot be checked.",
    "Check that this is the CT of the head, in Hounsfield units.",
)


NO_TEMPLATE = ErrorCode(
    "PLAN-015",
    PlanError,
    "No set of positions on the head has distances that differ by the requested margin.",
    "Ask for a smaller --margin or for three markers.",
)


HEAD_UNREADABLE = ErrorCode(
    "PLAN-016",
    ConfigurationError,
    "The file does not describe a head.",
    "Give the output of `ronna-sim scene`, or theatre/scene.json of a simulated run.",
)


NOT_THE_TEMPLATE = ErrorCode(
    "PLAN-017",
    PlanError,
    "The fiducials in the CT do not match the plan's template.",
    "Check that this is the patient's template; if there is none, remove template_mm from the plan.",
)


class StandoffInsideSkin(PlanError):
    """The stand-off would place the guide's lower end inside the skin."""

    code = "PLAN-018"
    action = "Set a larger standoff_mm; also check the entry in the CT."


STOP_BEYOND_INSTRUMENT = ErrorCode(
    "PLAN-019",
    PlanError,
    "The depth stop would be beyond the end of the instrument.",
    "Plan with a longer instrument or a smaller standoff_mm.",
)


NO_PLACE = ErrorCode(
    "PLAN-020",
    RefusedError,
    "None of the cart positions examined allows the whole plan to be executed.",
    "Search farther with --within, or change the head position, the free angles or the --strategy.",
)


NO_MARKER_SITES = ErrorCode(
    "PLAN-021",
    PlanError,
    "The head has no room for that many markers clear of the trajectories.",
    "Ask for fewer --markers, or move an entry point.",
)


PLACE_UNFIT = ErrorCode(
    "PLAN-022",
    PlanError,
    "The file with the proposed cart position is unreadable or belongs to another CT.",
    "Make it again with ronna-plan place PLAN --ct DIR --out DIR, or remove it from the case folder.",
)


ALTERED_PLAN = ErrorCode(
    "PLAN-023",
    PlanError,
    "The plan does not match its planner seal.",
    "Open it in the planner, review it and save it again; remove the seal if the edit is yours.",
)


class OtherVoxels(PlanError):
    """The CT has the plan's series UID but different voxels."""

    code = "PLAN-024"
    action = "Find out which CT is the patient's; re-plan on the one that is used."


PLAN_NOT_SAVED = ErrorCode(
    "PLAN-025",
    ConfigurationError,
    "The plan cannot be saved.",
    "Nothing is lost: the plan stays on this page. Free space or fix the permissions, then save again.",
)


class PlanInUse(RefusedError):
    """The plan is used by a running case, part of a run folder, or open in another planner."""

    code = "PLAN-026"
    action = "You can still view it; save it when the case has ended or the other planner is closed."


NEAR_STRUCTURE = ErrorCode(
    "PLAN-027",
    PlanError,
    "A trajectory comes closer to a structure than its margin allows.",
    "Move entry or target; reduce the margin only if you accept passing that close.",
)


STRUCTURE_UNREADABLE = ErrorCode(
    "PLAN-028",
    PlanError,
    "The file with a structure's points cannot be used.",
    "Give CSV rows or a JSON list of L, P, S in mm, or a 3D Slicer point list, of at most 1 MB.",
)


class UnsavedChanges(PlanError):
    """The planner ended with unsaved changes."""

    code = "PLAN-029"
    action = "Review them; Save keeps them, Undo restores the saved plan."


MARKERS_ADHESIVE = ErrorCode(
    "PLAN-030",
    PlanError,
    "The plan has adhesive markers, which only the CT shows, where a case needs spheres.",
    (
        "Implant screws with spheres or the x-shaped frame, scan again, and plan on that CT. Adhesive "
        "markers move with the skin, and neither the tracker nor the stereo head sees them."
    ),
)


class AcPcUnfit(PlanError):
    """The points given as AC, PC and midline do not define an AC-PC frame."""

    code = "PLAN-031"
    action = "Click the centres of the anterior and the posterior commissure, then a point of the midline."


class HeadPlaceUnknown(RefusedError):
    """Reach cannot be checked without the pose of the head relative to the arm."""

    code = "PLAN-032"
    action = (
        "Have the place for the cart found first, as described in the guide to the cart's place, and keep "
        "place.json next to the plan. Then check reach again."
    )


class WrongSigns(PlanError):
    """The plan does not fit the CT as written; it would with other signs, as in RAS.

    It comes after the finding about the point itself, which is the likelier one if the points were read off
    in LPS.
    """

    code = "PLAN-033"
    action = (
        "First look at the points named in the other findings. Only if you know that the points were read "
        "off so, plan again in LPS. The CT hardly tells left from right: only the side does, so compare the "
        "side of each entry with the CT."
    )


SPHERES_NOT_TRACKED = ErrorCode(
    "PLAN-034",
    RefusedError,
    "The plan's spheres cannot be seen by the tracker, which reports tools alone.",
    (
        "Fix the spheres as the x-shaped frame, with it among the tools of the tracker and fiducials = "
        '"xframe" in the plan, or use a tracker that reports single spheres.'
    ),
)


class MetalInSkull(RefusedError):
    """The CT shows metal in the skull on the way of a drill: how deep the skull is there is not known."""

    code = "PLAN-035"
    action = "Have it drilled by hand, with a stop that does not go by this CT, or plan another entry."


NO_TOOL_RECORD = ErrorCode(
    "TOOL-002",
    ConfigurationError,
    "The theatre file lacks a required tool record or has an inconsistent one.",
    "Write the record with ronna-tool define and name it in the theatre file; see ronna-tool check.",
)


FOREIGN_TOOL = ErrorCode(
    "TOOL-003",
    RefusedError,
    "A tool record refers to another flange, or to a tip calibration other than the one in use.",
    "Measure the tool on this flange, with its tip, and define it again; no motion until then.",
)


PATIENT_FRAME_UNFIT = ErrorCode(
    "TOOL-008",
    RefusedError,
    "The patient's frame is not a rigid body of its own: it has the shape of another frame in the room.",
    (
        "Load the definition of the frame on the head clamp under its name in the theatre file; the shipped "
        "one is patient_frame.rom."
    ),
)


def raise_together(findings: Sequence[RonnaError], what: str) -> None:
    """Raise a single finding as it is, or several combined into one error. Do nothing if there are none."""
    if not findings:
        return
    if len(findings) == 1:
        raise findings[0]
    if len({finding.code for finding in findings}) == 1:
        raise findings[0].reworded(
            f"{what}, {len(findings)} mistakes: "
            + "; ".join(summarize_finding(one, False) for one in findings)
        )
    raise PlanMistakes(
        f"{what}, {len(findings)} mistakes: " + "; ".join(summarize_finding(one, True) for one in findings)
    )


def summarize_finding(finding: RonnaError, with_code: bool) -> str:
    """Summarize a finding with its values, without the recommended action."""
    return f"{finding.code} {finding.summary}" if with_code else finding.summary
