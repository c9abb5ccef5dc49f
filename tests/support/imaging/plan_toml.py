"""A plan as in a file: one trajectory; a second one and a structure to put behind it."""

from painted_ct import SERIES_UID

PLAN = f"""schema = 1
series_instance_uid = "{SERIES_UID}"
patient_orientation = "HFS"
implanted = 4
fiducials = "free"
tool = "guide"
standoff_mm = 30.0
instrument_length_mm = 250.0

[[trajectories]]
id = "T1"
entry_mm = [10.0, -50.0, 60.0]
target_mm = [5.0, -20.0, 20.0]
margin_mm = 1.5
"""
SECOND = """
[[trajectories]]
id = "T2"
entry_mm = [-20, -40, 70]
target_mm = [-15.5, -10.0, 25.0]
free_angle_deg = 30.0
margin_mm = 2.0
"""
VESSEL = """
[[structures]]
name = "vessel"
margin_mm = 3.0
points_mm = [[9.0, -20.0, 20.0]]
"""
