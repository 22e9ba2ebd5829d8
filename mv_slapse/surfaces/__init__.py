"""Stationary surfaces of a key frame pair: the ground, known planes, new planes."""
