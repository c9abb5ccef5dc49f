"""What parsers of hostile inputs take when all is well."""

from __future__ import annotations

import hashlib
import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

from ronna_hw.evidence.journal_reading import FIRST

Take = Callable[[bytes], object]
PACKET_BYTES = 108
# to collect tests without making them all
PARSER_NAMES = (
    "theatre TOML", "scene TOML", "scene JSON", "scene's seed", "plan TOML", "context TOML", "tool TOML",
    "answers TOML", "picks JSON", "picks CSV", "record", "journal", "events", "theatre in use", "seal",
    "request", "recorded bytes", "packed bytes", "recorded pixels", "control line", "fault script",
    "Ethernet file",
    "DICOM", "DICOM deflated", "GenICam XML", "GenICam ZIP", "GenICam formula", "GVCP", "GVSP",
    "Polaris BX", "Polaris text", "Polaris .rom", "EKI", "RSI", "RTDE",
    "RTDE set-up", "UR dashboard", "UR primary",
    "RSI reply", "run", "log", "tape", "truth",
    "left world", "kept truth", "calibration figures", "room", "raw image", "conformance BX", "DICOM RLE",
    "DICOM JPEG", "DICOM JPEG-LS", "DICOM JPEG 2000", "proposed place", "marker template", "raw extent",
    "ledger", "recorded readings", "simulated camera", "simulated tracker", "simulated tracker .rom",
    "EKI request", "EKI SDK request", "order", "structure", "unsaved plan", "fault script of a case",
    "looks of a calibration", "head of a scene", "world", "variables", "results of a run",
    "check after the operation", "conformance features", "conformance stream", "conformance EKI",
    "conformance RSI", "conformance Polaris", "standard input", "gauge readings", "control port",
    "control port answer", "Polaris handles", "Polaris identity", "EKI acknowledgement",
)  # fmt: skip
DESCRIPTION = b"""<RegisterDescription xmlns="http://www.genicam.org/GenApi/Version_1_1">
<Group Comment="g">
<Integer Name="Width"><pValue>WidthReg</pValue><Min>16</Min><pMax>Largest</pMax><Inc>16</Inc></Integer>
</Group>
<IntReg Name="WidthReg"><Address>0x10</Address><Length>4</Length><Endianess>BigEndian</Endianess></IntReg>
<Integer Name="Largest"><Value>0x800</Value></Integer><Integer Name="Selector"><Value>1</Value></Integer>
<MaskedIntReg Name="Bits"><Address>0x1C</Address><Length>4</Length><LSB>27</LSB><MSB>24</MSB></MaskedIntReg>
<FloatReg Name="Real"><Address>0x24</Address><Length>8</Length><Endianess>BigEndian</Endianess></FloatReg>
<Float Name="Exposure"><pValue>Convert</pValue><Min>24.0</Min></Float>
<Converter Name="Convert"><FormulaTo>FROM / BASE</FormulaTo><FormulaFrom>TO * BASE</FormulaFrom>
<pVariable Name="BASE">TimeBase</pVariable><pValue>WidthReg</pValue></Converter>
<Float Name="TimeBase"><Value>0.5</Value></Float>
<IntReg Name="Selected"><Address>0x30</Address><pIndex Offset="8">Selector</pIndex><Length>4</Length></IntReg>
<IntReg Name="Pointed"><pAddress>Largest</pAddress><Length>8</Length><Sign>Signed</Sign></IntReg>
<Enumeration Name="Mode"><EnumEntry Name="Off"><Value>0</Value></EnumEntry><EnumEntry Name="On">
<pIsAvailable>Selector</pIsAvailable><Value>1</Value></EnumEntry><pValue>Bits</pValue></Enumeration>
<Command Name="Go"><pValue>Largest2</pValue><pCommandValue>Selector</pCommandValue></Command>
<Integer Name="Largest2"><pValue>WidthReg</pValue></Integer>
<IntSwissKnife Name="Size"><pVariable Name="W">Width</pVariable><Constant Name="K">3</Constant>
<Expression Name="E">W * K</Expression>
<Formula>(E &gt;&gt; 1) ** 2 % 7 ? W &lt;&lt; 2 : E</Formula></IntSwissKnife>
<StructReg><Address>0x60</Address><Length>4</Length>
<StructEntry Name="High"><LSB>15</LSB><MSB>0</MSB></StructEntry>
</StructReg><Integer Name="Gain"><pIndex>Selector</pIndex><pValueIndexed Index="1">Bits</pValueIndexed>
<pValueDefault>WidthReg</pValueDefault></Integer></RegisterDescription>"""
FORMULAS = (
    b"A >= 3 ? ABS(-5) + SGN(-2) * FLOOR(2.5) : 0xFF & ~0x0F",
    b"(TO - 1.5e3) / B ** 2 + SQRT(A) % 4",
    b"1 << A | B >> 2 ^ 3 && A <> B || LN(2) = EXP(1)",
)
STATE = (
    b'<State Id="7" Mode="EXT" Drives="1" EStop="0" Guard="0" Moving="0" Err="0" RSI="2" Tool="1" HoldOn="1"'
    b' Cycle="4"><Axis A1="1.5" A2="0" A3="0" A4="0" A5="0" A6="0"></Axis></State>'
)
ETHERNET = b"""<ROOT><CONFIG><IP_NUMBER>127.0.0.1</IP_NUMBER><PORT>59152</PORT><SENTYPE>PC</SENTYPE>
<ONLYSEND>FALSE</ONLYSEND></CONFIG><SEND><ELEMENTS><ELEMENT TAG="DEF_RIst" TYPE="DOUBLE" INDX="INTERNAL"/>
<ELEMENT TAG="Out.01" TYPE="BOOL" INDX="1"/></ELEMENTS></SEND><RECEIVE><ELEMENTS>
<ELEMENT TAG="RKorr.X" TYPE="DOUBLE" INDX="1" HOLDON="1"/></ELEMENTS></RECEIVE></ROOT>"""
TELEGRAM = (
    b'<Rob Type="KUKA"><RIst X="1.0" Y="0" Z="0" A="0" B="0" C="0"/>'
    b'<AIPos A1="0" A2="-90.0" A3="90.0" A4="0" '
    b'A5="0" A6="0"/><EIPos E1="0"/><Delay D="0"/><IPOC>4208163634</IPOC></Rob>'
)
REPLIES = (
    b'<Sen Type="RONNA"><Stop>0</Stop><AK A1="1.500000" A2="-2" A3="0.0" A4="0.0" A5="0.0" A6="0.25"/>'
    b"<IPOC>4208163634</IPOC></Sen>",
    b"<Sen Type='RONNA'>\n <IPOC>44</IPOC><AK A6='1e-3' A1='.5'></AK><EStr>a &lt; b</EStr>"
    b"<Stop> 0 </Stop></Sen>\n",
)
CONTROLLER_COMMANDS = tuple(
    b'<Cmd Id="%d" Name=%b></Cmd>' % (number, command)
    for number, command in enumerate(
        (
            b'"STATUS"',
            b'"DRIVES" On="1"',
            b'"SET_TOOL" No="1" X="0" Y="0" Z="0" A="0" B="0" C="0"',
            b'"SET_BASE" No="1" X="0" Y="0" Z="0" A="0" B="0" C="0"',
            b'"PTP_POS" X="540.6" Y="-5" Z="620.6" A="0" B="0" C="-180" S="2" T="2" Vel="10" Acc="10"',
            b'"STOP" Kind="FAST"',
            b'"LIN" X="541" Y="0" Z="620" A="0" B="0" C="-180" Tool="1" Base="1" Vel="0.1"',
            b'"STOP"',
            b'"PTP_AXIS" A1="1" A2="-90" A3="90" A4="0" A5="60" A6="0" Vel="10" Acc="10"',
            b'"ACK_ERRORS"',
            b'"SELECT"',
            b'"SET_OV" Val="50"',
            b'"RSI_START" Cycle="4" Ref="ABS" Corr="AXIS"',
            b'"RSI_STOP"',
        )
    )
)
CONTROLLER_REQUESTS = tuple(
    b'<External REQTYPE="%d" CycleTime="1" ControlMode="1"></External>\n\0\0' % number
    for number in (0, 4, 6, 8, 1, 2, 3, 7, 5)
)
STRUCTURES = b"""[[structures]]
name = "a vessel"
margin_mm = 2.0
points_mm = [[10.0, -40.5, 50.0], [12.0, -41.0, 49.5]]
"""
TOOL = b'part_number = "P"\nmarkers_mm = [[0, 0, 0], [0, 50, 0], [0, 100, 1.5]]\nmade_on = 2025-01-01\n'
ANSWERS = b'default = "first"\n[answers]\nregistration = "yes"\n"approach:T1" = "no"\n'
FAULTS = b"at 12.5 s: tracker occlude marker 3 for 2 s\nwhen step == relocalization: robot drop 5 % for 1 s\n"


