"""The wheel: what is in it, and that it runs away from the checkout."""
