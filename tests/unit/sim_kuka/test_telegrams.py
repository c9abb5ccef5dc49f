"""Telegrams byte for byte, and replies of any form and content."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from coded_errors import raises
from mutations import mutations
from shared_controller import Make

from ronna_hw.wire.kuka_context import (
    Feedback,
    ReceiveElement,
    RsiContext,
    SendElement,
    context_hash,
    load_context,
)
from sim.kuka.errors import ETHERNET_FILE_INVALID
from sim.kuka.rsi.telegrams import ReplyReader, TelegramWriter

FRAME = (445.0, 0.0, 810.0, 180.0, 0.0, 180.0)
AXES = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)


def sends(*tags: str) -> list[SendElement]:
    return [
        SendElement(tag=tag, type="LONG" if tag == "DEF_Delay" else "DOUBLE", indx="INTERNAL") for tag in tags
    ]


def test_the_default_telegram_has_the_exact_bytes_that_positional_parsers_need() -> None:
    context = load_context()
    telegram = TelegramWriter(context.send, 4, AXES, FRAME).write(FRAME, AXES, 0, 4208163634)
    assert telegram == (
        b'<Rob Type="KUKA"><RIst X="445.0000" Y="0.0000" Z="810.0000" A="180.0000" B="0.0000" C="180.0000"/>'
        b'<AIPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="90.0000" A6="0.0000"/>'
        b'<EIPos E1="0.0000" E2="0.0000" E3="0.0000" E4="0.0000" E5="0.0000" E6="0.0000"/>'
        b'<Delay D="0"/><IPOC>4208163634</IPOC></Rob>'
    )


def test_motor_currents_follow_the_default_telegram_where_they_are_sent() -> None:
    context = load_context()
    plain = TelegramWriter(context.send, 4, AXES, FRAME).write(FRAME, AXES, 0, 4208163634)
    currents = (0.0, -31.25, 12.0, 0.0, -4.5, 0.0)
    writer = TelegramWriter(context.all_send, 4, AXES, FRAME)
    assert writer.write(FRAME, AXES, 0, 4208163634, currents=currents) == plain.replace(
        b"<IPOC>",
        b'<MACur A1="0.0000" A2="-31.2500" A3="12.0000" A4="0.0000" A5="-4.5000" A6="0.0000"/><IPOC>',
    )


def test_elements_follow_the_configuration_and_groups_share_an_element() -> None:
    elements = [
        *sends("DEF_ASPos", "DEF_Delay", "DEF_RSol", "DEF_Tech.C1", "DEF_Tech.C2"),
        SendElement(tag="Digout.o1", type="BOOL", indx=2),
        SendElement(tag="Digout.o2", type="BOOL", indx=3),
        SendElement(tag="FREE", type="LONG", indx=4),
        SendElement(tag="Source1", type="DOUBLE", indx=5),
        SendElement(tag="DiL", type="LONG", indx=6),
    ]
    root = ElementTree.fromstring(
        TelegramWriter(elements, 2, AXES, FRAME).write((9.0,) * 6, (8.0,) * 6, 7, 12)
    )
    assert [child.tag for child in root] == [
        "ASPos",
        "Delay",
        "RSol",
        "Tech",
        "Digout",
        "Source1",
        "DiL",
        "IPOC",
    ]
    assert root.attrib == {"Type": "KUKA"}
    assert list(root.find("ASPos").attrib.values())[1] == "-90.00"  # type: ignore[union-attr]
    assert root.find("Delay").attrib == {"D": "7"}  # type: ignore[union-attr]
    assert len(root.find("Tech").attrib) == 20  # type: ignore[union-attr]
    assert list(root.find("Tech").attrib)[9:11] == ["C110", "C21"]  # type: ignore[union-attr]
    assert root.find("Digout").attrib == {"o1": "0", "o2": "0"}  # type: ignore[union-attr]
    assert (root.findtext("Source1"), root.findtext("DiL")) == ("0.00", "0")


def test_stat_is_sent_if_the_file_lists_it_and_filled_if_the_context_wires_it() -> None:
    elements = [
        SendElement(tag="AKorr.Stat", type="LONG", indx=1),
        *sends("DEF_Delay"),
        SendElement(tag="Pos", type="DOUBLE", indx=2),
    ]
    feedback = [Feedback(indx=1, object="AXISCORR"), Feedback(indx=2, object="POSCORR")]
    writer = TelegramWriter(elements, 1, AXES, FRAME, feedback)
    assert writer.write(FRAME, AXES, 7, 12, (3, 17)) == (
        b'<Rob Type="KUKA"><AKorr Stat="3"/><Delay D="7"/><Pos>17.0</Pos><IPOC>12</IPOC></Rob>'
    )
    unwired = TelegramWriter(elements, 1, AXES, FRAME).write(FRAME, AXES, 7, 12, (3, 17))
    assert b'<AKorr Stat="0"/>' in unwired


def test_a_feedback_needs_a_channel_that_is_sent() -> None:
    content = load_context().model_dump(by_alias=True)
    content["feedback"] = ({"indx": 9, "object": "AXISCORR"},)
    with pytest.raises(ValueError, match=r"feedback: indx \[9\] is not sent"):
        RsiContext.model_validate(content)


def test_wired_feedback_changes_the_context_hash() -> None:
    context = load_context()
    content = context.model_dump(by_alias=True)
    content["send"] = (*content["send"], {"tag": "Stat", "type": "LONG", "indx": 1})
    said = RsiContext.model_validate({**content, "feedback": ({"indx": 1, "object": "AXISCORR"},)})
    assert context_hash(RsiContext.model_validate({**content, "feedback": ()})) != context_hash(said)


def test_an_unknown_keyword_is_refused() -> None:
    with raises(ETHERNET_FILE_INVALID, match="DEF_Nonsense") as caught:
        TelegramWriter(sends("DEF_Nonsense"), 4, AXES, FRAME)
    assert caught.value.code == "KRC-001"


def test_an_unchanged_pose_gives_the_same_bytes_and_a_changed_pose_is_written() -> None:
    writer = TelegramWriter(sends("DEF_AIPos", "DEF_RIst"), 1, AXES, FRAME)
    first = writer.write(FRAME, AXES, 0, 4)
    assert writer.write(FRAME, AXES, 0, 8) == first.replace(b"<IPOC>4<", b"<IPOC>8<")
    assert b'A1="5.0"' in writer.write(FRAME, (5.0,) * 6, 0, 12)


@pytest.fixture
def reader() -> ReplyReader:
    context = load_context()
    return ReplyReader(context.receive, context.ethernet.sentype)


PLAIN = (
    '<Sen Type="KROSHU"><Stop>0</Stop><AK A1="1.500000" A2="-2" A3="0.0" A4="0.0" A5="0.0" A6="0.25"/>'
    "<IPOC>44</IPOC></Sen>"
)
VALUES = [0.0, 1.5, -2.0, 0.0, 0.0, 0.0, 0.25]


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        PLAIN.replace("/>", " />"),
        PLAIN.replace("><", ">\n  <"),
        PLAIN + "\n",
        "<?xml version='1.0'?>" + PLAIN,
        PLAIN.replace("<Stop>0</Stop>", "").replace("<IPOC>", "<Stop>0</Stop><Extra a='1'/><IPOC>"),
        PLAIN.replace("1.500000", "1.5e0"),
        PLAIN.replace('"', "'"),
        PLAIN.replace("/>", "></AK>"),
        PLAIN.replace("<IPOC>44</IPOC>", "").replace('"KROSHU">', '"KROSHU"><IPOC>44</IPOC>'),
    ],
)
def test_a_reply_is_read_in_every_valid_form(reader: ReplyReader, text: str) -> None:
    reply = reader.read(text.encode())
    assert reply is not None
    assert reply.ipoc == 44
    assert list(reply.values) == VALUES


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<Sen",
        PLAIN.replace("KROSHU", "ImFree"),
        PLAIN.replace("Sen", "Rob"),
        PLAIN.replace("<IPOC>44</IPOC>", ""),
        PLAIN.replace(">44<", ">-4<"),
        PLAIN.replace(">44<", ">4.0<"),
        PLAIN.replace("1.500000", "nan"),
        PLAIN.replace("1.500000", "inf"),
        PLAIN.replace("1.500000", "1e999"),
        PLAIN.replace("1.500000", "1_0"),
        PLAIN.replace("1.500000", "one"),
        PLAIN.replace("1.500000", ""),
        PLAIN.replace("</Stop>", ""),
        "<!DOCTYPE Sen [<!ENTITY a 'b'>]>" + PLAIN,
        *(f"<?xml version='1.0' encoding='{name}'?>{PLAIN}" for name in ("foo", "hex", "utf-7")),
        PLAIN + PLAIN,
        PLAIN + "x" * 20000,
    ],
)
def test_an_invalid_reply_is_rejected(reader: ReplyReader, text: str) -> None:
    assert reader.read(text.encode()) is None


def test_values_missing_from_a_reply_are_none(reader: ReplyReader) -> None:
    reply = reader.read(b'<Sen Type="KROSHU"><AK A2="3"/><IPOC>8</IPOC></Sen>')
    assert reply is not None
    assert list(reply.values) == [None, None, 3.0, None, None, None, None]


def test_messages_generators_and_digit_attributes_do_not_disturb_parsing() -> None:
    elements = [
        ReceiveElement(tag="DEF_EStr", type="STRING", indx="INTERNAL", holdon=0),
        ReceiveElement(tag="DEF_Tech.T2", type="DOUBLE", indx="INTERNAL", holdon=0),
        ReceiveElement(tag="RKorr.X", type="DOUBLE", indx=1, holdon=1),
        ReceiveElement(tag="FREE", type="LONG", indx=2, holdon=1),
        ReceiveElement(tag="GPIO.01", type="BOOL", indx=3, holdon=1),
    ]
    reply = ReplyReader(elements, "ImFree").read(
        b'<Sen Type="ImFree"><EStr>a &lt; b</EStr><Tech T21="1" /><RKorr X="0.5" />'
        b'<GPIO 01="1"/><IPOC>16</IPOC></Sen>'
    )
    assert reply is not None
    assert reply.message == "a < b"
    assert list(reply.values) == [None, None, 0.5, None, 1.0]


ETHERNET_XML = """\ufeff<ROOT>
  <CONFIG><IP_NUMBER>10.10.10.10</IP_NUMBER><!-- PC --><PORT>64000</PORT><SENTYPE>ImFree</SENTYPE>
    <ONLYSEND>FALSE</ONLYSEND></CONFIG>
  <SEND><ELEMENTS>
    <ELEMENT TAG="DEF_RIst" TYPE="DOUBLE" INDX="INTERNAL" UNIT="0" />
    <ELEMENT TAG="DiL" TYPE="LONG" INDX="1" />
  </ELEMENTS></SEND>
  <RECEIVE><ELEMENTS>
    <ELEMENT TAG="DEF_EStr" TYPE="STRING" INDX="INTERNAL" />
    <ELEMENT TAG="RKorr.X" TYPE="DOUBLE" INDX="1" HOLDON="1" />
    <ELEMENT TAG="AKorr.A3" TYPE="DOUBLE" INDX="2" HOLDON="0" />
    <ELEMENT TAG="Stop" TYPE="BOOL" INDX="3" HOLDON="0" />
    <ELEMENT TAG="DiO" TYPE="LONG" INDX="4" HOLDON="1" />
  </ELEMENTS></RECEIVE>
