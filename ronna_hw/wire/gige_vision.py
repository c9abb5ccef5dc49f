"""GigE Vision constants: command codes, addresses, status codes, pixel formats, header layouts.

Control (GVCP) and stream (GVSP) are UDP, every field big-endian. Layouts are format strings of Python's
`struct`, always with an explicit byte order; each side does its own packing and unpacking.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag

GVCP_PORT = 3956  # fixed by the standard, on the device's side
GVCP_KEY = 0x42  # first byte of every command; other datagrams are ignored
GVCP_HEADER_BYTES = 8
GVCP_COMMAND_HEADER = ">BBHHH"  # key, flags, command, payload length in bytes, request id
GVCP_ACK_HEADER = ">HHHH"  # status, answer code, payload length in bytes, request id
GVCP_PAYLOAD_LIMIT = 540  # bytes after the header
READMEM_LIMIT = 536  # bytes of one READMEM, a multiple of 4
REGISTER_BYTES = 4
REQUEST_ID_FIRST = 1  # 0 is never used
REQUEST_ID_LAST = 0xFFFF


class GvcpFlag(IntFlag):
    """Flags in the second byte of a command; devices mask them instead of comparing the whole byte."""

    ACK_REQUIRED = 0x01
    BROADCAST_ACK = 0x10  # DISCOVERY: the answer may be broadcast
    EXTENDED_ID = 0x10  # PACKETRESEND: 64-bit block id and 32-bit packet ids follow
    SCHEDULED = 0x80  # ACTION: a 64-bit time follows


class GvcpCommand(IntEnum):
    """Command codes; an acknowledge, if any, has the command code plus one."""

    DISCOVERY = 0x0002
    DISCOVERY_ACK = 0x0003
    FORCEIP = 0x0004
    FORCEIP_ACK = 0x0005
    PACKETRESEND = 0x0040  # has no answer
    READREG = 0x0080
    READREG_ACK = 0x0081
    WRITEREG = 0x0082
    WRITEREG_ACK = 0x0083
    READMEM = 0x0084
    READMEM_ACK = 0x0085
    WRITEMEM = 0x0086
    WRITEMEM_ACK = 0x0087
    PENDING_ACK = 0x0089  # not finished, keep waiting
    EVENT = 0x00C0  # from the device, on the message channel
    EVENT_ACK = 0x00C1
    EVENTDATA = 0x00C2
    EVENTDATA_ACK = 0x00C3
    ACTION = 0x0100
    ACTION_ACK = 0x0101


READREG_ITEM = ">I"  # address; repeated
READREG_ACK_ITEM = ">I"  # value; repeated
WRITEREG_ITEM = ">II"  # address, value; repeated
WRITE_ACK = ">HH"  # reserved, index: pairs (WRITEREG) or bytes (WRITEMEM) written, or the failing index
READMEM_COMMAND = ">IHH"  # address, reserved, count in bytes
READMEM_ACK_HEAD = ">I"  # address; the data follow
WRITEMEM_HEAD = ">I"  # address; the data follow
PENDING_PAYLOAD = ">HH"  # reserved, time to completion in ms
PACKETRESEND_COMMAND = ">HHII"  # stream channel, block id, first packet id, last packet id
PACKETRESEND_EXTENDED = ">HHIIQ"  # the same with 32-bit packet ids, then the 64-bit block id
ACTION_COMMAND = ">III"  # device key, group key, group mask
# reserved, event id, stream channel, block id, time stamp in ticks. EVENT: repeated; EVENTDATA: data follow
EVENT_ITEM = ">HHHHQ"
EVENT_ITEM_BYTES = 16
FORCEIP_BYTES = 56
FORCEIP_MAC_OFFSET = 2  # 6 bytes
FORCEIP_ADDRESS_OFFSET = 20


class GevStatus(IntEnum):
    """Status codes of acknowledges and stream packets."""

    SUCCESS = 0x0000
    PACKET_RESEND = 0x0100  # stream only: this packet is a repetition
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    BUSY = 0x8007
    LOCAL_PROBLEM = 0x8008
    MESSAGE_MISMATCH = 0x8009
    INVALID_PROTOCOL = 0x800A
    NO_MESSAGE = 0x800B
    PACKET_UNAVAILABLE = 0x800C
    DATA_OVERRUN = 0x800D
    INVALID_HEADER = 0x800E
    PACKET_NOT_YET_AVAILABLE = 0x8010
    PACKET_AND_PREVIOUS_REMOVED = 0x8011
    PACKET_REMOVED = 0x8012
    NO_REFERENCE_TIME = 0x8013
    PACKET_TEMPORARILY_UNAVAILABLE = 0x8014
    OVERFLOW = 0x8015
    ACTION_LATE = 0x8016
    LEADER_TRAILER_OVERFLOW = 0x8017
    ERROR = 0x8FFF


DISCOVERY_BYTES = 248  # a discovery answer is the memory from 0 to here


class Bootstrap(IntEnum):
    """Bootstrap register addresses, common to all devices: u32, or of the length in `TEXT_BYTES`."""

    VERSION = 0x0000  # major << 16 | minor
    DEVICE_MODE = 0x0004
    MAC_HIGH = 0x0008  # low 16 bits
    MAC_LOW = 0x000C
    IP_CONFIGURATION_SUPPORTED = 0x0010
    IP_CONFIGURATION = 0x0014
    CURRENT_ADDRESS = 0x0024
    CURRENT_MASK = 0x0034
    CURRENT_GATEWAY = 0x0044
    MANUFACTURER_NAME = 0x0048
    MODEL_NAME = 0x0068
    DEVICE_VERSION = 0x0088
    MANUFACTURER_INFO = 0x00A8
    SERIAL_NUMBER = 0x00D8
    USER_DEFINED_NAME = 0x00E8
    FIRST_URL = 0x0200
    SECOND_URL = 0x0400
    NETWORK_INTERFACES = 0x0600
    PERSISTENT_ADDRESS = 0x064C
    PERSISTENT_MASK = 0x065C
    PERSISTENT_GATEWAY = 0x066C
    MESSAGE_CHANNELS = 0x0900
    STREAM_CHANNELS = 0x0904
    MESSAGE_CHANNEL_CAPABILITY = 0x092C
    STREAM_CHANNEL_CAPABILITY = 0x0930
    GVCP_CAPABILITY = 0x0934
    HEARTBEAT_TIMEOUT_MS = 0x0938
    TICK_FREQUENCY_HIGH = 0x093C
    TICK_FREQUENCY_LOW = 0x0940
    TIMESTAMP_CONTROL = 0x0944
    TIMESTAMP_HIGH = 0x0948  # latched
    TIMESTAMP_LOW = 0x094C
    GVCP_CONFIGURATION = 0x0954
    PENDING_TIMEOUT_MS = 0x0958
    CCP = 0x0A00
    PRIMARY_APPLICATION_PORT = 0x0A04  # the application in control; 0 if there is none
    PRIMARY_APPLICATION_ADDRESS = 0x0A14
    MCP = 0x0B00  # host port in the low 16 bits; 0 closes the channel
    MCDA = 0x0B10  # destination address
    MCTT_MS = 0x0B14  # how long to wait for an acknowledge; 0: none is requested
    MCRC = 0x0B18  # number of retries of a message
    MCSP = 0x0B1C  # source port
    SCP = 0x0D00  # host port in the low 16 bits; 0 closes the channel
    SCPS = 0x0D04
    SCPD = 0x0D08  # inter-packet delay in ticks
    SCDA = 0x0D18  # destination address; 0.0.0.0: the application in control
    SCSP = 0x0D1C  # source port
    SCC = 0x0D20  # capabilities of the stream channel
    SCCFG = 0x0D24  # configuration of the stream channel


TEXT_BYTES: dict[Bootstrap, int] = {
    Bootstrap.MANUFACTURER_NAME: 32,
    Bootstrap.MODEL_NAME: 32,
    Bootstrap.DEVICE_VERSION: 32,
    Bootstrap.MANUFACTURER_INFO: 48,
    Bootstrap.SERIAL_NUMBER: 16,
    Bootstrap.USER_DEFINED_NAME: 16,
    Bootstrap.FIRST_URL: 512,
    Bootstrap.SECOND_URL: 512,
}
"""Length in bytes of the text registers; shorter text is padded with zeros."""

DEVICE_MODE_BIG_ENDIAN = 0x8000_0000
DEVICE_MODE_UTF8 = 0x0000_0001
URL_LOCAL = "Local:"  # Local:name;address;length, both hexadecimal without prefix

CCP_OPEN = 0
CCP_EXCLUSIVE = 1
CCP_CONTROL = 2

HEARTBEAT_MINIMUM_MS = 500
TIMESTAMP_RESET = 1
TIMESTAMP_LATCH = 2
GVCP_CONFIGURATION_EXTENDED_STATUS = 2

SCPS_FIRE_TEST = 0x8000_0000  # clears itself
SCPS_DO_NOT_FRAGMENT = 0x4000_0000
SCPS_SIZE_MASK = 0x0000_FFFF  # packet size including IP and UDP headers
SCP_PORT_MASK = 0x0000_FFFF
MCP_PORT_MASK = 0x0000_FFFF


class GvcpCapability(IntFlag):
    """Bits of the GVCP capability register."""

    MULTIPLE_REGISTERS = 1 << 0
    WRITEMEM = 1 << 1
    PACKETRESEND = 1 << 2
    EVENT = 1 << 3
    EVENTDATA = 1 << 4
    PENDING_ACK = 1 << 5
    ACTION = 1 << 6
    EXTENDED_STATUS = 1 << 22
    TEST_DATA = 1 << 25
    CCP_APPLICATION = 1 << 27  # the registers of the primary application
    LINK_SPEED = 1 << 28
    HEARTBEAT_DISABLE = 1 << 29
    SERIAL_NUMBER = 1 << 30
    USER_DEFINED_NAME = 1 << 31


IP_UDP_HEADER_BYTES = 28
GVSP_HEADER_BYTES = 8
GVSP_HEADER = ">HHI"  # status, block id, then one word: see the masks below
GVSP_EXTENDED_ID_BIT = 0x8000_0000
GVSP_FORMAT_SHIFT = 24
GVSP_FORMAT_MASK = 0x7F  # after the shift
GVSP_PACKET_ID_MASK = 0x00FF_FFFF
GVSP_OVERHEAD_BYTES = IP_UDP_HEADER_BYTES + GVSP_HEADER_BYTES  # packet size minus this is image data
BLOCK_ID_FIRST = 1  # 0 is never used; restarts with every AcquisitionStart
BLOCK_ID_LAST = 0xFFFF
LEADER_PACKET_ID = 0  # payload packets are 1..n, the trailer is n + 1


class GvspFormat(IntEnum):
    """GVSP packet kinds."""

    LEADER = 1
    TRAILER = 2
    PAYLOAD = 3
    ALL_IN = 4


class PayloadType(IntEnum):
    """Payload types of a stream block."""

    IMAGE = 1
    RAW = 2
    CHUNK = 4
    IMAGE_WITH_CHUNK = 0x4001


# field info, payload type, time stamp in ticks, pixel format, size x, y, offset x, y, padding x, y
GVSP_LEADER = ">HHQIIIIIHH"
GVSP_LEADER_BYTES = 36
GVSP_TRAILER = ">HHI"  # reserved, payload type, size y


class PixelFormat(IntEnum):
    """Pixel formats of the camera family; bits 16 to 23 encode the bits per pixel."""

    MONO8 = 0x0108_0001
    MONO12 = 0x0110_0005  # 16-bit little-endian samples, value in the low 12 bits
    MONO12_PACKED = 0x010C_0006  # two pixels in three bytes: p0[11:4], p1[3:0] << 4 | p0[3:0], p1[11:4]


PIXEL_FORMAT_BITS_SHIFT = 16
PIXEL_FORMAT_BITS_MASK = 0xFF  # after the shift: bits per pixel

BASLER = "Basler"
ACA2000_50GM_NIR = "acA2000-50gmNIR"
SENSOR_WIDTH_PX = 2048
SENSOR_HEIGHT_PX = 1088
PIXEL_PITCH_UM = 5.5
TICK_FREQUENCY_HZ = 125_000_000  # of the time stamps while PTP is off
EXPOSURE_MINIMUM_US = 24
EXPOSURE_MAXIMUM_US = 1_000_000
GAIN_RAW_MINIMUM = 36  # dB = 20 log10(raw / 32)
GAIN_RAW_MAXIMUM = 512
GAIN_RAW_UNITY = 32
AREA_STEP_X_PX = 16  # of Width and OffsetX; rows go by single steps
