"""The postoperative check: bone registration of two CTs, detection of inserted objects, and their errors."""
