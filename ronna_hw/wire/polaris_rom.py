"""Layout of an NDI tool definition (.rom): offsets and sizes of a 752-byte block, little endian.

Only the layout is here. Readers and writers of definitions have their own code.
"""

from __future__ import annotations

from typing import Final

ROM_BYTES: Final = 752
ROM_FILE_LIMIT_BYTES: Final = 960
ROM_MAGIC: Final = b"NDI\x00"
ROM_MARKERS: Final = 20  # slots; at least 3 are used
ROM_FACES: Final = 8
ROM_MINIMUM_MARKERS: Final = 3

CHECKSUM_OFFSET: Final = 4  # u16: sum of all bytes from CHECKSUM_FROM to the end, modulo 65536
CHECKSUM_FROM: Final = 6
CONSTANT_ONE_OFFSET: Final = 8  # u8, always 1
SUBTYPE_OFFSET: Final = 12  # u8
SUBTYPE_BELOW_TYPE: Final = 1  # real files have main type minus 1 as the subtype
MAIN_TYPE_OFFSET: Final = 15  # u8
REVISION_OFFSET: Final = 16  # u16
SERIAL_OFFSET: Final = 20  # u32, fields below
MAXIMUM_ANGLE_OFFSET: Final = 24  # u8, degrees
MARKER_COUNT_OFFSET: Final = 28  # u8
MINIMUM_MARKER_COUNT_OFFSET: Final = 32  # u8
MAXIMUM_ERROR_OFFSET: Final = 36  # f32, mm
MINIMUM_SPREAD_OFFSET: Final = 40  # 3 f32, mm
CONSTANT_TEN_OFFSET: Final = 64  # f32, 10.0 in every real file seen
MARKER_POSITIONS_OFFSET: Final = 72  # 20 x 3 f32, mm
MARKER_NORMALS_OFFSET: Final = 312  # 20 x 3 f32
FIRING_SEQUENCE_OFFSET: Final = 552  # 20 u8: 0, 1, 2, ...
LEDS_OFFSET: Final = 572  # 4 u8: tracking LED, LED 1-3
TOOL_IN_PORT_OFFSET: Final = 576  # u8
MANUFACTURER_OFFSET: Final = 580  # 12 characters, zero padded
MANUFACTURER_BYTES: Final = 12
PART_NUMBER_OFFSET: Final = 592  # 20 characters, zero padded
PART_NUMBER_BYTES: Final = 20
CONSTANT_NINE_OFFSET: Final = 612  # u8, 9 in definitions for today's units
MARKER_FACES_OFFSET: Final = 613  # 20 u8: face of each marker, from 1; 0 is an unused slot
MARKER_GROUPS_OFFSET: Final = 633  # 20 u8
FLAGS_OFFSET: Final = 653  # u8
MARKER_TYPE_OFFSET: Final = 655  # u8
FACE_NORMALS_OFFSET: Final = 656  # 8 x 3 f32

SERIAL_SEQUENCE_BITS: Final = (0, 10)  # lowest bit, number of bits
SERIAL_DAY_BITS: Final = (10, 9)  # from 0
SERIAL_MONTH_BITS: Final = (19, 4)  # from 0
SERIAL_YEAR_BITS: Final = (23, 9)  # since 1900
SERIAL_FIRST_YEAR: Final = 1900

LED_NONE: Final = 31
TOOL_IN_PORT_PRESENT: Final = 9
FLAG_UNIQUE_GEOMETRY: Final = 0x80
MARKER_PASSIVE_SPHERE: Final = 41  # 0x29
MARKER_PASSIVE_DISC: Final = 49
MARKER_RADIX_LENS: Final = 57

# Byte 15, as reported by PHINF.
MAIN_TYPE_UNKNOWN: Final = 0
MAIN_TYPE_REFERENCE: Final = 1
MAIN_TYPE_POINTER: Final = 2
MAIN_TYPE_BUTTON_BOX: Final = 3
MAIN_TYPE_USER_DEFINED: Final = 4
MAIN_TYPE_MICROSCOPE: Final = 5
MAIN_TYPE_CALIBRATION_BLOCK: Final = 7
MAIN_TYPE_DOCK: Final = 8
MAIN_TYPE_ISOLATION_BOX: Final = 9
MAIN_TYPE_C_ARM: Final = 10
MAIN_TYPE_CATHETER: Final = 11
MAIN_TYPE_GPIO: Final = 12
MAIN_TYPE_SCAN_REFERENCE: Final = 14
