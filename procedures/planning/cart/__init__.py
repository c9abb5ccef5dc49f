"""Where the cart of the arm may stand: places judged as the path check judges them, and the best."""
