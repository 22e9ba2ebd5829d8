"""The extraction of a key frame pair, step by step, and its state."""
