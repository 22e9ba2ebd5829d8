"""Filter of the camera and of the stationary planes."""
