"""The stream side of a camera (GVSP): frames to packets, at the pace of the link, again on demand."""
