"""Pose, plane map and moving obstacles from the motion vectors of an encoded video."""

