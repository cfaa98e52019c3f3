"""Rounds: worlds in processes of their own drive and record while the network learns."""
