"""What simulated users do, beside the parameters that they should show."""
