#!/bin/sh
# Checks that the executables of a configuration start, without starting a node, and prints versions.
# usage: check.sh CONFIG
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
read_config "$1"
known=$(ros2 pkg executables)

# check NAME PACKAGE EXECUTABLE...: other packages' executables may not have --help, and start.
check() {
  printf '%s\n' "$known" | grep -qxF "$2 $3" ||
    fail "$fss_config: node $1: there is no executable '$3' in a package '$2'"
  case $2 in
    fss_*)
      said=$(ros2 run "$2" "$3" --help 2>&1) || fail "node $1: $2 $3 --help failed: $(echo "$said" | tail -n 1)" ;;
  esac
}
each_node check
echo "$(python3 --version), ROS 2 $ROS_DISTRO; all executables of $1 start"
