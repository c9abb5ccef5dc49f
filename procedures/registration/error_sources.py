"""Names of the sources of error at a target, as predictions, budgets, records and reports have them."""

# Spheres and scans.
CT = "CT"
SEATING = "seating of the spheres"
OF_SPHERES = (CT, SEATING)  # of a sphere, however often it is looked at
STEREO = "stereo measurement"
SCAN = "scan as a whole"
SCAN_PLACE = "place of the scan in the CT"  # of one taken during the operation
FUSION = "fusion"

# Skin, in the place of spheres or beside some.
SKIN = "skin that differs from the CT"
LINE = "measurement of the points of the scan"
SPHERES = "spheres beside the skin: CT, seating and stereo measurement"

# Arm.
LINKS = "links and joint offsets"
HARMONICS = "harmonics and sag"
BACKLASH = "backlash"
TOOL_FRAME = "tool frame"
IDENTIFIED = "arm and tool frame as identified"
REPEATABILITY = "repeatability"  # no record scales its size
SERVO = "servo and repeatability"  # instead of it, where the servo's residual is not measured
LACKING = "effects that the arm's model lacks"
SIZES = "sizes of the arm's errors"

# Tools at the target.
STEREO_HEAD = "stereo head calibration"
GUIDE_TIP = "guide tip calibration"
INSTRUMENT = "instrument"
DIRECTION = "guide direction"

# A head that has moved and was followed.
HEAD_MOVE = "measured head movement"
STABILITY = "cart and tracker stability"
