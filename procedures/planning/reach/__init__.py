"""What the arm must reach in a procedure, and whether it can: poses, joint angles, motions between them."""
