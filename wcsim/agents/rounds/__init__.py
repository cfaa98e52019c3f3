"""Rounds: worlds in processes of their own drive while the network learns from what they drove before."""
