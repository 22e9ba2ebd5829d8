#!/bin/sh
# package.sh VENV: install mv_slapse itself, editable, and make its nodes known to ROS.
set -eu
venv=$(cd "$1" && pwd)
export MV_SLAPSE_KERNELS=installed  # by kernels.sh
options='--no-deps --no-build-isolation -e'
"$venv/bin/python" -m uv pip install -q --python "$venv/bin/python" $options . 2>>"$venv/setup.log" ||
    "$venv/bin/python" -m pip install -q $options .
"$venv/bin/python" setup.py -q overlay
