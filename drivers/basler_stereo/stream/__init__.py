"""GVSP reception in a separate process: from stream packets to frames in shared memory."""
