#!/bin/sh
# Runs one node of a configuration in this process. usage: node.sh CONFIG NAME
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
read_config "$1"
wanted=$2

become() {
  [ "$1" = "$wanted" ] || return 0
  shift
  hold "$wanted.node"
  echo $$ >"$FSS_LOGS/$wanted.node"
  if [ "${lockstep:-}" = true ]; then   # docs/explanation/simulator.md#time
    case $2 in
      testbed) set -- "$@" --ros-args -p keep_clock:=true -p lockstep:=true ;;
      *) set -- "$@" --ros-args -p use_sim_time:=true ;;
    esac
  fi
  # Not the real ros2: it would stay as the node's parent, with the lock and the process id.
  [ -z "$FSS_NAMESPACE" ] || set -- "$@" --ros-args -r "__ns:=/$FSS_NAMESPACE"
  [ "${ROS_SECURITY_ENABLE:-}" != true ] || set -- "$@" --ros-args --enclave "/$fss_name/$wanted"
  # A library's threads, which exist before the node runs, would keep their normal priority.
  [ -z "$fss_priority" ] || export FSS_PRIORITY="$fss_priority" FSS_CORES="$fss_cores" OPENBLAS_NUM_THREADS=1
  exec "$fss_scripts/bin/ros2" run "$@"
}
each_node become
fail "$fss_config: has no node $wanted, but $fss_nodes"
