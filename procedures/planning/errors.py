"""What can be wrong with a plan, PLAN-001 to PLAN-029.

Several errors of one check are raised as one error; when they are of one kind it has that kind's code, else
PLAN-002.
"""

from __future__ import annotations

from collections.abc import Sequence

from ronna_hw.errors import ConfigurationError, DataError, RefusedError, RonnaError


class PlanUnreadable(ConfigurationError):
    """The plan file is missing, not readable or not TOML."""

    code = "PLAN-001"
    action = "Give the path of a plan.toml that this account may read."


class PlanError(DataError):
    """Base of everything that is wrong inside a plan."""


class PlanMistakes(PlanError):
    """The plan has wrong keys or values, or several kinds of mistakes; all are listed."""

    code = "PLAN-002"
    action = "Correct every line named here; the reference lists every key."


class WrongSeries(PlanError):
    """The plan was made on a different CT series."""

    code = "PLAN-003"
    action = "Load the series that the plan was made on, or plan again on this one."


class BadTrajectoryGeometry(PlanError):
    """Entry and target are one point, or the depth is impossible."""

    code = "PLAN-004"
    action = "Correct entry and target; coordinates are LPS millimetres of the series."


class DuplicateTrajectory(PlanError):
    """Two trajectories have the same id, so neither can be referred to."""

    code = "PLAN-005"
    action = "Give every trajectory an id of its own."


class OutsideField(PlanError):
    """An entry or a target lies outside the CT."""

    code = "PLAN-006"
    action = "Check the coordinates: LPS millimetres of this series, not of another frame or in RAS."


class NotReachable(RefusedError):
    """The arm cannot take a pose of the procedure, or cannot follow the line to it."""

    code = "PLAN-007"
    action = "Change the free angle, or move the cart, the head or what is in the way, and check again."


class WrongMarkerCount(PlanError):
    """The number of fiducials in the CT differs from the number implanted."""

    code = "PLAN-008"
    action = "Look at the candidates in the CT; correct the count in the plan only after counting the screws."


class WrongOrientation(PlanError):
    """The CT was taken in a different patient position from the one in the plan."""

    code = "PLAN-009"
    action = "Find out which is right before anything else: left and right may be swapped."


class NotIntoHead(PlanError):
    """According to the CT, a trajectory does not lead from outside the head to a target inside it."""

    code = "PLAN-011"
    action = "Look at entry and target in the CT: they may be exchanged, or given in RAS."


class UnknownTool(PlanError):
    """The plan names an unknown tool."""

    code = "PLAN-012"
    action = "Name the tool that the plan was made for; another tool has another length."


class NotTheFrame(PlanError):
    """The CT does not show the x-shaped frame that the plan names, or not the whole of it."""

    code = "PLAN-013"
    action = 'Look at the spheres of the CT; for single spheres on screws plan with fiducials = "free".'


class NoHeadInCt(PlanError):
    """No head was found in the CT, so no clearance to it can be kept."""

    code = "PLAN-014"
    action = "Check that this is the CT of the head, in Hounsfield units."


class NoTemplate(PlanError):
    """No places on the head have distances that differ by the margin asked for."""

    code = "PLAN-015"
    action = "Ask for a smaller --margin or for three markers."


class HeadUnreadable(ConfigurationError):
    """The file that should describe a head does not."""

    code = "PLAN-016"
    action = "Give the output of `ronna-sim scene`, or a CT series with --ct."


class NotTheTemplate(PlanError):
    """The fiducials in the CT do not lie as the plan's template has them."""

    code = "PLAN-017"
    action = "Look whether this is the patient's template; without one, leave template_mm out of the plan."


class StandoffInsideSkin(PlanError):
    """The stand-off would hold the guide's lower end inside the skin."""

    code = "PLAN-018"
    action = "Give a larger standoff_mm; look at the entry in the CT as well."


class StopBeyondInstrument(PlanError):
    """The depth stop would sit beyond the end of the instrument."""

    code = "PLAN-019"
    action = "Plan with a longer instrument, or with a smaller standoff_mm."


class NoPlace(RefusedError):
    """From no place of the cart that was looked at can the whole plan be done."""

    code = "PLAN-020"
    action = "Look farther with --within, or change the head's place, the free angles or the --strategy."


class NoMarkerSites(PlanError):
    """The head has no room for so many markers clear of the trajectories."""

    code = "PLAN-021"
    action = "Ask for fewer --markers, or move an entry point."


class PlaceUnfit(PlanError):
    """The file of a proposed place cannot be read, or was made for another CT."""

    code = "PLAN-022"
    action = "Make it again with ronna-plan place PLAN --ct DIR --out DIR, or take it out of the case folder."


class AlteredPlan(PlanError):
    """A plan does not agree with the seal that the planner put under it."""

    code = "PLAN-023"
    action = "Open it in the planner, look at it and save it again; take the seal out if the edit is yours."


class OtherVoxels(PlanError):
    """The CT has the number of the plan's series and other voxels."""

    code = "PLAN-024"
    action = "Find out which CT is the patient's; plan again on the one that is used."


class PlanNotSaved(ConfigurationError):
    """The plan could not be written."""

    code = "PLAN-025"
    action = "Nothing is lost: the plan stays on this page. Make room or rights, then save again."


class PlanInUse(RefusedError):
    """A case is running on the plan, a run has kept it, or another planner has it open."""

    code = "PLAN-026"
    action = "Look at it as long as you like; save it when the case has ended, or under another --plan."


class NearStructure(PlanError):
    """A trajectory comes nearer to a structure than its margin allows."""

    code = "PLAN-027"
    action = "Move entry or target; give a smaller margin only if you would enter that near."


class StructureUnreadable(PlanError):
    """The file of a structure's points cannot be used."""

    code = "PLAN-028"
    action = "Give CSV rows or a JSON list of L, P, S in mm, or a 3D Slicer point list, of at most 1 MB."


class UnsavedChanges(PlanError):
    """The planner ended with changes that nobody had saved."""

    code = "PLAN-029"
    action = "Look at them; Save keeps them, Undo goes back to the plan as it was saved."


def raise_together(findings: Sequence[RonnaError], what: str) -> None:
    """Raise nothing for no findings, the finding for one, and one error that lists them for several."""
    if not findings:
        return
    if len(findings) == 1:
        raise findings[0]
    kinds = {type(finding) for finding in findings}
    if len(kinds) == 1:
        kind = kinds.pop()
        raise kind(f"{what}, {len(findings)} mistakes: " + "; ".join(brief(one, False) for one in findings))
    raise PlanMistakes(
        f"{what}, {len(findings)} mistakes: " + "; ".join(brief(one, True) for one in findings)
    )


def brief(finding: RonnaError, with_code: bool) -> str:
    """What happened, with its values, without the advice."""
    return f"{finding.code} {finding.summary}" if with_code else finding.summary
