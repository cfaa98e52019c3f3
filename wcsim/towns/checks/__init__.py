"""What is wrong with a town, and the command that cures it. Nothing is changed here."""
