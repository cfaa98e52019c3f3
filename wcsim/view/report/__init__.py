"""The page of a finished test or training: one file with figures, their numbers and failures. It measures nothing."""
