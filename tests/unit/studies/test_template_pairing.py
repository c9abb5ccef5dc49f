"""Three and four markers placed by a template: their distances, and their pairing among outliers."""

from __future__ import annotations

import numpy as np

from studies.campaign.study import Unit
from studies.correspondence.study import condition_key
from studies.correspondence.template import MARGIN_MM, TemplateStudy, sites_mm, tables
from studies.heads import NoiseReading


def test_the_marker_distances_of_every_head_differ_by_the_margin() -> None:
    for patient in (1, 2, 3):
        for count in (3, 4):
            sites = sites_mm(patient, count, MARGIN_MM)
            apart = np.linalg.norm(sites[:, None] - sites[None], axis=2)[np.triu_indices(count, 1)]
            assert np.diff(np.sort(apart)).min() >= MARGIN_MM


def test_four_markers_by_a_template_are_paired_among_four_outliers() -> None:
    condition = condition_key(NoiseReading.PER_AXIS, 1, 4, 4)
    sums = TemplateStudy(20, seed=3).run(Unit(condition, 0, 20))
    methods = ("distances", "+ planned count", "template", "template + orientation")
    assert sums == {f"{method}|success": 20.0 for method in methods}
    (said,) = tables({condition: sums})
    assert [row[3:] for row in said.rows] == [
        (20, 0.0, "at most 14", "0-0", 0.0, "at most 14", "yes", "yes")
    ] * 4
