"""A user's MJCF file, patched in place: names, geoms, meshes, comments and actuators stay."""
