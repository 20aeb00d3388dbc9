#!/bin/sh
# Shows links, nodes, rates, faults and verdicts at a glance.
# usage: fss_status.sh [--vehicle NAME] [--watch | --wait SECONDS] [CONFIG]
# CONFIG is the one that runs by default.
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
help "$@"
how=
case ${1:-} in --vehicle) vehicle "${2:-}"; shift 2 ;; esac
case ${1:-} in
  --watch) how=--watch; shift ;;
  --wait) how="--wait ${2:-}"; shift 2 ;;
  -*) fail "usage: fss_status.sh [--vehicle NAME] [--watch | --wait SECONDS] [CONFIG]" ;;
esac
read_running_config "${1:-}"
[ "${1:-}" ] || is_running || fail "no configuration runs on this computer; scripts/fss_up.sh CONFIG starts one"
names=
# Nodes that are not ours need not report on /diagnostics.
name() { case $2 in fss_*) names="$names $1" ;; *) names="$names --mute $1" ;; esac; }
each_node name
[ "${ROS_SECURITY_ENABLE:-}" != true ] ||
  export ROS_SECURITY_ENCLAVE_OVERRIDE="${ROS_SECURITY_ENCLAVE_OVERRIDE:-/person}"
# shellcheck disable=SC2086  # both are words
exec python3 "$fss_scripts/fss_status.py" $how --namespace "$fss_vehicle" --logs "$FSS_LOGS" $names
