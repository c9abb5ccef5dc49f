"""Look at one place on the skin: the projector's line in a few places across, seen by the stereo head."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from procedures.engine.context import StepContext
from procedures.registration.surface.errors import NOTHING_LIT
from procedures.relocalization.errors import Saturated
from procedures.relocalization.triangulation import camera_model
from procedures.room.sighting import Tracked
from procedures.steps.clinical.path_check import LocalizationPose
from procedures.steps.clinical.results import UPPER, ScannedLine, ScannedLook
from procedures.steps.clinical.room import check_room
from procedures.workcell import Workcell
from procedures.workcell.centring import Centring
from procedures.workcell.line_look import LineLook
from ronna_hw.arm.errors import NotClear, OutOfJointRange, Singular, Unreachable
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError, is_error
from ronna_hw.text import format_count
from ronna_hw.vectors import vector3

SMALL_STEPS = "the small steps across each place on the skin"
ACROSS_MM = (-9.0, -3.0, 3.0, 9.0)  # places of the line across a look, along the tool's y axis
CHECKED_LOOKS = 3  # between two looks at which the tracker looks at the room; the guards watch all motions
FEWEST_DARK = 5  # looks in a row without a line that end a scan; whole cases had two dark ones at most
DECIMALS = 4  # of a point in the record, mm
LEFT_OUT = (NotClear, OutOfJointRange, Singular, Unreachable)
SATURATED, DARK, UNREACHED = "saturated", "dark", "unreached"  # looks without a line
LESS_LIGHT = (
    "Too much light reaches a camera: shorten the exposure or lower the gain, turn lamps away from the head "
    "and shade it from the sun; then scan again."
)
GONE_OUT = (
    "Check that the projector still lights, that its window is clean, and that no drape has fallen over the "
    "face."
)
LOOKS_KEPT = (
    "The looks that show the line are kept: resume the run, or repeat the step, and the others are taken."
)
LINE_MM = 23.0  # length of a line on the skin, as usual on simulated heads
# Length with half of it hidden.
# Safety against a hand or a drape that hides skin without being measured. Source: simulated heads.
SHORT_MM = 12.0


class LookScanner:
    """Scans one place on the skin: on to it, then across it in small steps."""

    def __init__(
        self,
        context: StepContext,
        number: int,
        look: LocalizationPose,
        centring: Centring,
        across_mm: Sequence[float] = ACROSS_MM,
    ) -> None:
        self._context, self._number, self._look = context, number, look
        self._centring, self._sides, self._across_mm = centring, centring.arriving, across_mm
        self._problem: RonnaError | None = None

    @property
    def reason(self) -> str:
        """Why a line does not show, if one does not."""
        return "" if self._problem is None else self._problem.summary

    @property
    def code(self) -> str:
        """Code of the reason."""
        return "" if self._problem is None else self._problem.code

    def scan(self) -> list[ScannedLine]:
        """Return the lines that show, with `reason` for those that do not."""
        workcell, pose = self._context.workcell, self._look.tool_pose.transform
        lines: list[ScannedLine] = []
        for place, across_mm in enumerate(self._across_mm):
            here = pose.displace(pose.rotation_matrix[:, 1] * across_mm)
            try:
                self._centring.go_over(here, self._look.approach_rad)
            except RonnaError as problem:
                if not is_error(problem, *LEFT_OUT):
                    raise
                self._problem = self._problem or problem  # what a picture shows says more
                continue
            if place == 0 and self._number % CHECKED_LOOKS == 0:
                name = f"at look {self._number + 1}"
                check_room(self._context, name, sides={Tracked.ARM: self._sides})
            seen = workcell.look_at_line()
            if seen.points is None or not len(seen.points.points_mm):
                self._problem = seen.problem
            else:
                lines.append(self._record(seen))
        return lines

    def _record(self, seen: LineLook) -> ScannedLine:
        workcell, found = self._context.workcell, seen.points
        assert found is not None
        joints_rad = workcell.master.joints_rad()
        pose = workcell.master.tool_pose(joints_rad, self._sides)
        view_mm = camera_model(workcell.calibrations.stereo_head.left).centre_mm
        turn = pose.rotation_matrix
        return ScannedLine(
            look=self._number,
            joints_rad=joints_rad,
            view_mm=vector3(_rounded(pose.apply(view_mm))),
            points_mm=_rounded(pose.apply(found.points_mm)).tolist(),
            covariances_mm2=_upper(turn @ found.covariance_mm2 @ turn.T).tolist(),
        )


def read_time_s(workcell: Workcell) -> float:
    """Return the theatre time of a reading: a replay has no other."""
    workcell.master.joints_rad()
    return workcell.clock.now_s()


def is_dark_so_far(looks: Sequence[ScannedLook], planned: int, fewest: int) -> bool:
    """Return whether no look has shown a line, and those to come are too few: `fewest` have to show one.

    A few looks at hair or beside the head may be dark; a projector that does not light leaves all dark.
    """
    return len(looks) >= max(planned - fewest + 1, FEWEST_DARK) and not any(one.lines for one in looks)


def has_gone_out(looks: Sequence[ScannedLook]) -> bool:
    """Return whether a line that showed shows no more: hair is behind a few looks in a row, not so many."""
    return any(one.lines for one in looks) and len(_unlit_at_end(looks)) >= FEWEST_DARK


def require_line_to_the_end(looks: Sequence[ScannedLook], planned: int) -> None:
    """Raise SRF-032 if a line that showed shows no more, in the order in which the looks were taken."""
    if not has_gone_out(looks):
        return
    unlit = _unlit_at_end(looks)
    what = f"the line showed at first, and not at the last {len(unlit)} looks"
    raise _refuse_unlit(what, unlit, planned, GONE_OUT, LOOKS_KEPT)


def _unlit_at_end(looks: Sequence[ScannedLook]) -> list[ScannedLook]:
    """Return the last looks without a line, but those that the arm could not take: they say nothing of it."""
    tried = [one for one in looks if one.lines or _kind_of(one) != UNREACHED]
    return list(takewhile(lambda one: not one.lines, reversed(tried)))[::-1]


def require_lines(looks: Sequence[ScannedLook], planned: int) -> None:
    """Raise SRF-032 if no look shows a line, for saturated pictures as such."""
    if any(one.lines for one in looks):
        return
    none = "no look shows" if len(looks) >= planned else f"none of the first {len(looks)} looks shows"
    raise _refuse_unlit(f"{none} the line", looks, planned)


def _refuse_unlit(
    what: str, unlit: Sequence[ScannedLook], planned: int, if_dark: str = NOTHING_LIT.action, then: str = ""
) -> RonnaError:
    """Return SRF-032 for looks without a line, by what most of them that the arm could take have shown.

    `if_dark` is what to do if they are dark, and `then` what follows in any case.
    """
    by_kind = {kind: [one for one in unlit if _kind_of(one) == kind] for kind in (SATURATED, DARK, UNREACHED)}
    is_saturated = len(by_kind[SATURATED]) > len(by_kind[DARK])
    first = by_kind[SATURATED if is_saturated else DARK] or unlit
    counted = [format_count(len(found), f"{kind} look") for kind, found in by_kind.items() if found]
    return NOTHING_LIT(
        f"{what}: {first[0].reason or 'nothing'}",
        expected="a line",
        got=f"{', '.join(counted)} of {planned} planned",
        action=f"{LESS_LIGHT if is_saturated else if_dark} {then}".rstrip(),
    )


def _kind_of(unlit: ScannedLook) -> str:
    if unlit.code == Saturated.code:
        return SATURATED
    return UNREACHED if unlit.code in {one.code for one in LEFT_OUT} else DARK


def describe_short(lines: Sequence[ScannedLine]) -> str | None:
    """Say that half of the lines are short, if so: a hand off the skin hides it without being measured."""
    length_mm = float(np.median([np.linalg.norm(np.ptp(one.points_mm, axis=0)) for one in lines]))
    if length_mm >= SHORT_MM:
        return None
    return (
        f"half of the lines show less than {length_mm:.0f} mm of skin, usually {LINE_MM:.0f} mm: "
        "look for a hand, a drape or hair before the stereo head; the rest counts, with the error it leaves"
    )


def _rounded(points_mm: Array) -> Array:
    return np.asarray(np.round(points_mm, DECIMALS))


def _upper(covariance_mm2: Array) -> Array:
    return np.asarray(covariance_mm2[:, UPPER[0], UPPER[1]])
