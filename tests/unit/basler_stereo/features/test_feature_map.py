"""Features through nodes to registers, against a memory held in a dictionary."""

from __future__ import annotations

from fractions import Fraction

import pytest
from coded_errors import raises
from hypothesis import given
from hypothesis import strategies as st

from drivers.basler_stereo.errors import BAD_DESCRIPTION, MISSING_FEATURE
from drivers.basler_stereo.features.description import parse_description
from drivers.basler_stereo.features.feature_map import FeatureMap, Limits
from drivers.basler_stereo.features.formula import evaluate


class Memory:
    def __init__(self) -> None:
        self.bytes = bytearray(256)

    def read(self, address: int, count: int) -> bytes:
        assert count % 4 == 0
        return bytes(self.bytes[address : address + count])

    def write(self, address: int, data: bytes) -> None:
        self.bytes[address : address + len(data)] = data


REGISTER = "<Length>4</Length><Endianess>BigEndian</Endianess>"
NODES = f"""
<Integer Name="Width"><pValue>WidthReg</pValue><Min>16</Min><pMax>Largest</pMax><Inc>16</Inc></Integer>
<IntReg Name="WidthReg"><Address>0x10</Address>{REGISTER}</IntReg>
<Integer Name="Largest"><Value>0x800</Value></Integer>
<IntReg Name="Little"><Address>0x14</Address><Length>4</Length><Endianess>LittleEndian</Endianess></IntReg>
<IntReg Name="Signed"><Address>0x18</Address>{REGISTER}<Sign>Signed</Sign></IntReg>
<MaskedIntReg Name="Bits"><Address>0x1C</Address>{REGISTER}<LSB>27</LSB><MSB>24</MSB></MaskedIntReg>
<MaskedIntReg Name="OneBit"><Address>0x1C</Address>{REGISTER}<Bit>0</Bit></MaskedIntReg>
<MaskedIntReg Name="LowBits"><Address>0x20</Address><Length>4</Length><LSB>4</LSB><MSB>7</MSB></MaskedIntReg>
<FloatReg Name="Real"><Address>0x24</Address>{REGISTER}</FloatReg>
<Float Name="Exposure"><pValue>Convert</pValue><Min>24.0</Min></Float>
<Converter Name="Convert"><FormulaTo>FROM / BASE</FormulaTo><FormulaFrom>TO * BASE</FormulaFrom>
 <pVariable Name="BASE">TimeBase</pVariable><pValue>ExposureReg</pValue></Converter>
<Float Name="TimeBase"><Value>0.5</Value></Float>
<IntReg Name="ExposureReg"><Address>0x28</Address>{REGISTER}</IntReg>
<Integer Name="Selector"><Value>0</Value></Integer>
<IntReg Name="Selected"><Address>0x30</Address><pIndex Offset="8">Selector</pIndex>{REGISTER}</IntReg>
<IntReg Name="Pointed"><pAddress>Pointer</pAddress>{REGISTER}</IntReg>
<Integer Name="Pointer"><Value>0x48</Value></Integer>
<Enumeration Name="Mode"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>
 <EnumEntry Name="On"><Value>1</Value></EnumEntry><pValue>ModeReg</pValue></Enumeration>
<IntReg Name="ModeReg"><Address>0x50</Address>{REGISTER}</IntReg>
<Command Name="Go"><pValue>GoInteger</pValue><pCommandValue>GoValue</pCommandValue></Command>
<Integer Name="GoInteger"><pValue>GoReg</pValue></Integer><Integer Name="GoValue"><Value>5</Value></Integer>
<IntReg Name="GoReg"><Address>0x54</Address>{REGISTER}</IntReg>
<IntSwissKnife Name="Size"><pVariable Name="W">Width</pVariable><Formula>(W * 3) / 2</Formula></IntSwissKnife>
<IntReg Name="Long"><Address>0x58</Address><Length>8</Length><Endianess>BigEndian</Endianess></IntReg>
<Integer Name="RoundA"><pValue>RoundB</pValue></Integer>
<Integer Name="RoundB"><pValue>RoundA</pValue></Integer>
<IntReg Name="Half"><Address>0</Address><Length>2</Length></IntReg>
<Integer Name="Empty"/><IntReg Name="Odd"><Address>0</Address><Length>3</Length></IntReg>
<MaskedIntReg Name="Outside"><Address>0</Address>{REGISTER}<Bit>40</Bit></MaskedIntReg>
<SwissKnife Name="NoFormula"/>
<StructReg><Address>0x60</Address>{REGISTER}<StructEntry Name="High"><LSB>15</LSB><MSB>0</MSB></StructEntry>
 <StructEntry Name="Lowest"><Bit>31</Bit><Sign>Unsigned</Sign></StructEntry></StructReg>
<Float Name="Kelvin"><pValue>Warmth</pValue></Float>
<Converter Name="Warmth"><pVariable Name="STEP">TimeBase</pVariable><Constant Name="ZERO">0x111</Constant>
 <Expression Name="SHIFT">ZERO + STEP</Expression><FormulaTo>FROM - SHIFT</FormulaTo>
 <FormulaFrom>TO + SHIFT</FormulaFrom><pValue>Little</pValue></Converter>
<Integer Name="Gain"><pIndex>Selector</pIndex><pValueIndexed Index="1">Little</pValueIndexed>
 <pValueIndexed Index="2">Signed</pValueIndexed><pValueDefault>WidthReg</pValueDefault></Integer>
<Integer Name="Installed"><Value>1</Value></Integer>
<Integer Name="Ready"><Value>1</Value></Integer>
<Integer Name="Gamma"><pIsImplemented>Installed</pIsImplemented><pValue>GammaReg</pValue></Integer>
<IntReg Name="GammaReg"><pIsAvailable>Ready</pIsAvailable><Address>0x64</Address>{REGISTER}</IntReg>
<Enumeration Name="Source"><EnumEntry Name="Software"><Value>0</Value></EnumEntry>
 <EnumEntry Name="Action1"><pIsImplemented>Installed</pIsImplemented><Value>1</Value></EnumEntry>
 <pValue>ModeReg</pValue></Enumeration>
"""


