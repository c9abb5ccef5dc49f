"""Content of the report, section by section, as its templates print it."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.reporting.files import Picture, PostoperativeResult
from procedures.reporting.run_reading import UsedRegistration
from procedures.reporting.sections.calibration import Calibration
from procedures.reporting.sections.course import Course
from procedures.reporting.sections.devices import Devices
from procedures.reporting.sections.evidence import Evidence
from procedures.reporting.sections.header import Header
from procedures.reporting.sections.plan import PlanSection
from procedures.reporting.sections.spheres import Spheres
from procedures.reporting.sections.stability import Stability
from procedures.reporting.sections.targets import Targets
from procedures.reporting.sections.verdict import Verdict


@dataclass(frozen=True)
class Page:
    """Sections of a report, in the order of the page. What a run has not come to is None or empty."""

    header: Header
    verdict: Verdict
    calibration: Calibration
    after: PostoperativeResult | None
    plan_pictures: tuple[Picture, ...]
    targets: Targets | None
    stability: Stability | None
    plan: PlanSection | None
    registrations: tuple[UsedRegistration, ...]
    spheres: Spheres
    course: Course
    devices: Devices
    evidence: Evidence
