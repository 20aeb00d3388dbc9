#!/bin/sh
# Disarms the links, then stops all nodes of a configuration, the last one first.
# usage: fss_down.sh [CONFIG]     config/fss.sh by default
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
read_config "${1:-}"
refuse_systemd stop

send() { ! held "$2" || kill -"$1" "$(cat "$FSS_LOGS/$2")" 2>/dev/null || true; }

gone() {
  tries=$((FSS_PATIENCE * 10))
  while held "$1.keep" || held "$1.node"; do
    [ "$tries" -gt 0 ] || return 1
    tries=$((tries - 1))
    sleep 0.1
  done
}

stop() {
  held "$1.keep" || held "$1.node" || return 0
  # Its keeper stops the node; one that has lost its keeper is told itself.
  if held "$1.keep"; then send TERM "$1.keep"; else send TERM "$1.node"; fi
  if ! gone "$1"; then
    send KILL "$1.keep"
    send KILL "$1.node"
    gone "$1" || fail "$1 cannot be stopped"
    tell "$1 did not stop and was killed"
    status=1
  fi
  echo "$1 has stopped"
}

reversed=
for name in $fss_nodes; do reversed="$name $reversed"; done
# What has been taken out of the configuration meanwhile goes first.
for file in "$FSS_LOGS"/*.node; do
  name=${file##*/} name=${name%.node}
  case " $fss_nodes " in *" $name "*) ;; *) reversed="$name $reversed" ;; esac
done

status=0
if held arm.node; then
  "$fss_scripts/fss_arm.sh" disarm || echo "joints that are on will be held, under power" >&2
fi
for name in $reversed; do stop "$name"; done
exit $status
