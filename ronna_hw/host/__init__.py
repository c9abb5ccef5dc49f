"""Host computer: processes, memory, files, networks and ports."""
