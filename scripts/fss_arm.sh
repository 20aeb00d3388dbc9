#!/bin/sh
# What a person tells the arm; by the ROS domain and the network of this shell, or of a configuration.
# usage: fss_arm.sh [--vehicle NAME] move | arm | disarm | stop | home | clear | valves | solve | forget [CONFIG] [ANGLE...] [OPTION...]
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
named=
case ${1:-} in --vehicle) named=${2:-}; shift 2 ;; esac
case ${2:-} in
  '' | -* | .[0-9]* | [0-9]*)   # an angle is no configuration
    cd -- "$fss_scripts/.."
    # shellcheck source=scripts/env.sh
    . scripts/env.sh
    ;;
  *)
    # shellcheck source=scripts/fss/config.sh
    . "$fss_scripts/fss/config.sh"
    what=$1 config=$2
    shift 2
    [ -z "$named" ] || vehicle "${named#/}"
    read_config "$config"
    set -- "$what" "$@"
    ;;
esac
[ -z "$named" ] || set -- "$@" --vehicle "$named"
[ "${ROS_SECURITY_ENABLE:-}" != true ] ||
  export ROS_SECURITY_ENCLAVE_OVERRIDE="${ROS_SECURITY_ENCLAVE_OVERRIDE:-/person}"
exec python3 "$fss_scripts/fss_arm.py" "$@"