</ROOT>"""


@pytest.fixture
def read_file(tmp_path: Path) -> Make:
    from sim.kuka.rsi.ethernet_file import read_ethernet_file

    def read(text: str, context: RsiContext | None = None, longest_name: int = 255) -> RsiContext:
        path = tmp_path / "link.xml"
        path.write_text(text, encoding="utf-8")
        return read_ethernet_file(path, context, longest_name)

    return read


def test_wiring_is_inferred_from_the_tags_of_a_foreign_file(read_file: Make) -> None:
    context = read_file(ETHERNET_XML)
    assert {(wire.object, wire.input, wire.indx) for wire in context.wiring} == {
        ("POSCORR", "X", 1),
        ("AXISCORR", "A3", 2),
        ("STOP", "In1", 3),
    }
    assert (context.ethernet.timeout_packets, context.ethernet.precision) == (100, 4)
    assert (context.ethernet.pc_ip, context.ethernet.pc_port) == ("10.10.10.10", 64000)
    assert context.axis_correction is None  # the maker's narrow defaults hold
    stat = '<ELEMENT TAG="AKorr.Stat" TYPE="LONG" INDX="2" />\n  </ELEMENTS></SEND>'
    context = read_file(ETHERNET_XML.replace("</ELEMENTS></SEND>", stat))
    assert [(wire.indx, wire.object) for wire in context.feedback] == [(2, "AXISCORR")]


def test_a_context_supplies_the_wiring_of_an_ethernet_file(read_file: Make) -> None:
    text = ETHERNET_XML
    for number in range(5, 9):
        text = text.replace(
            "  </ELEMENTS></RECEIVE>",
            f'<ELEMENT TAG="V{number}" TYPE="DOUBLE" INDX="{number}" HOLDON="1" />\n  </ELEMENTS></RECEIVE>',
        )
    context = read_file(text, load_context())
    assert context.find_wired_tag("AXISCORR", "A5") == "V6"  # by channel, not by name
    assert context.axis_correction is not None
    with raises(ETHERNET_FILE_INVALID, match="not received"):
        read_file(ETHERNET_XML, load_context())


def test_our_own_ethernet_file_with_our_context_is_our_context(read_file: Make) -> None:
    ours, name = load_context(), "drivers/kuka_rsi/controller/files/ronna_rsi_eth.xml"
    text = (Path(__file__).parents[3] / name).read_text("ascii")
    assert read_file(text, ours) == ours
    bare = read_file(re.sub(r".*DEF_MACur.*\n", "", text), ours)
    assert bare.all_send == ours.send
    assert context_hash(bare) == context_hash(ours)
    assert [element.tag for element in read_file(text).all_send] == [element.tag for element in ours.all_send]


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("<ROOT>", "<ROOT", "not XML"),
        ("<CONFIG>", "<CONFIGS>", "not XML"),
        ('INDX="4"', 'INDX="four"', "INDX of DiO"),
        ('INDX="4"', 'INDX="3"', "once"),
        ('TYPE="LONG" INDX="4"', 'TYPE="INT" INDX="4"', "type"),
        ('TAG="DiO"', 'TAG="Di O"', "TAG"),
        ("64000", "no", "PORT"),
    ],
)
def test_a_broken_file_is_refused_and_its_mistake_named(
    read_file: Make, old: str, new: str, what: str
) -> None:
    with raises(ETHERNET_FILE_INVALID, match=what):
        read_file(ETHERNET_XML.replace(old, new))


def test_a_file_name_that_is_too_long_is_refused(read_file: Make) -> None:
    assert read_file(ETHERNET_XML, longest_name=len("link"))
    with raises(ETHERNET_FILE_INVALID, match=r"link.xml is too long.*3 characters"):
        read_file(ETHERNET_XML, longest_name=3)


FEW, MANY = 3000, 1_000_000
AWAY = (
    b'<Sen Type="%s"><Stop>1</Stop><AK A1="0.100000" A2="-0.1" A3="0.1" A4="0.1" A5="0.1" A6="0.1"/>'
    b"<IPOC>%d</IPOC></Sen>"
)


def test_no_mutant_of_a_foreign_reply_is_taken(bench: Any) -> None:
    """The cycle or the type is another one; a mutation of a few bytes does not mend that."""
    bench.enter_movecorr()
    run = bench.controller.run
    foreign = (AWAY % (b"KROSHU", run.ipoc - 400), AWAY % (b"ImFree", run.ipoc))
    assert [mutant for mutant in mutations(foreign, FEW, seed=3) if run.read(mutant) is not None] == []
    assert run.read(AWAY % (b"KROSHU", run.ipoc)) is not None


def test_mutated_replies_never_make_a_resting_arm_jump(bench: Any) -> None:
    _nothing_moves(bench, FEW)


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_a_million_mutated_replies_never_make_a_resting_arm_jump(bench: Any) -> None:
    _nothing_moves(bench, MANY)


def _nothing_moves(bench: Any, count: int) -> None:
    """Mutants of replies that hold the arm still: what is taken moves it no further than a digit can."""
    bench.enter_movecorr()
    controller = bench.controller
    template = (
        '<Sen Type="KROSHU"><Stop>0</Stop><AK A1="0.000000" A2="0.000000" A3="0.000000" A4="0.000000"'
        ' A5="0.000000" A6="0.000000"/><IPOC>%d</IPOC></Sen>'
    )
    steps = mutations((template.encode(),), count, seed=23)
    for mutant in steps:
        run = controller.run
        if run is None:
            # A changed digit or a raised Stop may end the run; it never makes the arm jump.
            while controller.moving:
                controller.settle()
            controller.acknowledge()
            controller.switch_drives(True)
            assert controller.start().code == 0
            bench.enter_movecorr()
            continue
        before = controller.arm.axes_deg
        controller.finish_cycle(run.read(mutant.replace(b"%d", b"%d" % run.ipoc)))
        after = controller.arm.axes_deg
        for joint, a, b in zip(controller.arm.description.joints, before, after, strict=True):
            assert abs(b - a) <= 0.25 * joint.full_speed_deg_s * 0.004 + 1e-6
        if controller.run is run:
            bench.answer()
