"""GVSP reception in a separate process, from packets to frames in shared memory."""