@pytest.fixture
def memory():
    return Memory()


@pytest.fixture
def features(memory):
    return FeatureMap(
        parse_description(f"<RegisterDescription>{NODES}</RegisterDescription>".encode()), memory
    )


def test_an_integer_reads_and_writes_its_register_big_endian(features, memory):
    features.set_number("Width", 640)
    assert memory.read(0x10, 4).hex() == "00000280"
    assert features.number("Width") == 640


def test_little_endian_and_signed_registers_are_read_and_written(features, memory):
    features.set_number("Little", 0x01020304)
    assert memory.read(0x14, 4).hex() == "04030201"
    features.set_number("Signed", -2)
    assert memory.read(0x18, 4).hex() == "fffffffe"
    assert features.number("Signed") == -2
    features.set_number("Long", 2**40 + 1)
    assert features.number("Long") == 2**40 + 1


@pytest.mark.parametrize(
    ("name", "value"), [("Little", 1 << 32), ("Little", -1), ("Signed", 1 << 31), ("Bits", 16), ("OneBit", 2)]
)
def test_a_value_that_its_register_cannot_hold_is_refused(features, memory, name, value):
    before = memory.read(0x10, 0x20)
    with raises(BAD_DESCRIPTION, match=f"cannot hold {value}"):
        features.set_number(name, value)
    assert memory.read(0x10, 0x20) == before


def test_masked_registers_keep_the_other_bits(features, memory):
    memory.write(0x1C, bytes.fromhex("ffffffff"))
    features.set_number("Bits", 0x5)  # bits 24..27 counted from the most significant one
    assert memory.read(0x1C, 4).hex() == "ffffff5f"
    features.set_number("OneBit", 0)
    assert memory.read(0x1C, 4).hex() == "7fffff5f"
    assert (features.number("Bits"), features.number("OneBit")) == (5, 0)
    features.set_number("LowBits", 0xA)  # little endian: from the least significant one
    assert memory.read(0x20, 4).hex() == "a0000000"


def test_floats_and_converters_are_read_and_written(features, memory):
    features.set_number("Real", 1.5)
    assert memory.read(0x24, 4).hex() == "3fc00000"
    assert features.number("Real") == 1.5
    features.set_number("Exposure", 100.0)
    assert memory.read(0x28, 4).hex() == "000000c8"
    assert features.number("Exposure") == 100.0


def test_selectors_and_pointers_move_the_address(features, memory):
    features.set_number("Selector", 2)  # has no register: the value is held by us
    features.set_number("Selected", 7)
    assert memory.read(0x40, 4).hex() == "00000007"
    features.set_number("Pointed", 9)
    assert memory.read(0x48, 4).hex() == "00000009"


def test_enumerations_are_set_and_read_by_name(features):
    features.choose("Mode", "On")
    assert features.choice("Mode") == "On"
    with raises(MISSING_FEATURE, match=r"GEV-010.*Off or On"):
        features.choose("Mode", "Sometimes")
    features.set_number("ModeReg", 9)
    with raises(BAD_DESCRIPTION, match="not among its entries"):
        features.choice("Mode")


def test_a_command_writes_its_value_to_its_register(features, memory):
    assert features.command_write("Go") == (0x54, bytes.fromhex("00000005"))
    features.execute("Go")
    assert memory.read(0x54, 4).hex() == "00000005"
    with raises(MISSING_FEATURE, match="not a command"):
        features.execute("Width")


