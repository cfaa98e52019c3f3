"""Recordings of single drives, and studies that lead a person through several; no sockets."""