def reading(path: Path, read: Callable[[Path], object]) -> Take:
    """Take bytes by writing them to a file and reading that."""

    def take(data: bytes) -> object:
        path.write_bytes(data)
        return read(path)

    return take


def events_file() -> bytes:
    base = {"version": 1, "number": 1, "host_time": "2026-11-20T12:00:00+00:00", "theatre_time_s": 1.5}
    kinds = (
        {"kind": "step", "step": "registration:T1", "state": "begun", "summary": "", "record": None},
        {"kind": "pose", "arm": "master", "joints_rad": [0.1] * 6, "age_s": 0.1},
        {"kind": "journal", "line": {"entry": "closed", "values": [1, 2.5, None, {"a": "b"}]}},
    )
    return b"".join(json.dumps({**base, "what": what}).encode() + b"\n" for what in kinds)


def journal_file() -> bytes:
    first = json.dumps({"sequence": 0, "previous": FIRST, "entry": "opened", "values": [1.5, {"a": []}]})
    line = first.encode() + b"\n"
    previous = hashlib.sha256(line).hexdigest()
    return line + json.dumps({"sequence": 1, "previous": previous, "entry": "closed"}).encode() + b"\n"


def packets() -> bytes:
    leader = struct.pack(">HHQIIIIIHH", 0, 1, 1001, 0x01080001, 40, 30, 16, 8, 0, 0)
    contents = [(1, leader), *((3, bytes(100)) for _ in range(12)), (2, struct.pack(">HHI", 0, 1, 30))]
    heads = (struct.pack(">HHI", 0, 1, kind << 24 | number) for number, (kind, _) in enumerate(contents))
    made = (head + content for head, (_, content) in zip(heads, contents, strict=True))
    return b"".join(packet.ljust(PACKET_BYTES, b"\0") for packet in made)


