"""The patient ID of a phantom's CT names its scene and seed."""

from __future__ import annotations

import pytest

from ronna_hw.phantom_identity import LARGEST_ID, format_patient_id, parse_patient_id


def test_scene_and_seed_are_read_back_from_the_patient_id() -> None:
    assert format_patient_id("mini", 7) == "mini-7"
    assert parse_patient_id(format_patient_id("our-scene", 7)) == ("our-scene", 7)


def test_a_long_scene_name_leaves_the_seed_whole() -> None:
    patient_id = format_patient_id("s" * 100, 65535)
    assert len(patient_id) == LARGEST_ID
    assert parse_patient_id(patient_id) == ("s" * 58, 65535)


@pytest.mark.parametrize("patient_id", ["", "4711", "-7", "Novak-A", "mini-"])
def test_the_id_of_another_patient_names_no_scene(patient_id: str) -> None:
    assert parse_patient_id(patient_id) is None