def test_limits_come_from_the_node_or_the_nodes_it_names(features):
    assert features.limits("Width") == Limits(16, 0x800, 16)
    assert features.limits("Exposure") == Limits(24.0, None, None)


@pytest.mark.parametrize("condition", ["Installed", "Ready"])
def test_a_feature_is_absent_when_its_conditions_are_not_met(features, condition):
    assert features.has("Gamma")
    features.set_number(condition, 0)  # the one of the feature, the other of its register
    assert not features.has("Gamma")


def test_entries_that_this_model_lacks_cannot_be_chosen(features):
    features.choose("Source", "Action1")
    features.set_number("Installed", 0)
    assert features.entries("Source") == {"Software": 0}
    with raises(MISSING_FEATURE, match=r"GEV-010: Source cannot be Action1; expected Software"):
        features.choose("Source", "Action1")
    assert features.choice("Source") == "Action1"  # what it is, it tells nevertheless


def test_parts_of_a_shared_register_have_their_own_names(features, memory):
    memory.write(0x60, bytes.fromhex("1234fffe"))
    assert (features.number("High"), features.number("Lowest")) == (0x1234, 0)
    features.set_number("Lowest", 1)
    assert memory.read(0x60, 4).hex() == "1234ffff"


def test_formulas_have_constants_and_expressions(features):
    features.set_number("Little", 27)
    assert features.number("Kelvin") == 0x111 + 0.5 + 27
    features.set_number("Kelvin", 300.5)
    assert features.number("Little") == 27


def test_an_index_selects_the_underlying_node(features):
    for selector, register in ((1, "Little"), (2, "Signed"), (7, "WidthReg")):
        features.set_number("Selector", selector)
        features.set_number("Gain", 40 + selector)
        assert features.number(register) == features.number("Gain") == 40 + selector


def test_a_formula_can_use_features(features):
    features.set_number("Width", 33)
    assert features.number("Size") == 49


@pytest.mark.parametrize("name", ["RoundA", "Empty", "Odd", "Outside", "NoFormula"])
def test_invalid_nodes_are_refused(features, name):
    with raises(BAD_DESCRIPTION, match="GEV-009"):
        features.number(name)


def test_unknown_and_unwritable_features_are_named(features):
    assert not features.has("Saturation")
    with raises(MISSING_FEATURE, match=r"GEV-010.*Saturation"):
        features.number("Saturation")
    for name in ("Size", "Half"):  # the protocol writes whole registers of four bytes
        with raises(MISSING_FEATURE, match="cannot be written"):
            features.set_number(name, 3)


@pytest.mark.parametrize(
    ("formula", "value"),
    [
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("7 / 2", 3),
        ("-7 / 2", -3),
        ("7 % 4", 3),
        ("2 ** 3 ** 2", 512),
        ("0xFF & ~0x0F", 0xF0),
        ("1 << 4 | 1", 17),
        ("6 ^ 3", 5),
        ("A = 3 ? 10 : 20", 10),
        ("A <> 3 ? 10 : A > 1 && A < 2 ? 1 : 30", 30),
        ("A >= 3 || 0", 1),
        ("A <= 2", 0),
        ("ABS(-5) + SGN(-2) + FLOOR(2.5)", 6),
        ("+A", 3),
    ],
)
def test_integer_formulas_are_evaluated(formula, value):
    assert evaluate(formula, {"A": 3}, whole=True) == value


def test_real_formulas_divide_exactly():
    assert evaluate("1000000 / PERIOD", {"PERIOD": 32}, whole=False) == 31250.0
    assert evaluate("SQRT(2.25) + 1e-3", {}, whole=False) == pytest.approx(1.501)


@pytest.mark.parametrize("formula", ["1 +", "UNKNOWN", "1 / 0", "FOO(1)", "SQRT(-1)", "", "a b"])
def test_formulas_without_a_value_are_refused(formula):
    with raises(BAD_DESCRIPTION, match="GEV-009"):
        evaluate(formula, {}, whole=False)


@given(st.integers(-(2**63), 2**63), st.integers(-(2**63), 2**63).filter(bool))
def test_integers_of_64_bits_are_divided_exactly_towards_zero(a, b):
    quotient = int(Fraction(a, b))
    assert evaluate("A / B", {"A": a, "B": b}, whole=True) == quotient
    assert evaluate("A % B", {"A": a, "B": b}, whole=True) == a - b * quotient


@given(st.integers(-1000, 1000), st.integers(-1000, 1000), st.sampled_from("+-*"))
def test_arithmetic_agrees_with_python(a, b, sign):
    expected = {"+": a + b, "-": a - b, "*": a * b}[sign]
    assert evaluate(f"A {sign} B", {"A": a, "B": b}, whole=True) == expected
