"""Pose, plane map and moving obstacles from the motion vectors of an encoded video."""

import os

# Matrices here are small: threads of the linear algebra library cost more than they bring (ten
# times the CPU was measured) and their sums differ from run to run.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
