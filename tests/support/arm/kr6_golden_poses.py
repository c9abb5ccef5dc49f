"""Flange poses of both KR 6 R900, computed elsewhere: for the model of the project and the simulator's."""

# Axes in deg, X Y Z of the sixx, X Y Z of the -2, A B C of both; computed elsewhere from the public
# description of the arm. Three decimals, so the nearest value may be half a unit away.
GOLDEN = [
    ((0, -90, 90, 0, 0, 0), (525, 0, 890), (535, 0, 880), (0, 90, 0)),
    ((0, -90, 90, 0, 90, 0), (445, 0, 810), (445, 0, 790), (180, 0, 180)),
    ((0, 0, 0, 0, 0, 0), (980, 0, 435), (990, 0, 425), (0, 90, 0)),
    (
        (30, -75, 110, -20, 45, 60),
        (462.372, -244.610, 551.274),
        (460.329, -240.638, 533.584),
        (-163.174, 18.179, 178.797),
    ),
    (
        (-45, -120, 130, 15, -60, -100),
        (176.974, 202.333, 814.536),
        (178.670, 207.199, 812.058),
        (145.348, 8.181, 41.879),
    ),
    (
        (10, -60, 80, 0, 70, 0),
        (649.128, -114.459, 603.282),
        (645.760, -113.865, 583.885),
        (170, 0, 180),
    ),
]
