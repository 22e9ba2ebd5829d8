#!/bin/sh
# workspace.sh [COLCON_BUILD_ARGUMENTS]: build and test this clone as a user's workspace does.
set -eu
root=$(pwd)
workspace=$(mktemp -d)
trap 'rm -rf "$workspace"' EXIT
mkdir -p "$workspace/src/mv_slapse"
git ls-files -z --cached --others --exclude-standard | xargs -0 cp --parents -t "$workspace/src/mv_slapse"
. "$root/.venv/setup.sh"
cd "$workspace"
colcon build "$@"
colcon test --event-handlers console_direct+ || true
colcon test-result --verbose
