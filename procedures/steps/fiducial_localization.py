"""Find the spheres in the CT."""

from __future__ import annotations

from procedures.engine.case import PICTURES_FOLDER
from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.imaging.localization import localize
from procedures.imaging.markers import Marker
from procedures.imaging.pictures import marker_pictures
from procedures.imaging.series import read_series
from procedures.steps.ct_import import VOLUME
from ronna_hw.records import write_whole


def run(context: StepContext) -> Outcome:
    """Localize every sphere; how many there must be is the plan's word, checked with the plan."""
    volume = context.workspace.get(VOLUME) or read_series(context.case.series)
    found = localize(volume, progress=lambda share: context.progress(share, "localizing the spheres"))
    pictures = context.case.folder / PICTURES_FOLDER
    pictures.mkdir(exist_ok=True)
    for number, picture in enumerate(marker_pictures(volume, found), start=1):
        write_whole(pictures / f"ct-{number}.png", picture)
    return Outcome(
        payload={
            "series_instance_uid": found.series_instance_uid,
            "diameter_mm": found.diameter_mm,
            "markers": [_payload(marker) for marker in found.markers],
            "candidates_refused": sum(not candidate.accepted for candidate in found.candidates),
        },
        parents=(context.case.get("ct_import"),),
        summary=f"{len(found.markers)} spheres",
    )


def _payload(marker: Marker) -> dict[str, object]:
    return {
        "centre_mm": marker.centre_mm.tolist(),
        "covariance_mm2": marker.covariance_mm2.tolist(),
        "radius_mm": float(marker.radius_mm),
        "quality": float(marker.quality),
        "agreement_mm": float(marker.agreement_mm),
        "flags": list(marker.flags),
    }


STEP = StepSpec("fiducial_localization", "Localize the spheres in the CT", needs=("ct_import",), run=run)
