"""Commands that make pictures and videos."""
