#!/bin/sh
# Tells how a node under systemd ended, if not well. usage: tell.sh CONFIG NAME RESULT
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
read_config "$1"
[ "$3" = success ] || tell "$2 failed ($3)"
