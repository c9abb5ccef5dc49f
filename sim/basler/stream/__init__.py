"""The stream side of a camera (GVSP): frames to packets, at the pace of the link, resent on request."""