def zipped(content: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("cam.xml", content)
    return file.getvalue()


JOURNAL_OF_A_RUN = b"".join(
    json.dumps({"host_time": "2026-11-20T12:00:00.000+00:00", "theatre_time_s": 1.5, **line}).encode() + b"\n"
    for line in (
        {"entry": "opened", "run": "run", "seed": 3, "strategy": "ocs", "request_sha256": "0" * 64}
        | {"truth": {"theatre/scene.json": [3, "0" * 64]}},
        {"entry": "intent", "step": "image", "moves": False},
        {"entry": "confirmation", "topic": "plan", "subject": "s", "value": "v", "answer": "yes"},
        {"entry": "motion", "number": 1, "what": "go", "to": [0.1, 0.2], "trajectory": "T1"},
        {"entry": "moved", "number": 1, "reached": [0.1, 0.2]},
        {"entry": "result", "step": "image", "record": "01-image", "sha256": "1" * 64}
        | {"supersedes": ["00-image"], "pictures": {"ct-1.png": "2" * 64}},
        {"entry": "refused", "step": "fit:T1", "unmet": ["image comes first"]},
        {"entry": "rested", "state": "paused", "reason": "r"},
        {"entry": "resumed", "state": "paused"},
        {"entry": "failed", "step": "fit:T1", "code": "PRO-007", "what": "too far", "files": ["a.txt"]},
        {"entry": "closed", "outcome": "failed", "files": {"request.json": "3" * 64}, "instrument_in": "T1"}
        | {"inputs": {"/nowhere/plan.toml": "4" * 64}},
    )
)

PLACE = json.dumps(
    {
        "series_instance_uid": "1.2.826.0.1.3680043.8.498.7",
        "assumed_robot_from_ct": [520.0, 0.0, 480.0, 10.0, 0.0, -5.0],
        "best_mm": [12.5, -20.0],
        "turned_deg": 0.0,
        "free_mm": 15.0,
        "turns_deg": [5.0, 7.5],
        "squares": [{"x_mm": 1.0, "y_mm": 2.0, "serves": True}],
    }
).encode()
TEMPLATE = b"schema = 1\n" + b"".join(
    b"[[markers]]\ncentre_mm = [%d.0, 10.0, 60.0]\npost = [0.0, 0.0, 1.0]\n" % place for place in (-50, 0, 90)
)
ORDERS = tuple(
    json.dumps({"nonce": "0123456789ab", "session": "0123456789ab", **order}).encode()
    for order in (
        {"kind": "next", "upcoming": "registration:T1"},
        {"kind": "answer", "question": 3, "answer": "yes", "shown": "0" * 64, "readings": [0.01, -1e-3]},
        {"kind": "claim", "name": "A. Person", "expires_s": 12.5},
    )
)
