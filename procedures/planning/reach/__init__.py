"""What the arm has to reach in a procedure, and whether it can: poses, joint angles, motions between them."""
