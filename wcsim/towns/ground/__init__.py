"""The ground as polygons, triangles and rasters, without what stands on it."""
