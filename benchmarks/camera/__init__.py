"""The rasteriser beside TinyRenderer and Embree."""
