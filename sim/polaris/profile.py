"""What kind of unit this is: identity, limits, and how it behaves where units or papers differ."""

from __future__ import annotations

from dataclasses import dataclass

from sim.polaris.refusal import ErrorCode
from sim.polaris.volume import EXTENDED_PYRAMID, PYRAMID, Volume


@dataclass(frozen=True)
class Profile:
    """One kind of unit. Fields after `unconfirmed` are behaviours that no public source settles."""

    model: str
    serial_number: str
    firmware: str  # major.minor.build
    combined_revision: str
    package: str
    api_revision: str
    characterization_date: str  # MM/DD/YY
    freeze_date: str
    volumes: tuple[Volume, ...]
    handles: int
    enabled_tools: int
    passive_ports: int
    baud_codes: str
    illuminator_rate: int  # as the last user saved it: index into ILLUMINATOR_RATES_HZ
    longest_command: int
    # unconfirmed:
    bad_definition: ErrorCode = ErrorCode.BAD_DEFINITION
    accepts_lower_case: bool = False
    poses_partially_out: bool = True  # report a pose when too few, but some, markers are inside
    first_stray_is_high_bit: bool = True  # TX: the digits are one number, stray 0 its highest bit
    first_marker_is_first_digit: bool = True  # TX, option 0002
    first_marker_is_first_nibble: bool = False  # BX, option 0002


SPECTRA = Profile(
    model="Polaris Spectra",
    serial_number="P7-00042",
    firmware="007.000.012",
    combined_revision="024",
    package="024.002",
    api_revision="G.001.005",
    characterization_date="06/05/24",
    freeze_date="01/04/10",
    volumes=(PYRAMID, EXTENDED_PYRAMID),
    handles=24,
    enabled_tools=15,
    passive_ports=9,
    baud_codes="01234567A",
    illuminator_rate=2,
    longest_command=1024,
)
