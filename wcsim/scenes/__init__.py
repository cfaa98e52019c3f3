"""Short street scenes with a fixed seed: run, measured, filmed. The product never imports them."""
