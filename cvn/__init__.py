"""Colorful Voxel Network: one picture in, a coloured 3D model out."""
