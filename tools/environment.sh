#!/bin/sh
# Make a virtual environment that holds this package, editable, and what it needs.
#
#   tools/environment.sh FOLDER "3.12 3.11" EXTRAS [PIP OPTION...]
#
# Takes the first Python of the wanted versions that is there and works; PYTHON names another one.
# Where a ROS installation is sourced, that one is used and the extra `ros` is left out.
set -eu
folder=$1 versions=$2 extras=$3
shift 3

fail() {
    printf '%s\n' "$@" >&2
    exit 1
}

# True if the interpreter runs, has the wanted version and, where ROS is sourced, knows its rclpy.
# It has to be run to know: a version manager's shim is on the PATH without a Python behind it.
fits() {
    "$1" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$2')" 2>/dev/null \
        && { [ -z "${ROS_DISTRO:-}" ] || "$1" -c 'import rclpy' 2>/dev/null; }
}

find_python() {
    without_venv=
    for version in $versions; do
        for python in ${PYTHON:-"python$version" \
                "${PYENV_ROOT:-$HOME/.pyenv}/versions/$version".*/bin/python python3}; do
            fits "$python" "$version" || continue
            "$python" -c 'import ensurepip, venv' 2>/dev/null && return
            without_venv=${without_venv:-$version}
        done
    done
    [ -z "$without_venv" ] || fail \
        "Python $without_venv is here, but cannot make virtual environments. On Debian and Ubuntu:" \
        "    sudo apt-get install python$without_venv-venv"
    [ -z "${ROS_DISTRO:-}" ] || fail \
        "ROS $ROS_DISTRO is sourced, but no Python of version $versions imports its rclpy." \
        'Source another distribution, or open a terminal where none is: rclpy is installed then.'
    fail "No Python of version $versions was found${PYTHON:+: $PYTHON does not fit}." \
        'Install one, or name it: make PYTHON=/path/to/python3.12 ...'
}

if ! "$folder/bin/python" -m pip --version >/dev/null 2>&1; then
    find_python
    "$python" -m venv --clear ${ROS_DISTRO:+--system-site-packages} "$folder"
fi
[ -n "${ROS_DISTRO:-}" ] || extras=ros,$extras

echo "Installing into $folder: $("$folder/bin/python" --version), extras $extras; this happens once."
# What is imported gets compiled then; compiling all of it now would take longer than the download.
"$folder/bin/python" -m pip install --quiet --quiet --disable-pip-version-check --no-compile "$@" \
    --editable ".[$extras]"
