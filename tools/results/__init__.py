"""Makes the tables about learning in `docs/results.md` again, in parts that can be stopped and gone on with."""
