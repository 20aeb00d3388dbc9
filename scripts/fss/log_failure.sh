#!/bin/sh
# Logs the failure of a node that systemd runs. usage: log_failure.sh CONFIG NAME RESULT
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
read_config "$1"
[ "$3" = success ] || log_event "$2 failed ($3)"
