#!/bin/sh
# Makes a keystore of SROS 2 for the nodes of a configuration
# (docs/how-to/security.md).
# usage: fss_security.sh [--vehicle NAME] KEYSTORE [CONFIG]
# CONFIG is config/fss.sh by default.
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
help "$@"
case ${1:-} in --vehicle) vehicle "${2:-}"; shift 2 ;; esac
case ${1:-} in '' | -*) fail "usage: fss_security.sh [--vehicle NAME] KEYSTORE [CONFIG]" ;; esac
keystore=$(readlink -m -- "$1")
read_config "${2:-}"
list() { printf '%s\n' "$1=$2 $3"; }
set --
while IFS= read -r node; do set -- "$@" "$node"; done <<END
$(each_node list)
END
exec python3 "$fss_scripts/fss_security.py" "$keystore" "$fss_name" "$@"
