"""Files: trajectories, tables, bags; the only folder that imports mcap and rosbags."""
