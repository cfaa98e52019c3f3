"""What only measures or proves wcsim: `python -m benchmarks NAME`. The product imports nothing from here."""
