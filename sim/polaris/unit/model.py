"""Models: identity, ports, volumes and limits. Serial numbers are invented."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from sim.polaris.optics.measuring_volume import EXTENDED_PYRAMID, PYRAMID, VICRA_VOLUME, Volume


@dataclass(frozen=True)
class UnitModel:
    """One model of unit."""

    name: str
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
    wired_ports: int  # of the tool interface that can be connected; 0 if there is none
    passive_ports: int
    wireless_ports: int
    baud_codes: str
    illuminator_rates: tuple[int, ...]  # codes of IRATE
    longest_command: int


SPECTRA = UnitModel(
    name="Polaris Spectra",
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
    wired_ports=3,
    passive_ports=9,
    wireless_ports=1,
    baud_codes="01234567A",
    illuminator_rates=(0, 1, 2),
    longest_command=1024,
)
VICRA = UnitModel(
    name="Polaris Vicra",
    serial_number="P6-00042",
    firmware="007.000.011",
    combined_revision="014",
    package="014.002",
    api_revision="G.001.005",
    characterization_date="06/05/24",
    freeze_date="01/04/10",
    volumes=(VICRA_VOLUME,),
    handles=24,
    enabled_tools=6,
    wired_ports=0,
    passive_ports=6,
    wireless_ports=1,
    baud_codes="01234567A",
    illuminator_rates=(0,),
    longest_command=1024,
)
UNIT_MODELS: MappingProxyType[str, UnitModel] = MappingProxyType({"spectra": SPECTRA, "vicra": VICRA})
