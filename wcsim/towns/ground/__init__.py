"""The ground as polygons, triangles and rasters: surfaces, heights, kerbs, tiles. Nothing that stands on it."""
