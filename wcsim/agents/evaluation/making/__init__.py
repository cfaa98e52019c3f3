"""Lists of test episodes made for any town: ways and attempts drawn, hazards found by driving."""
