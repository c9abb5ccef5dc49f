"""Modes of the unit and the commands allowed in each."""

from __future__ import annotations

from enum import Enum, StrEnum, auto

from sim.polaris.unit.behaviour import UnitBehaviour


class Mode(StrEnum):
    """The unit's modes, in the terms of `Info.Status.System Mode`."""

    NOT_INITIALISED = "Booted"
    SETUP = "Initialized"
    TRACKING = "Tracking"
    DIAGNOSTIC = "Diagnostic"


class Group(Enum):
    """Commands that are allowed in the same modes."""

    RESTART = auto()  # INIT, RESET
    READING = auto()  # APIREV, GET, GETINFO, ECHO, BEEP
    IDENTITY = auto()  # VER, COMM
    ADJUSTING = auto()  # SET, which may be allowed while tracking
    SETTINGS = auto()
    HANDLES = auto()
    STARTING = auto()
    FRAMES = auto()
    OUTPUTS = auto()
    DIAGNOSTICS = auto()


def modes_of(group: Group, behaviour: UnitBehaviour) -> frozenset[Mode]:
    """The modes in which the commands of a group are allowed."""
    early = {Mode.NOT_INITIALISED} if behaviour.answers_before_init else set()
    settings = {Mode.DIAGNOSTIC} if behaviour.settings_in_diagnostic else set()
    settings |= {Mode.TRACKING} if behaviour.settings_while_tracking else set()
    handles = {Mode.DIAGNOSTIC} if behaviour.handles_in_diagnostic else set()
    identity = {Mode.TRACKING} if behaviour.identity_while_tracking else set()
    running = {Mode.SETUP, Mode.TRACKING, Mode.DIAGNOSTIC}
    modes: dict[Group, set[Mode]] = {
        Group.RESTART: set(Mode),
        Group.READING: running | early,
        Group.IDENTITY: {Mode.SETUP, Mode.DIAGNOSTIC} | identity | early,
        Group.ADJUSTING: {Mode.SETUP, Mode.TRACKING} | settings,
        Group.SETTINGS: {Mode.SETUP} | settings,
        Group.HANDLES: {Mode.SETUP} | handles,
        Group.STARTING: {Mode.SETUP},
        Group.FRAMES: {Mode.TRACKING},
        Group.OUTPUTS: running,
        Group.DIAGNOSTICS: {Mode.DIAGNOSTIC},
    }
    return frozenset(modes[group])
