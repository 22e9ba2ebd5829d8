"""Pictures, and video of codecs without vectors, to packets whose vectors can be read."""
