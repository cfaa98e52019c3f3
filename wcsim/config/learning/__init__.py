"""Sections of how a network learns: by rewards, from recorded driving, and the driving that is recorded."""
