"""All features, in the order of their registers. Names as in the camera family (SFNC 1.x)."""

from __future__ import annotations

from sim.basler.camera.acquisition_features import ACQUISITION_FEATURES
from sim.basler.camera.event_features import EVENT_FEATURES
from sim.basler.camera.exposure_features import EXPOSURE_FEATURES
from sim.basler.camera.features import Feature
from sim.basler.camera.image_features import IMAGE_FEATURES
from sim.basler.camera.transport_features import TRANSPORT_FEATURES

FEATURES: tuple[Feature, ...] = (
    IMAGE_FEATURES + ACQUISITION_FEATURES + EXPOSURE_FEATURES + TRANSPORT_FEATURES + EVENT_FEATURES
)
