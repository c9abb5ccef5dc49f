"""A CT as one self-contained HTML page: three scrollable planes, what was found, coordinates on click."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

from procedures.imaging.doubts import EVEN
from procedures.imaging.markers import Candidate, Marker
from procedures.imaging.page.view_volume import BRIGHTEST_HU, DARKEST_HU, mosaic, view_volume
from procedures.imaging.volume import Volume

TEMPLATE = "ct.html.j2"


def ct_page(
    volume: Volume, name: str, markers: Sequence[Marker], candidates: Sequence[Candidate], outcome: str
) -> str:
    """The page. `name` is the heading, `outcome` one sentence on the search; neither names a patient.

    Positions are LPS mm. Doubtful and rejected candidates are shown apart, with reasons and odds.
    """
    import jinja2

    view = view_volume(volume)
    geometry = view.geometry
    picture, across = mosaic(view)
    left = [one for one in candidates if not one.accepted]
    content: dict[str, Any] = {
        "shape": geometry.shape,
        "spacing_mm": geometry.spacing_mm.tolist(),
        "origin_mm": geometry.origin_mm.tolist(),
        "axes": geometry.axes.tolist(),
        "orientation": geometry.orientation,
        "hu": [DARKEST_HU, BRIGHTEST_HU],
        "across": across,
        "mosaic": base64.b64encode(picture).decode(),
        "found": [*map(_marker, range(1, len(markers) + 1), markers)],
        "doubtful": _candidates("doubtful", [one for one in left if one.doubtful]),
        "rejected": _candidates("rejected", [one for one in left if not one.doubtful]),
    }
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("procedures.imaging.page", "template"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(TEMPLATE).render(
        name=name, outcome=outcome, warnings=volume.warnings, even=EVEN, content=content
    )


def _marker(number: int, marker: Marker) -> dict[str, Any]:
    sigma_mm = float(marker.covariance_mm2.trace()) ** 0.5
    remarks = [f"sigma {sigma_mm:.3f} mm", f"quality {marker.quality:.2f}", *marker.flags]
    return {
        "name": f"marker {number}",
        "centre_mm": marker.centre_mm.tolist(),
        "radius_mm": marker.radius_mm,
        "odds": marker.odds,
        "remarks": ", ".join(remarks),
    }


def _candidates(word: str, candidates: Sequence[Candidate]) -> list[dict[str, Any]]:
    return [
        {
            "name": f"{word} {number}",
            "centre_mm": list(one.centre_mm),
            "radius_mm": one.radius_mm,
            "odds": one.odds,
            "remarks": one.reason,
        }
        for number, one in enumerate(candidates, start=1)
    ]
