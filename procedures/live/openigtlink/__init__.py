"""OpenIGTLink server of a running case: its values for Slicer, PLUS and others, who can only read."""
