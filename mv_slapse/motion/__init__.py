"""The camera's motion of a key frame pair, and what each block then says of itself."""
