"""The computer the code runs on: processes, memory, files, networks and ports."""
