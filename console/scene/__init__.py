"""The theatre in three dimensions, posed here: the page does no kinematics."""
