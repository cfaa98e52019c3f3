"""What only measures or proves wcsim: the yardsticks behind `wcsim bench`. The product imports nothing from here."""
