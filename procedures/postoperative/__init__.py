"""The postoperative check: registers both CTs on bone, finds what was inserted, measures its errors."""
