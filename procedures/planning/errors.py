"""Errors in plans, PLAN-001 to PLAN-032, and in tool records, TOOL-002 and TOOL-003.

Several errors of one check are raised as one error; if they are all of one kind it has that kind's
code, otherwise PLAN-002.
"""

from __future__ import annotations

from collections.abc import Sequence

from ronna_hw.errors import ConfigurationError, DataError, RefusedError, RonnaError


class PlanUnreadable(ConfigurationError):
    """The plan file is missing, unreadable or not valid TOML."""

    code = "PLAN-001"
    action = "Give the path of a readable plan.toml, or correct the line that is quoted."


class PlanError(DataError):
    """Base class of all errors in a plan."""


class PlanMistakes(PlanError):
    """The plan has invalid keys or values, or several kinds of mistakes, all listed in the message."""

    code = "PLAN-002"
    action = "Correct every line listed; docs/reference/plan-file.md describes every key."


class WrongSeries(PlanError):
    """The plan belongs to a different CT series."""

    code = "PLAN-003"
    action = (
        "Load the series that the plan was made on (with --sim: give --scene and --seed of the run that it "
        "came from), or re-plan on this one."
    )


class BadTrajectoryGeometry(PlanError):
    """Entry and target coincide, or the depth is impossible."""

    code = "PLAN-004"
    action = "Correct entry and target; coordinates are LPS millimetres of the series."


class DuplicateTrajectory(PlanError):
    """Two trajectories have the same id and cannot be told apart."""

    code = "PLAN-005"
    action = "Give every trajectory a unique id."


class OutsideField(PlanError):
    """An entry or target is outside the CT."""

    code = "PLAN-006"
    action = "Check the coordinates: LPS millimetres of this series, not of another frame or in RAS."


class NotReachable(RefusedError):
    """The arm cannot reach a pose of the procedure, or cannot follow the line to it."""

    code = "PLAN-007"
    action = (
        "Change the free angle, move the cart, the head or the obstacle, or give the arm a wider range in "
        "the theatre file; then check again."
    )


class WrongMarkerCount(PlanError):
    """The number of fiducials in the CT differs from the number implanted."""

    code = "PLAN-008"
    action = "Look at the candidates in the CT; correct the count in the plan only after counting the screws."


class WrongOrientation(PlanError):
    """The CT was acquired in a different patient position from the plan's."""

    code = "PLAN-009"
    action = "First find out which is right: left and right may be swapped."


class NotIntoHead(PlanError):
    """According to the CT, a trajectory does not lead from outside the head to a target inside it."""

    code = "PLAN-011"
    action = "Check entry and target in the CT: they may be swapped, or given in RAS."


class UnknownTool(PlanError):
    """The plan names an unknown tool."""

    code = "PLAN-012"
    action = "Name the tool that the plan was made for; other tools have other lengths."


class NotTheFrame(PlanError):
    """The CT shows only part of the planned x-shaped frame, or none of it."""

    code = "PLAN-013"
    action = 'Check the spheres in the CT; for single spheres on screws, set fiducials = "free".'


class NoHeadInCt(PlanError):
    """No head was found in the CT, so clearance to it cannot be checked."""

    code = "PLAN-014"
    action = "Check that this is the CT of the head, in Hounsfield units."


class NoTemplate(PlanError):
    """No set of positions on the head has distances that differ by the requested margin."""

    code = "PLAN-015"
    action = "Ask for a smaller --margin or for three markers."


class HeadUnreadable(ConfigurationError):
    """The file does not describe a head."""

    code = "PLAN-016"
    action = "Give the output of `ronna-sim scene`, or theatre/scene.json of a simulated run."


class NotTheTemplate(PlanError):
    """The fiducials in the CT do not match the plan's template."""

    code = "PLAN-017"
    action = "Check that this is the patient's template; if there is none, remove template_mm from the plan."


class StandoffInsideSkin(PlanError):
    """The stand-off would place the guide's lower end inside the skin."""

    code = "PLAN-018"
    action = "Set a larger standoff_mm; also check the entry in the CT."


