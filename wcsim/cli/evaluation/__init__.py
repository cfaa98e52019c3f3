"""Commands that judge policies: test, on towns or on a suite, and lists for a suite."""
