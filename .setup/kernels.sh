#!/bin/sh
# kernels.sh VENV: compile the kernels into the virtual environment; CMake compiles what has changed.
set -eu
venv=$(cd "$1" && pwd)
if ! "$venv/bin/python" setup.py -q kernels --build "$venv/build" >"$venv/kernels.log" 2>&1; then
    tail -n 40 "$venv/kernels.log" >&2
    echo "mv_slapse set-up: the kernels could not be compiled (log: $venv/kernels.log)" >&2
    exit 1
fi
