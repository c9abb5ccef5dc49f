"""Results of a case that registers on the skin, in the place of those that need spheres."""

from __future__ import annotations

import math

import numpy as np
from clinical_case import ROBOT_FROM_CT, TRAJECTORIES
from prepared_results import NO_TABLE, SERIES

from procedures.journal.results import FramedPose
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.registration.correspondence import MatchStatus
from procedures.steps.clinical.correspondence import SurfaceStart, SurveyedSkin, TouchedPoint
from procedures.steps.clinical.fiducial_localization import ExcludedSkin, SkinInCt
from procedures.steps.clinical.results import (
    ErrorShare,
    Prediction,
    RegisteredBySurface,
    ScannedLine,
    ScannedSurface,
    SkinRegion,
)
from ronna_hw.vectors import vector3

HEAD = HeadEllipsoid(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(80.0, 95.0, 90.0))
# Points of the skin in the CT, LPS mm: an arc over the forehead.
IN_CT_MM = np.array([(10.0 * x, -95.0 + x * x, 30.0) for x in range(-3, 4)])


def skin_in_ct() -> SkinInCt:
    return SkinInCt(
        series_instance_uid=SERIES,
        diameter_mm=11.5,
        markers=(),
        doubtful=(),
        samples=20_000,
        excluded=(ExcludedSkin(reason="edge of the scan", share=0.02, middle_mm=(0.0, 0.0, -120.0)),),
        cranium=HEAD,
        face=HEAD,
    )


def surface_start() -> SurfaceStart:
    in_ct_mm = {"tip of the nose": (0.0, -95.0, 0.0), "left ear": (80.0, 0.0, 0.0)}
    touched = [
        TouchedPoint(
            landmark=name, in_ct_mm=place, touched_mm=vector3(ROBOT_FROM_CT.apply(place)), off_mm=1.5
        )
        for name, place in (in_ct_mm | {"T1": (30.0, -40.0, 70.0)}).items()
    ]
    return SurfaceStart(
        status=MatchStatus.UNIQUE,
        pairs=(),
        robot_from_ct=FramedPose.of(ROBOT_FROM_CT),
        residuals_mm=(),
        margin_nats=None,
        two_way=NO_TABLE,
        landmarks=tuple(touched[:2]),
        turn_sd_rad=0.02,
        place_sd_mm=4.0,
        site=touched[2],
    )


def surveyed_start() -> SurfaceStart:
    """Return the start of the same head by first looks."""
    survey = SurveyedSkin(
        looks=9,
        lines=25,
        points=120,
        coverage=0.05,
        rms_mm=0.4,
        from_measured_mm=14.0,
        from_measured_rad=math.radians(8.0),
        theatre_s=41.0,
    )
    return surface_start().model_copy(update={"landmarks": (), "survey": survey})


def scanned_surface() -> ScannedSurface:
    points_mm = np.asarray(ROBOT_FROM_CT.apply(IN_CT_MM))
    lines = [
        ScannedLine(
            look=look,
            joints_rad=(0.0,) * 6,
            view_mm=vector3(points_mm.mean(axis=0) + np.array([0.0, 0.0, 300.0])),
            points_mm=tuple(map(vector3, points_mm)),
            covariances_mm2=((4e-4, 0.0, 0.0, 4e-4, 0.0, 9e-4),) * len(points_mm),
        )
        for look in range(2)
    ]
    return ScannedSurface.without_spheres(
        coarse_offset_mm=(0.0, 0.0, 0.0),
        lines=lines,
        planned_looks=3,
        dark={"3": "no laser line in view"},
        covered=0.21,
        theatre_s=98.0,
    )


def registered_by_surface() -> RegisteredBySurface:
    return RegisteredBySurface(
        robot_from_ct=FramedPose.of(ROBOT_FROM_CT),
        pairs=0,
        fre_mm=0.4,
        residuals_mm=(),
        leave_one_out_mm=(),
        predictions=tuple(
            Prediction(
                target=name,
                rms_mm=0.5,
                limit_mm=0.9,
                confidence=0.95,
                formula="",
                budget=(ErrorShare(source="skin", rms_mm=0.4), ErrorShare(source="links", rms_mm=0.3)),
            )
            for name in TRAJECTORIES
        ),
        two_way=NO_TABLE,
        points=14,
        excluded=0.1,
        coverage=0.21,
        misfit_mm=0.3,
        misfit_length_mm=25.0,
        side_proven=False,
        changed=(SkinRegion(parts=("left ear",), shift_mm=1.5),),
    )
