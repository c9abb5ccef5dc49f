"""GVSP: from stream packets to frames in shared memory, received by a process of its own."""
