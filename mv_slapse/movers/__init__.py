"""What moves by itself in a key frame pair."""
