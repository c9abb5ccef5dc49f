"""Possible positions of the arm's cart: places judged as the path check judges them, and the best."""
