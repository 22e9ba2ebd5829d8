"""From correspondences to labelled planes and camera motion."""