class StopBeyondInstrument(PlanError):
    """The depth stop would be beyond the end of the instrument."""

    code = "PLAN-019"
    action = "Plan with a longer instrument or a smaller standoff_mm."


class NoPlace(RefusedError):
    """None of the cart positions examined allows the whole plan to be executed."""

    code = "PLAN-020"
    action = "Search farther with --within, or change the head position, the free angles or the --strategy."


class NoMarkerSites(PlanError):
    """The head has no room for that many markers clear of the trajectories."""

    code = "PLAN-021"
    action = "Ask for fewer --markers, or move an entry point."


class PlaceUnfit(PlanError):
    """The file with the proposed cart position is unreadable or belongs to another CT."""

    code = "PLAN-022"
    action = "Make it again with ronna-plan place PLAN --ct DIR --out DIR, or remove it from the case folder."


class AlteredPlan(PlanError):
    """The plan does not match its planner seal."""

    code = "PLAN-023"
    action = "Open it in the planner, review it and save it again; remove the seal if the edit is yours."


class OtherVoxels(PlanError):
    """The CT has the plan's series UID but different voxels."""

    code = "PLAN-024"
    action = "Find out which CT is the patient's; re-plan on the one that is used."


class PlanNotSaved(ConfigurationError):
    """The plan cannot be saved."""

    code = "PLAN-025"
    action = (
        "Nothing is lost: the plan stays on this page. Free space or fix the permissions, then save again."
    )


class PlanInUse(RefusedError):
    """The plan is used by a running case, part of a run folder, or open in another planner."""

    code = "PLAN-026"
    action = "You can still view it; save it when the case has ended or the other planner is closed."


class NearStructure(PlanError):
    """A trajectory comes closer to a structure than its margin allows."""

    code = "PLAN-027"
    action = "Move entry or target; reduce the margin only if you accept passing that close."


class StructureUnreadable(PlanError):
    """The file with a structure's points cannot be used."""

    code = "PLAN-028"
    action = "Give CSV rows or a JSON list of L, P, S in mm, or a 3D Slicer point list, of at most 1 MB."


class UnsavedChanges(PlanError):
    """The planner ended with unsaved changes."""

    code = "PLAN-029"
    action = "Review them; Save keeps them, Undo restores the saved plan."


class MarkersAdhesive(PlanError):
    """The plan has adhesive markers, which only the CT shows, where a case needs spheres."""

    code = "PLAN-030"
    action = (
        "Implant screws with spheres or the x-shaped frame, scan again, and plan on that CT. Adhesive "
        "markers move with the skin, and neither the tracker nor the stereo head sees them."
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


class NoToolRecord(ConfigurationError):
    """The theatre file lacks a required tool record or has an inconsistent one."""

    code = "TOOL-002"
    action = "Write the record with ronna-tool define and name it in the theatre file; see ronna-tool check."


class ForeignTool(RefusedError):
    """A tool record refers to another flange, or to a tip calibration other than the one in use."""

    code = "TOOL-003"
    action = "Measure the tool on this flange, with its tip, and define it again; no motion until then."


class PatientFrameUnfit(RefusedError):
    """The patient's frame is not a rigid body of its own: it has the shape of another frame in the room."""

    code = "TOOL-008"
    action = (
        "Load the definition of the frame on the head clamp under its name in the theatre file; the shipped "
        "one is patient_frame.rom."
    )


def raise_together(findings: Sequence[RonnaError], what: str) -> None:
    """Raise a single finding as it is, or several combined into one error. Do nothing if there are none."""
    if not findings:
        return
    if len(findings) == 1:
        raise findings[0]
    kinds = {type(finding) for finding in findings}
    if len(kinds) == 1:
        kind = kinds.pop()
        raise kind(
            f"{what}, {len(findings)} mistakes: "
            + "; ".join(summarize_finding(one, False) for one in findings)
        )
    raise PlanMistakes(
        f"{what}, {len(findings)} mistakes: " + "; ".join(summarize_finding(one, True) for one in findings)
    )


def summarize_finding(finding: RonnaError, with_code: bool) -> str:
    """Summarize a finding with its values, without the recommended action."""
    return f"{finding.code} {finding.summary}" if with_code else finding.summary
