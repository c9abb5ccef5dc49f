"""3-D scenes of theatre and head, posed on the server so that the page needs no kinematics."""
