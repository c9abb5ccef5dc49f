"""GVSP: from stream packets to frames in shared memory, received in a separate process."""
