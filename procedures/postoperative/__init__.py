"""The postoperative check: registers both CTs on bone, finds the inserted objects, measures their errors."""
