"""Arm and controller that were found: their identity, and what the theatre file demands of them."""

from __future__ import annotations

from drivers.universal_robots.errors import (
    CONTROLLER_EXCHANGED,
    FACTORY_CALIBRATION_DIFFERS,
    WRONG_ARM,
    WRONG_VERSION,
)
from drivers.universal_robots.generations import GENERATIONS, arm_of_version
from drivers.universal_robots.options import UrOptions
from drivers.universal_robots.primary.packages import KinematicsInfo
from drivers.universal_robots.rtde import Version
from ronna_hw.arm.catalogue import UNIVERSAL_ROBOTS, find_arm
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.devices.lifecycle import Identity

CALIBRATION = "calibration"  # among the details of an identity


def require_version(name: str, options: UrOptions, version: Version) -> None:
    """Raise URD-004 for software that lacks what the stream needs."""
    generation = GENERATIONS[options.model]
    if version.major == generation.major and version.minor < generation.least_minor:
        raise WRONG_VERSION(
            f"{name}: the controller's software is too old",
            expected=f"{generation.major}.{generation.least_minor} or newer",
            got=str(version),
        )


def require_arm(name: str, options: UrOptions, model: str, serial: str, version: Version) -> None:
    """Raise URD-003 for another model or serial number; `model` is the dashboard's word."""
    reported_as = find_arm(options.model).reported_as
    if model != reported_as or version.major != GENERATIONS[options.model].major:
        raise WRONG_ARM(
            f"{name}: the controller drives another arm",
            expected=f"option model, {options.model}",
            got=_arm_text(model, version, reported_as),
        )
    if options.serial and serial != options.serial:
        raise WRONG_ARM(
            f"{name}: the arm has another serial number",
            expected=f"option serial, {options.serial}",
            got=serial,
        )


def identity_of(options: UrOptions, serial: str, version: Version, info: KinematicsInfo) -> Identity:
    """Return the identity of arm, controller and factory calibration."""
    details = ((CALIBRATION, info.fingerprint), ("cycle_ms", f"{options.cycle_s * 1e3:g}"))
    return Identity(UNIVERSAL_ROBOTS, options.model, serial, str(version), details)


def require_same(name: str, first: Identity | None, found: Identity) -> None:
    """Raise URD-042 for another arm or controller than was found first."""
    if first is not None and first != found:
        raise CONTROLLER_EXCHANGED(
            f"{name}: another arm or controller answers than at the start",
            expected=_describe(first),
            got=_describe(found),
        )


def require_calibration(name: str, options: UrOptions, info: KinematicsInfo) -> FactoryCalibration | None:
    """Return the factory calibration to compute with, if any; raises URD-005 or ARM-010."""
    if options.calibration and info.fingerprint != options.calibration:
        raise FACTORY_CALIBRATION_DIFFERS(
            f"{name}: the controller has the factory calibration of another arm",
            expected=f"option calibration, {options.calibration}",
            got=info.fingerprint,
        )
    if not options.factory_calibration:
        return None
    nominal = universal_robot(options.model).dimensions
    return FactoryCalibration.from_parameters(nominal, info.theta_rad, info.a_mm, info.d_mm, info.alpha_rad)


def _describe(identity: Identity) -> str:
    calibration = dict(identity.details)[CALIBRATION]
    return f"{identity.serial}, software {identity.firmware}, calibration {calibration}"


def _arm_text(model: str, version: Version, reported_as: str) -> str:
    """Say which arm the controller drives, and how that is known."""
    found = arm_of_version(version.major)
    if model != reported_as or found is None:
        return f"{model}, software {version}"
    return (
        f"{found}: the dashboard calls both generations {reported_as}, and software {version} is that of "
        f"{GENERATIONS[found].text}"
    )
