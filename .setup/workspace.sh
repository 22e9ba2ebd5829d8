#!/bin/sh
# workspace.sh: build and test this clone in a temporary workspace, as a user's colcon does.
set -e  # colcon's own scripts read unset variables
root=$(pwd)
workspace=$(mktemp -d)
trap 'rm -rf "$workspace"' EXIT

mkdir -p "$workspace/src/mv_slapse"
git ls-files -z --cached --others --exclude-standard |
    xargs -0 cp --parents -t "$workspace/src/mv_slapse"
. "$root/.venv/setup.sh"
cd "$workspace"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST

import_kernels() {  # those of the workspace, not those of the virtual environment
    python -c 'import mv_slapse_kernels, sys
sys.exit(not mv_slapse_kernels.__file__.startswith(sys.argv[1] + "/install/"))' "$workspace"
}

echo '== colcon build --symlink-install'
colcon build --symlink-install
(. install/local_setup.sh
import_kernels
cd src/mv_slapse
python -m pytest -q test/system/test_installed_nodes.py)
rm -rf build install log

echo '== colcon build'
colcon build

echo '== colcon test'
. install/local_setup.sh
import_kernels
colcon test --event-handlers console_direct+ || true
colcon test-result --verbose
