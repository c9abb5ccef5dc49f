"""The registration of a loaded run in its CT: spheres as expected and as found, with a picture."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from prepared_results import checked_plan

from procedures.exchange.errors import NO_REGISTRATION
from ronna_hw import RunWarning, load_run


def test_a_registration_has_its_spheres_in_the_ct_as_expected_and_as_found(registered: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RunWarning)  # its records alone were prepared
        loaded = load_run(registered)
    found = loaded.registration("T1")
    assert found.record == loaded.registrations.record[0]
    spheres = found.spheres
    np.testing.assert_allclose(spheres.expected_ct_mm, loaded.spheres.centre_ct_mm)
    measured = loaded.localized
    for row in spheres[spheres.used]:
        place_mm = measured.centre_robot_mm[measured.sphere == row.sphere][0]
        np.testing.assert_allclose(found.robot_from_ct.apply(row.found_ct_mm), place_mm, atol=1e-9)
        assert row.residual_mm == pytest.approx(np.linalg.norm(row.found_ct_mm - row.expected_ct_mm))
    assert np.sqrt(np.square(spheres.residual_mm[spheres.used]).mean()) == pytest.approx(found.fre_mm)
    shown = found._repr_html_()  # type: ignore[attr-defined]  # as a notebook calls it
    assert "<th>residual_mm</th>" in shown
    assert "data:image/png;base64," in shown  # without its CT, which is not here
    assert loaded.plan == checked_plan().plan
    with raises(NO_REGISTRATION):
        loaded.registration("T9")
