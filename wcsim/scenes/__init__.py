"""Short street scenes with a fixed seed: built, run, measured, filmed. The product never imports them."""
