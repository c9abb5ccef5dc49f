"""Tool records in the theatre file, and checks of their consistency."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import combinations

from procedures.planning.errors import FOREIGN_TOOL, NO_TOOL_RECORD, PATIENT_FRAME_UNFIT
from ronna_hw.calibration import STEREO_HEAD_NUMBER
from ronna_hw.config import Calibrations, TheatreFile
from ronna_hw.devices.errors import UnknownTool
from ronna_hw.mistakes import suggest_alike
from ronna_hw.tool_record import GUIDES, Gauge, GuideBore, ToolRecord
from ronna_hw.x_frame import SPHERE_CENTRES_MM

# Far below the error of any tip, and above the rounding of a written number.
# Safety against a record of another tip. Source: the rounding of a written number.
SAME_TIP_MM = 0.001
SAME_TIP_RAD = math.radians(0.001)

RENEW = "Read the gauge with this tool, then run ronna-tool renew, which updates the record for that tip."
SAME_BODY_MM = 2.0  # between distances of markers: closer ones are the same to a tracker
Markers = Mapping[str, Sequence[Sequence[float]]]  # of each tool by name, mm, in its own frame
GUIDE, STEREO_HEAD = "guide", "stereo_head"  # names in the theatre file


@dataclass(frozen=True)
class GuideRecord:
    """Record of the guide, with bore and gauge."""

    record: ToolRecord
    bore: GuideBore
    gauge: Gauge


@dataclass(frozen=True)
class ToolRecords:
    """Tool records by name, and the flange on which the tools must have been measured.

    While `calibrating` the tip, its record may refer to a former one.
    """

    records: Mapping[str, ToolRecord]
    flange: str
    calibrating: bool = False

    @classmethod
    def of(cls, file: TheatreFile, *, calibrating: bool = False) -> ToolRecords:
        """Read the tool records from a theatre file."""
        return cls(file.tools, file.flange, calibrating)

    @property
    def guide(self) -> GuideRecord:
        """Record of the guide. Raises TOOL-002 if it is missing or describes another kind of tool."""
        found = self.records.get(GUIDE)
        if found is None:
            raise NO_TOOL_RECORD("the theatre file has no record of the guide", expected=f"[tools.{GUIDE}]")
        if found.purpose not in GUIDES or found.bore is None or found.gauge is None:
            raise NO_TOOL_RECORD(
                f"tool record {found.identifier} is not that of a guide",
                expected=" or ".join(one.value for one in GUIDES),
                got=found.purpose.value,
            )
        return GuideRecord(found, found.bore, found.gauge)

    def check(self, calibrations: Calibrations, moment: datetime) -> None:
        """Check all records. Raises CAL-001 if one is not valid at this moment, TOOL-002, TOOL-003."""
        for name, record in self.records.items():
            record.check_valid_at(moment)
            check_flange(record, self.flange)
            numbers = {GUIDE: calibrations.tool_tip.tool_number, STEREO_HEAD: STEREO_HEAD_NUMBER}
            if record.number != numbers.get(name, record.number):
                raise NO_TOOL_RECORD(
                    f"tool record {record.identifier} has a different number from the {name}",
                    expected=str(numbers[name]),
                    got=str(record.number),
                )
        guide = self.guide.record
        if not self.calibrating:
            check_tip(guide, calibrations)

    def check_frames(self, calibrations: Calibrations, tracked: Sequence[str]) -> None:
        """Raise DEV-003 if a record refers to a frame that is not among the tracker's tools."""
        named = {key.rpartition(".")[0]: frame for key, frame in calibrations.frames.items()} | {
            f"tools.{name}.frame": record.frame.tool
            for name, record in self.records.items()
            if record.frame is not None
        }
        for table, frame in named.items():
            if frame not in tracked:
                raise UnknownTool(
                    f"[{table}] names {frame}, which is not among the tracker's tools"
                    f"{suggest_alike(frame, tracked)}",
                    expected=" or ".join(tracked) or "none",
                )


def check_patient_frame(name: str, calibrations: Calibrations, markers_mm: Markers) -> None:
    """Check the patient's frame among the tracker's tools, whose markers are given by name.

    Raises DEV-003 if it is not one of them, TOOL-008 if it has the shape of the frame on the arm or of the
    frame on the skull.
    """
    if name not in markers_mm:
        raise UnknownTool(
            f"[procedure] patient_frame names {name}, which is not among the tracker's tools",
            expected=" or ".join(markers_mm) or "none",
        )
    on_arm = calibrations.tracker_frame.tool
    others = {on_arm: markers_mm.get(on_arm, ()), "the x-shaped frame on the skull": SPHERE_CENTRES_MM}
    own_mm = _distances_mm(markers_mm[name])
    for other, markers in others.items():
        theirs_mm = _distances_mm(markers)
        if len(own_mm) != len(theirs_mm):
            continue
        apart_mm = max(abs(own - their) for own, their in zip(own_mm, theirs_mm, strict=True))
        if apart_mm < SAME_BODY_MM:
            raise PATIENT_FRAME_UNFIT(
                f"the definition of {name} is that of {other}: the tracker cannot tell them apart",
                limit=f"{SAME_BODY_MM:g} mm between marker distances",
                got=f"{apart_mm:.2f} mm",
            )


def _distances_mm(markers_mm: Sequence[Sequence[float]]) -> list[float]:
    return sorted(math.dist(one, other) for one, other in combinations(markers_mm, 2))


def check_flange(record: ToolRecord, flange: str) -> None:
    """Raise TOOL-003 unless a tool was measured on this flange."""
    if record.flange != flange:
        raise FOREIGN_TOOL(
            f"tool record {record.identifier} belongs to another flange",
            expected=flange or "a name: the theatre file has no key `flange`",
            got=record.flange,
        )


def check_tip(record: ToolRecord, calibrations: Calibrations) -> None:
    """Raise TOOL-003 unless a tool's record refers to this tip calibration and has the same values."""
    tip = calibrations.tool_tip
    if record.tip != tip.identifier:
        raise FOREIGN_TOOL(
            f"tool record {record.identifier} refers to another calibration of its tip",
            expected=tip.identifier,
            got=record.tip or "none",
            action=RENEW,
        )
    if record.tip_in_head is None:  # written by hand, or by a version that did not know it
        return
    off_mm, off_rad = record.tip_in_head.off(calibrations.tip_in_head)
    if off_mm > SAME_TIP_MM or off_rad > SAME_TIP_RAD:
        raise FOREIGN_TOOL(
            f"{tip.identifier} has other numbers than when the gauge of {record.identifier} was read: "
            "its tip is elsewhere relative to the stereo head",
            limit=f"{SAME_TIP_MM:g} mm, {math.degrees(SAME_TIP_RAD):g} deg",
            got=f"{off_mm:.3f} mm, {math.degrees(off_rad):.3f} deg",
            action=f"Restore [calibration.tool_tip] and [calibration.stereo_head]. If they are right: "
            f"{RENEW}",
        )
