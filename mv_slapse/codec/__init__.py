"""From packets to correspondences; the only folder that imports av."""
