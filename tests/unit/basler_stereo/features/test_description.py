"""The camera's own description: where it is stored, and which XML is accepted."""

from __future__ import annotations

import io
import zipfile

import pytest

from drivers.basler_stereo.errors import BadDescription
from drivers.basler_stereo.features.description import parse_description, parse_url, unzip_description

GOOD = b"""<?xml version="1.0"?>
<RegisterDescription xmlns="http://www.genicam.org/GenApi/Version_1_1">
 <Group Comment="a group"><Integer Name="Width"><pValue>WidthReg</pValue></Integer></Group>
 <IntReg Name="WidthReg"><Address>0x100</Address><Length>4</Length></IntReg>
 <Enumeration Name="Mode"><EnumEntry Name="On"><Value>0x1</Value></EnumEntry><pValue>R</pValue></Enumeration>
</RegisterDescription>"""


def test_nodes_are_found_by_name_inside_groups_and_without_namespace():
    nodes = parse_description(GOOD)
    assert nodes["Width"].text("pValue") == "WidthReg"
    assert nodes["WidthReg"].kind == "IntReg"
    assert nodes["Mode"].entries == {"On": 1}
    assert nodes["Mode"].text("Value") is None


@pytest.mark.parametrize(
    "data",
    [
        b"",
        GOOD[:-30],
        b"<Other/>",
        GOOD.replace(b"0x1<", b"one<"),
        GOOD.replace(b"<Register", b'<!DOCTYPE x [<!ENTITY a "b">]><Register', 1),
        b"\x00\x01binary",
    ],
    ids=["empty", "cut off", "other root", "bad number", "document type", "not XML"],
)
def test_an_invalid_description_is_refused(data):
    with pytest.raises(BadDescription, match="GEV-009"):
        parse_description(data)


@pytest.mark.parametrize(
    "url", ["Local:cam.xml;100000;4ed4", "local:///cam.xml;100000;4ed4?SchemaVersion=1.1.0"]
)
def test_the_address_of_a_description_on_the_camera_is_parsed(url):
    assert parse_url(url) == ("cam.xml", 0x100000, 0x4ED4)


@pytest.mark.parametrize(
    "url",
    [
        "Local:cam.xml",
        "Local:cam.xml;zz;10",
        "Local:cam.xml;0;0",
        "Local:c;0;ffffffff",
        "Local:c;1ffffffff;10",
        "Local:c;-4;10",
        "Local:c;0;1" + "0" * 5000,
    ],
)
def test_an_invalid_address_is_refused(url):
    with pytest.raises(BadDescription, match="GEV-009"):
        parse_url(url)


def test_a_packed_description_is_unpacked_and_a_broken_one_refused():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("cam.xml", GOOD)
    assert unzip_description(file.getvalue()) == GOOD
    with pytest.raises(BadDescription, match="GEV-009"):
        unzip_description(file.getvalue()[:40])


def test_a_packed_description_that_expands_too_far_is_refused():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("cam.xml", bytes(9 * 1024 * 1024))
    with pytest.raises(BadDescription, match="expands beyond the limit"):
        unzip_description(file.getvalue())
