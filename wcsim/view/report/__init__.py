"""The page of a finished test or training: one file with figures, numbers and failures."""
