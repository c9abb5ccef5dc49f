"""Tables 2, 3 and 4 of F. Šuligoj's thesis (Zagreb 2018), row by row, in mm, as printed; figures of 3.2.

Table 2 contains the localization errors against the truth, table 3 the residuals of ten registrations between
scans of four fiducials. Table 4 contains the mean errors at the target over eight positions of the phantom.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

LINE_FIT, SPHERE_FIT, HUMAN_OPERATORS = "LineFit", "SphereFit", "human operators"
OPERATORS = ("operator 1", "operator 2", "operator 3", "operator 4")
AVERAGE_OPERATOR = "average operator"
FIDUCIALS_OF_TABLE_3 = 4


@dataclass(frozen=True)
class ThesisColumn:
    """A table column: its rows, and the summary figure printed below them."""

    rows_mm: tuple[float, ...]
    printed_mm: float


@dataclass(frozen=True)
class StrategyRow:
    """A strategy's mean error for each trajectory, with the printed overall figures."""

    trajectories_mm: tuple[float, ...]
    mean_mm: float
    sd_mm: float
    largest_mm: float
    least_mm: float


TABLE_2: Mapping[str, ThesisColumn] = {  # FLE in five image sets of the phantom; their mean
    HUMAN_OPERATORS: ThesisColumn((0.2956, 0.3043, 0.2243, 0.3558, 0.4146), 0.3189),
    LINE_FIT: ThesisColumn((0.0986, 0.1627, 0.0678, 0.2354, 0.2780), 0.1685),
    SPHERE_FIT: ThesisColumn((0.1030, 0.0799, 0.1042, 0.2307, 0.2907), 0.1617),
}

# FRE of ten registrations; the FLE. Two printed figures do not follow from their rows: operator 3's is
# truncated, and the average operator's is the mean of the four FLE, while its rows (the means of the four, in
# another order) give 0.4601.
TABLE_3: Mapping[str, ThesisColumn] = {
    "operator 1": ThesisColumn(
        (0.3471, 0.5055, 0.504, 0.413, 0.7072, 0.5486, 0.3625, 0.3085, 0.459, 0.2483), 0.4583
    ),
    "operator 2": ThesisColumn(
        (0.2454, 0.3918, 0.1204, 0.1664, 0.6116, 0.2623, 0.2946, 0.3788, 0.3697, 0.1653), 0.3306
    ),
    "operator 3": ThesisColumn(
        (0.3123, 0.4241, 0.3983, 0.3678, 0.5293, 0.3361, 0.2779, 0.3843, 0.3205, 0.2648), 0.3690
    ),
    "operator 4": ThesisColumn(
        (0.4643, 0.8468, 0.6072, 0.7419, 0.761, 0.4719, 0.7309, 0.5366, 1.0682, 0.7636), 0.7211
    ),
    AVERAGE_OPERATOR: ThesisColumn(
        (0.3605, 0.4075, 0.4047, 0.4021, 0.4222, 0.4165, 0.5543, 0.3423, 0.5421, 0.6523), 0.4698
    ),
    LINE_FIT: ThesisColumn(
        (0.1748, 0.0638, 0.2018, 0.2857, 0.1327, 0.3568, 0.1466, 0.2458, 0.2470, 0.4830), 0.2604
    ),
    SPHERE_FIT: ThesisColumn(
        (0.1218, 0.0731, 0.2125, 0.2785, 0.1300, 0.2506, 0.2508, 0.1798, 0.3310, 0.4673), 0.2541
    ),
}

TABLE_4: Mapping[tuple[str, int], StrategyRow] = {  # by strategy and number of fiducials
    ("NOS", 3): StrategyRow(
        (1.645, 1.665, 1.925, 1.586, 1.705, 1.378, 1.374, 1.383, 1.444, 1.602), 1.571, 0.256, 2.245, 1.081
    ),
    ("NOS", 4): StrategyRow(
        (1.545, 1.600, 1.752, 1.325, 1.506, 1.179, 1.166, 1.228, 1.294, 1.378), 1.397, 0.283, 2.105, 0.804
    ),
    ("NOS", 5): StrategyRow(
        (1.466, 1.533, 1.667, 1.244, 1.452, 1.120, 1.095, 1.174, 1.233, 1.291), 1.327, 0.274, 2.007, 0.770
    ),
    ("OCS", 3): StrategyRow(
        (0.346, 0.380, 0.616, 0.556, 0.338, 0.289, 0.388, 0.320, 0.473, 0.583), 0.429, 0.133, 0.773, 0.201
    ),
    ("OCS", 4): StrategyRow(
        (0.238, 0.296, 0.401, 0.231, 0.271, 0.367, 0.224, 0.232, 0.310, 0.275), 0.284, 0.068, 0.486, 0.153
    ),
    ("OCS", 5): StrategyRow(
        (0.210, 0.260, 0.338, 0.167, 0.292, 0.397, 0.231, 0.221, 0.265, 0.222), 0.260, 0.076, 0.442, 0.128
    ),
    ("JDMS", 4): StrategyRow(
        (0.353, 0.308, 0.705, 0.283, 0.363, 0.543, 0.628, 0.482, 0.546, 0.713), 0.493, 0.176, 0.834, 0.194
    ),
    ("JDMS", 5): StrategyRow(
        (0.254, 0.247, 0.575, 0.151, 0.323, 0.310, 0.517, 0.372, 0.393, 0.548), 0.369, 0.160, 0.691, 0.016
    ),
}

NEUROMATE_IN_VITRO_MM: Mapping[str, tuple[float, float]] = {  # mean and sd at the target, as 3.2 cites them
    "Neuromate, with a frame": (0.86, 0.32),
    "Neuromate, frameless": (1.95, 0.44),
}
