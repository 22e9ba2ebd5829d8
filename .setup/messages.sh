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

generate() {  # generate PACKAGE
    name=$(basename "$1")
    sum=$(find "$1" -type f | sort | xargs cksum | cksum)
    if [ "$(cat "$venv/build/$name.sum" 2>/dev/null)" = "$sum" ]; then
        return
    fi
    echo "mv_slapse set-up: generating the messages of $1"
    if ! "$venv/bin/python" setup.py -q interfaces --source "$1" --prefix "$venv" \
            --build "$venv/build/$name" >"$venv/messages_$name.log" 2>&1; then
        tail -n 40 "$venv/messages_$name.log" >&2
        echo "mv_slapse set-up: the messages of $1 could not be built" >&2
        return 1
    fi
    echo "$sum" >"$venv/build/$name.sum"
}

# Side by side: much of the time one core looks for packages.
running=
for package in "$@"; do
    [ -e "$package/package.xml" ] || continue
    installed "$(basename "$package")" && continue
    generate "$package" &
    running="$running $!"
done
for job in $running; do
    wait "$job"
done
