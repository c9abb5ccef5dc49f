"""`ronna-tool`: records of tools that can be mounted on the arm."""
