"""A camera's own description is fetched and read strictly; hostile ones are refused at bounded cost."""

from __future__ import annotations

import io
import struct
import zipfile

import pytest
from bounded_cost import bounded_cost
from coded_errors import raises

from drivers.basler_stereo.errors import BAD_DESCRIPTION
from drivers.basler_stereo.features.description import parse_description, parse_url, unzip_description
from drivers.basler_stereo.features.feature_map import FeatureMap
from drivers.basler_stereo.features.formula import evaluate

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
    with raises(BAD_DESCRIPTION, match="GEV-009"):
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
    with raises(BAD_DESCRIPTION, match="GEV-009"):
        parse_url(url)


def test_a_packed_description_is_unpacked_and_a_broken_one_refused():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("cam.xml", GOOD)
    assert unzip_description(file.getvalue()) == GOOD
    with raises(BAD_DESCRIPTION, match="GEV-009"):
        unzip_description(file.getvalue()[:40])


def test_a_packed_description_that_expands_too_far_is_refused():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("cam.xml", bytes(9 * 1024 * 1024))
    with raises(BAD_DESCRIPTION, match="expands beyond the limit"):
        unzip_description(file.getvalue())


BLOCK = bytes.fromhex("3141592653590e09e2df015f8e4000c0000008200030804d4642a025a90a8097")  # 46 MB of zeros
END = bytes.fromhex("177245385090")
BLOCKS = 87  # four gigabytes in all


def zeros() -> bytes:
    """Pack four gigabytes of zeros as bzip2: less than three kilobytes."""
    crc = 0
    for _ in range(BLOCKS):
        crc = (crc << 1 | crc >> 31) & 0xFFFFFFFF ^ int.from_bytes(BLOCK[6:10])
    return b"BZh9" + BLOCKS * BLOCK + END + crc.to_bytes(4)


class NoMemory:
    def read(self, address: int, count: int) -> bytes:
        return bytes(count)

    def write(self, address: int, data: bytes) -> None:
        pass


def features(nodes: str) -> FeatureMap:
    text = f"<RegisterDescription>{nodes}</RegisterDescription>"
    return FeatureMap(parse_description(text.encode()), NoMemory())


def packed_zeros(method: int, claimed: int, content: bytes) -> bytes:
    """Make a ZIP file with that content as its one member, which claims to be small."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr("cam.xml", content)
    stored = bytearray(file.getvalue())
    for place, offset in ((0, 8), (stored.rindex(b"PK\x01\x02"), 10)):
        stored[place + offset : place + offset + 2] = method.to_bytes(2, "little")
        size = place + offset + 14
        stored[size : size + 4] = claimed.to_bytes(4, "little")
    return bytes(stored)


def test_a_packed_description_of_a_few_bytes_does_not_fill_the_memory():
    with bounded_cost(), raises(BAD_DESCRIPTION, match=r"GEV-009.*stored or deflated"):
        unzip_description(packed_zeros(zipfile.ZIP_BZIP2, 1000, zeros()))


def test_a_zip_file_whose_member_lies_beyond_all_files_is_refused():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("cam.xml", b"<a/>")
    stored = file.getvalue()
    begin, end = stored.index(b"PK\x01\x02"), stored.index(b"PK\x05\x06")
    entry, extra = bytearray(stored[begin:end]), struct.pack("<HHQ", 1, 8, 2**64 - 16)
    entry[42:46] = b"\xff" * 4  # its place is in the extra field
    entry[30:32] = struct.pack("<H", len(extra))
    last = bytearray(stored[end:])
    last[12:16] = struct.pack("<I", len(entry) + len(extra))
    with bounded_cost(), raises(BAD_DESCRIPTION, match="GEV-009"):
        unzip_description(stored[:begin] + entry + extra + last)


@pytest.mark.parametrize(
    "formula",
    [
        "9**9**9",
        "(0-9)**9**9",
        "1<<40000000000",
        "1<<64<<64<<64",
        "0x" + "F" * 3000,
        "1e400",
        "EXP(1e300)",
        "-" * 50_000 + "1",
        "-" * 3_000 + "1",
        "ABS(" * 700 + "1" + ")" * 700,
        "1" + "+1" * 1_500,
    ],
    ids=lambda formula: formula[:16],
)
@pytest.mark.parametrize("whole", [True, False])
def test_a_formula_costs_neither_memory_nor_time(formula, whole):
    with bounded_cost(limit_s=1.0), raises(BAD_DESCRIPTION, match="GEV-009"):
        evaluate(formula, {}, whole=whole)


def test_formulas_cover_the_full_64_bit_range():
    assert evaluate("2**63 - 1", {}, whole=True) == 2**63 - 1
    assert evaluate("1 << 63", {}, whole=True) == 1 << 63
    assert evaluate("3**40", {}, whole=True) == 3**40
    assert evaluate("(0-1)**1000001", {}, whole=True) == -1
    assert evaluate("1 >> 400", {}, whole=True) == 0


def test_nodes_that_each_name_two_others_do_not_cost_exponential_time():
    knives = "".join(
        f'<IntSwissKnife Name="N{level}"><pVariable Name="A">N{level + 1}</pVariable>'
        f'<pVariable Name="B">N{level + 1}</pVariable><Formula>A+B</Formula></IntSwissKnife>'
        for level in range(23)
    )
    doubling = features(knives + '<Integer Name="N23"><Value>1</Value></Integer>')
    with bounded_cost(limit_s=1.0), raises(BAD_DESCRIPTION, match="too many nodes"):
        doubling.number("N0")


@pytest.mark.parametrize(
    ("what", "content"),
    [
        ("nested too deep", "<Group>" * 50_000 + "</Group>" * 50_000),
        ("too many elements", "<a/>" * 100_001),
        ("too many fields", '<Integer Name="A">' + "<Value>1</Value>" * 2_000 + "</Integer>"),
        ("too many fields", "<StructReg>" + "<Bit>1</Bit>" * 100 + "</StructReg>"),
        (
            "too many elements",
            f'<a xmlns="{"u" * 100_000}">' + "".join(f"<b{n}/>" for n in range(500)) + "</a>",
        ),
    ],
    ids=["groups", "elements", "fields", "shared fields", "namespaces"],
)
def test_a_deep_or_dense_description_is_refused(what, content):
    with bounded_cost(), raises(BAD_DESCRIPTION, match=f"GEV-009.*{what}"):
        features(content)


@pytest.mark.parametrize(
    "nodes",
    [
        '<IntReg Name="F"><Address>-4</Address><Length>4</Length></IntReg>',
        '<IntReg Name="F"><Address>0x1FFFFFFFF</Address><Length>4</Length></IntReg>',
        '<Float Name="F"><Value>nan</Value></Float>',
        '<Float Name="F"><Value>five</Value></Float>',
        f'<Integer Name="F"><Value>0x{"F" * 5_000}</Value></Integer>',
    ],
    ids=["before memory", "behind memory", "not a number", "a word", "a long number"],
)
def test_impossible_numbers_are_refused(nodes):
    with raises(BAD_DESCRIPTION, match="GEV-009"):
        features(nodes).number("F")
