"""The user model fitted to recorded drives: the hand by likelihood, habits by counting. No measuring of wcsim."""
