"""`ronna-tool`: records of the tools that can be mounted on the arm."""
