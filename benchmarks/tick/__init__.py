"""What a tick costs, beside bare engines and beside the loop that one would write first."""
