"""Host computer facilities: processes, memory, files, networks and ports."""
