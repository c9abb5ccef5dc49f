"""Assigns each feature its registers: value, smallest, largest and step, four words."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

from ronna_hw.wire.gige_vision import GevStatus
from sim.basler.camera.feature_table import FEATURES
from sim.basler.camera.features import Commands, Feature, Kind, Number, always
from sim.basler.control.registers import Refusal, RegisterMap, Word

FEATURES_ADDRESS = 0x20000  # the standard's own addresses end below 0xA000
BYTES_PER_FEATURE = 16
ADDRESSES = {
    feature.name: FEATURES_ADDRESS + number * BYTES_PER_FEATURE for number, feature in enumerate(FEATURES)
}
MINIMUM_OFFSET, MAXIMUM_OFFSET, STEP_OFFSET = 4, 8, 12


def address_of(name: str) -> int:
    """Address of a feature's value."""
    return ADDRESSES[name]


def add_features(registers: RegisterMap, commands: Commands) -> None:
    """Add the registers of all features."""
    for feature in FEATURES:
        address = address_of(feature.name)
        registers.add(address, _value(feature, commands))
        if feature.minimum is None or feature.maximum is None:
            continue
        registers.add(address + MINIMUM_OFFSET, _limit(feature, feature.minimum, commands))
        registers.add(address + MAXIMUM_OFFSET, _limit(feature, feature.maximum, commands))
        if feature.kind is Kind.INTEGER:
            registers.add(address + STEP_OFFSET, _limit(feature, always(feature.step), commands))


def _value(feature: Feature, commands: Commands) -> Word:
    def read() -> int:
        # A command is never pending: it is done once its register has been written.
        return 0 if feature.read is None else _encode(feature, feature.read(commands))

    def write(word: int) -> None:
        assert feature.write is not None
        if feature.locked and commands.acquiring:
            raise Refusal(GevStatus.BUSY)
        value = _decode(feature, word)
        if not feature.accepts(commands, value):
            raise Refusal(GevStatus.INVALID_PARAMETER)
        feature.write(commands, value)

    return Word(read, None if feature.write is None else write)


def _limit(feature: Feature, limit: Callable[[Commands], Number], commands: Commands) -> Word:
    return Word(lambda: _encode(feature, limit(commands)))


def _encode(feature: Feature, value: Number) -> int:
    if feature.kind is Kind.FLOAT:
        return int(struct.unpack(">I", struct.pack(">f", value))[0])
    return int(value)


def _decode(feature: Feature, word: int) -> Number:
    if feature.kind is not Kind.FLOAT:
        return word
    value = float(struct.unpack(">f", struct.pack(">I", word))[0])
    return value if math.isfinite(value) else math.nan
