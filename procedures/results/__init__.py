"""What steps leave behind, and the errors for what is missing or outside its limits."""
