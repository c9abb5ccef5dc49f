"""3-D scenes of theatre and head. Poses are computed on the server, so the page needs no kinematics."""
