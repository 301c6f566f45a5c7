#!/usr/bin/env bash
# Make keys for DDS security, an enclave for each kind of node and each vehicle.
#
#     examples/make_keystore.sh FOLDER [VEHICLE ...]
#
# Needs a sourced ROS installation that has sros2; see docs/security.md. Each enclave may use all
# topics: `ros2 security create_permission` narrows that down by a policy file.
set -euo pipefail

if [ $# -lt 1 ]; then
    echo "usage: $0 FOLDER [VEHICLE ...], such as $0 keystore veh_0 veh_1" >&2
    exit 2
fi
if ! command -v ros2 >/dev/null; then
    echo "$0: ros2 is not found: source a ROS installation first, as . /opt/ros/jazzy/setup.bash" >&2
    exit 1
fi
if ! ros2 security --help >/dev/null 2>&1; then
    echo "$0: 'ros2 security' is not installed: it is in ros-$ROS_DISTRO-sros2" >&2
    exit 1
fi

keystore=$1
shift
if [ -e "$keystore" ]; then
    echo "$0: $keystore exists, must be the name of a new folder" >&2
    exit 1
fi
umask 077  # who reads a private key can speak as its node
ros2 security create_keystore "$keystore"
for enclave in anchor fleet recorder tools "${@/%//localizer}"; do
    ros2 security create_enclave "$keystore" "/tsmcl/$enclave"
done

echo "
For every process, in its terminal or service file:
    export ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce
    export ROS_SECURITY_KEYSTORE=$(realpath "$keystore")
    ros2 run tsmcl_ros anchor --ros-args --enclave /tsmcl/anchor -p require_security:=true
Copy to each machine its own enclaves and public/ alone, and private/ to none."
