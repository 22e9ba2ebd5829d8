#!/bin/sh
# messages.sh VENV FOLDER...: generate the messages of interface packages into the virtual
# environment; only those that have changed.
set -eu
venv=$(cd "$1" && pwd)
shift
[ "$(cat "$venv/.ros")" != none ] || exit 0

installed() {  # installed PACKAGE: in a ROS prefix other than the virtual environment
    (IFS=:
    for prefix in ${AMENT_PREFIX_PATH:-}; do
        [ "$prefix" = "$venv" ] || [ ! -e "$prefix/share/$1/package.xml" ] || exit 0
    done
    exit 1)
}

for package in "$@"; do
    [ -e "$package/package.xml" ] || continue
    name=$(basename "$package")
    if installed "$name"; then
        continue
    fi
    sum=$(find "$package" -type f | sort | xargs cksum | cksum)
    if [ "$(cat "$venv/build/$name.sum" 2>/dev/null)" = "$sum" ]; then
        continue
    fi
    echo "mv_slapse set-up: generating the messages of $package"
    if ! "$venv/bin/python" setup.py -q interfaces --source "$package" --prefix "$venv" \
            --build "$venv/build/$name" >"$venv/messages.log" 2>&1; then
        tail -n 40 "$venv/messages.log" >&2
        echo "mv_slapse set-up: the messages of $package could not be built" >&2
        exit 1
    fi
    echo "$sum" >"$venv/build/$name.sum"
done
