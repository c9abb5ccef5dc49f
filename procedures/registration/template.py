"""Known sphere layouts: pairing through a rigid template, and finding a layout in a scan.

Each side is matched to the template separately, so that the template's distances decide rather than those
between noisy points; points without a counterpart in the template are ignored on both sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.correspondence import Match, MatchStatus, PosePrior
from procedures.registration.errors import LayoutNotFound
from procedures.registration.matching import MOST_POINTS, match, validate_prior, weigh_evidence
from procedures.registration.pairings import as_hypothesis, evaluate
from procedures.registration.points import require_enough, validate_points
from ronna_hw.arrays import Array
from ronna_hw.text import format_count

Sigma = float | Sequence[float] | Array

TEMPLATE_SIGMA_MM = 0.05  # per axis: accuracy to which such a frame is made and measured

# Per axis: a scanner's scale and table feed over the width of a frame (0.1 % of 100 mm), plus noise.
SCAN_SIGMA_MM = 0.12
FEW = "Give all of them: two points leave the rotation about their line undetermined."
TOO_MANY = "Check --diameter-mm; or list the spheres of the layout in a file for --pick."


@dataclass(frozen=True)
class _TemplatePrior:
    """Image prior, applied to the template as located in the image."""

    prior: PosePrior
    image_from_template: RigidTransform

    def objection(self, rotation: Array, translation_mm: Array, physical_mm: Array) -> str:
        """State the objection to the pose physical <- image that a pose physical <- template implies."""
        turned = rotation @ self.image_from_template.rotation.as_matrix().T
        moved_mm = translation_mm - turned @ self.image_from_template.translation
        return self.prior.objection(turned, moved_mm, physical_mm)


def match_by_template(
    template_mm: ArrayLike,
    image_mm: ArrayLike,
    physical_mm: ArrayLike,
    *,
    sigma_image_mm: Sigma,
    sigma_physical_mm: Sigma,
    sigma_template_mm: float = TEMPLATE_SIGMA_MM,
    prior: PosePrior | Rotation | None = None,
) -> Match:
    """Pair image points (n, 3) with physical points (m, 3) through a template (k, 3), k >= 3, all in mm.

    UNIQUE only when all k template points are found on both sides, in exactly one way each, and the sides
    agree. The reason for a failure names the side; its runner-up then pairs template points with those of
    that side. Raises REG-001, REG-002 and REG-007.
    """
    template = validate_points(template_mm, "template")
    require_enough(template, "point(s) of a template", FEW)
    image, physical = validate_points(image_mm, "image"), validate_points(physical_mm, "physical")
    image_prior = validate_prior(prior)
    ct_match = match_template(template, image, sigma_template_mm, sigma_image_mm)
    if ct_match.transform is None or ct_match.status is not MatchStatus.UNIQUE:
        return _answer_failure(ct_match, "image", image, physical)
    template_prior = image_prior and _TemplatePrior(image_prior, ct_match.transform)
    room_match = match_template(template, physical, sigma_template_mm, sigma_physical_mm, template_prior)
    if room_match.status is not MatchStatus.UNIQUE:
        return _answer_failure(room_match, "physical", image, physical)
    in_image, in_physical = ct_match.pairs[:, 1], room_match.pairs[:, 1]
    nodes = sum(1 << int(i) * len(physical) + int(j) for i, j in zip(in_image, in_physical, strict=True))
    (pairing,) = evaluate([nodes], image, physical, weigh_evidence(sigma_image_mm, sigma_physical_mm))
    paired = as_hypothesis(pairing, len(physical))
    counts = len(image), len(physical)
    margins = [one.margin_nats for one in (ct_match, room_match) if one.margin_nats is not None]
    if not pairing.passed:
        reason = "image and physical points differ beyond the noise"
        return Match.of(MatchStatus.INCONSISTENT, reason, None, counts, runner_up=paired)
    return Match.of(
        MatchStatus.UNIQUE,
        f"all {len(template)} template points were found on both sides",
        paired,
        counts,
        margin_nats=min(margins, default=None),
    )


def match_template(
    template: ArrayLike,
    points: ArrayLike,
    sigma_template_mm: float,
    sigma_mm: Sigma,
    prior: PosePrior | None = None,
) -> Match:
    """Match a template (k, 3) to points (n, 3) among which all of it is expected, both in mm."""
    return match(
        template,
        points,
        sigma_image_mm=sigma_template_mm,
        sigma_physical_mm=sigma_mm,
        expected=len(np.asarray(template)),
        prior=prior,
    )


def _answer_failure(found: Match, side: str, image: Array, physical: Array) -> Match:
    reason = f"the template among the {side} points: {found.reason}"
    return Match.of(found.status, reason, None, (len(image), len(physical)), runner_up=found.runner_up)


@dataclass(frozen=True, eq=False)
class FoundLayout:
    """Layout found in a scan: `order` (k,) gives the scan index of each layout sphere."""

    order: NDArray[np.intp]
    scan_from_layout: RigidTransform
    residual_rms_mm: float
    others: tuple[int, ...]


def find_layout(layout_mm: ArrayLike, spheres_mm: ArrayLike) -> FoundLayout:
    """Find a layout (k, 3), k >= 3, among the spheres (n, 3) of a scan, both in mm.

    Every sphere of the layout must be present, in exactly one way, each where the others predict it to within
    the scanner's accuracy. Raises REG-012, REG-001, REG-002.
    """
    layout, spheres = validate_points(layout_mm, "layout"), validate_points(spheres_mm, "scan")
    require_enough(layout, "sphere(s) of a layout", FEW)
    if len(spheres) > MOST_POINTS:
        raise LayoutNotFound(
            "the scan shows too many spheres to search it for a layout",
            expected=f"at most {MOST_POINTS}",
            got=str(len(spheres)),
            action=TOO_MANY,
        )
    found = match_template(layout, spheres, TEMPLATE_SIGMA_MM, SCAN_SIGMA_MM)
    if found.transform is None or found.status is not MatchStatus.UNIQUE:
        is_ambiguous = found.status is MatchStatus.AMBIGUOUS
        raise LayoutNotFound(
            "the layout fits the scan in more than one way"
            if is_ambiguous
            else "the scan does not show the whole layout",
            expected=f"all {len(layout)} spheres of the layout, up to {_width_mm(layout):.1f} mm apart",
            got=f"{format_count(len(spheres), 'sphere')}, up to {_width_mm(spheres):.1f} mm apart",
        )
    order = found.pairs[np.argsort(found.pairs[:, 0]), 1]
    residuals_mm = np.linalg.norm(found.transform.apply(layout) - spheres[order], axis=1)
    rms_mm = float(np.sqrt(np.mean(np.square(residuals_mm))))
    return FoundLayout(order, found.transform, rms_mm, found.unmatched_physical)


def _width_mm(points_mm: Array) -> float:
    """Return the largest distance between two points, which reveals a wrong unit."""
    return float(pdist(points_mm).max(initial=0.0))
