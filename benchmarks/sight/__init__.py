"""What a person sees in the pictures."""
