"""What recordings of people become: users who replay a stick, and profiles fitted to one. No measuring of wcsim."""
