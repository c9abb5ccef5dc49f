"""Theatre and head in three dimensions, posed here: the page does no kinematics."""
