"""From a textured mesh to its views, coloured voxels and target flows."""
