"""The stream side of a camera (GVSP): frames as packets, at link speed, resent on request."""
