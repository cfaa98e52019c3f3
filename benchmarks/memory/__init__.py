"""What a world that runs for long keeps in memory."""
