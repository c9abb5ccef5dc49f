"""The measuring volume as described by the unit."""

from dataclasses import replace

import pytest

from drivers.ndi_polaris.errors import MalformedReply
from drivers.ndi_polaris.measuring_volume import parse_volumes

ANSWER = (
    "25-240000-153200-095000+057200+039800+056946+024303+029773+999999+99999924\n"
    "5-300000-153200-095000+057200+039800+056946+024303+029773+999999+07350024\n"
)

# half extents (x, y) at depth z, from the published table
SECTIONS = {
    "pyramid": {
        -950: (224.72, 240.57),
        -1532: (398.0, 572.0),
        -2000: (537.34, 685.74),
        -2400: (656.43, 782.95),
    },
    "extended": {-950: (224.72, 240.57), -2664: (735.0, 847.11), -3000: (735.0, 928.77)},
}


@pytest.mark.parametrize(
    ("index", "z", "half_x", "half_y"),
    [
        (index, z, *halves)
        for index, sections in enumerate(SECTIONS.values())
        for z, halves in sections.items()
    ],
)
def test_the_sections_of_both_volumes_have_the_published_size(
    index: int, z: float, half_x: float, half_y: float
) -> None:
    volume = parse_volumes(ANSWER)[index]
    for x, y in ((half_x, half_y), (-half_x, half_y), (half_x, -half_y)):
        assert volume.contains((x * 0.9999, y * 0.9999, z)) is True
        assert volume.contains((x * 1.0005, y * 0.9, z)) is False
        assert volume.contains((x * 0.9, y * 1.0005, z)) is False


def test_points_in_front_of_or_behind_a_volume_are_outside() -> None:
    pyramid, extended = parse_volumes(ANSWER)
    assert pyramid.contains((0, 0, -949)) is False
    assert pyramid.contains((0, 0, -2401)) is False
    assert extended.contains((0, 0, -2401)) is True
    assert extended.contains((0, 0, 1500)) is False


def test_containment_in_a_shape_without_a_known_formula_is_unknown() -> None:
    (volume,) = parse_volumes("1" + ANSWER[1:].split("\n")[0].replace("5-", "7-", 1) + "\n")
    assert volume.contains((0, 0, -1500)) is None


@pytest.mark.parametrize("text", ["", "0", "3" + ANSWER[1:], "1x" + ANSWER[2:80], "25-2400"])
def test_a_malformed_volume_reply_is_refused(text: str) -> None:
    with pytest.raises(MalformedReply):
        parse_volumes(text)


def test_a_record_padded_before_its_line_feed_is_read() -> None:
    assert parse_volumes(ANSWER.replace("\n", "   \n")) == parse_volumes(ANSWER)


def test_a_volumes_faces_bend_at_the_knee_and_where_the_width_is_capped() -> None:
    pyramid, extended = parse_volumes(ANSWER)
    assert [round(z) for z, _, _ in pyramid.sections_mm] == [-950, -1532, -2400]
    assert [round(z) for z, _, _ in extended.sections_mm] == [-950, -1532, -2664, -3000]
    for z, half_x, half_y in (*pyramid.sections_mm, *extended.sections_mm):
        published = {**SECTIONS["pyramid"], **SECTIONS["extended"]}[round(z)]
        assert (half_x, half_y) == pytest.approx(published, abs=0.3)
    assert replace(pyramid, shape="7").sections_mm == ()
