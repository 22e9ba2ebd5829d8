"""Planes, camera and obstacles over time."""
