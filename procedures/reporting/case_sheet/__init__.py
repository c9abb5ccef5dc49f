"""Case sheet: what a clinical engineer takes into the theatre on two pages of paper."""
