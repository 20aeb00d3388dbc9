#!/bin/sh
# Commands to the arm from a terminal, in the ROS domain of this shell or of a
# configuration.
# usage: fss_arm.sh [--vehicle NAME] COMMAND [CONFIG] [ANGLE... | PLAN] [OPTION...]
# --help lists the commands.
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)

# is_name NAME: true for a vehicle's namespace; fss_arm.py refuses any other, without a configuration.
is_name() (
  LC_ALL=C
  [ "$1" = / ] || case /${1#/}/ in
    *[!A-Za-z0-9_/]* | *//* | */[!A-Za-z]*) false ;;
    *) [ ${#1} -lt 200 ] ;;
  esac
)

named='' given=''
case ${1:-} in
  --vehicle | --namespace)
    if [ $# -gt 1 ]; then given=yes named=$2; shift 2; fi ;;   # else fss_arm.py refuses it
  --vehicle=* | --namespace=*) given=yes named=${1#*=}; shift ;;
esac
case ${2:-} in
  '' | -* | .[0-9]* | [0-9]*) config='' ;;   # an angle is no configuration
  *) config=$2 ;;
esac
case ${1:-} in
  -*) config='' ;;
  execute) case ${2:-} in *.sh) ;; *) config='' ;; esac ;;   # else it is the plan
esac
[ -z "$given" ] || is_name "$named" || config=''
export FSS_CALLED_IN="$PWD" FSS_ARM_CONFIG="$config"   # where a plan's path starts; repeated in hints
if [ "$config" ]; then
  # shellcheck source=scripts/fss/config.sh
  . "$fss_scripts/fss/config.sh"
  what=$1
  shift 2
  [ -z "${named#/}" ] || vehicle "${named#/}"
  read_config "$config"
  set -- "$what" "$@"
else
  cd -- "$fss_scripts/.."
  # shellcheck source=scripts/env.sh
  . scripts/env.sh
fi
[ -z "$given" ] || set -- "--vehicle=$named" "$@"   # of two, the last one counts
[ "${ROS_SECURITY_ENABLE:-}" != true ] ||
  export ROS_SECURITY_ENCLAVE_OVERRIDE="${ROS_SECURITY_ENCLAVE_OVERRIDE:-/person}"
exec python3 "$fss_scripts/fss_arm.py" "$@"
