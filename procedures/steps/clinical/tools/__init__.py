"""The tool on the arm, and the instrument in it."""
