"""Functions of arrays: cameras, rotations, epipolar geometry, planes, homographies."""
