"""`ronna-tool`: records of the tools that can hang on the arm."""
