"""Renderers of depth, class and colour over one geometry store."""
