"""Possible positions of the arm's cart: judged as in the path check, and the best one."""
