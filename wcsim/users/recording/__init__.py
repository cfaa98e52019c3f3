"""Drives on disk: the format of a recording, its writer and its reader. Not traces of a world, nor journals."""
