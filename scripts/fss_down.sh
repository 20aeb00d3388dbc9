#!/bin/sh
# Disarms the links, then stops all nodes of a configuration, the last one first.
# The exit code is 0 if all links are known to be disarmed, and every node has
# stopped when requested.
# usage: fss_down.sh [--vehicle NAME] [CONFIG]     by default the one that runs
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
help "$@"
case ${1:-} in --vehicle) vehicle "${2:-}"; shift 2 ;; esac
read_running_config "${1:-}"
refuse_systemd stop

# The reader of the output may have gone: nodes are stopped all the same.
trap '' PIPE
say() { echo "$*" 2>/dev/null || true; }

send() { ! held "$2" || kill -"$1" "$(cat "$FSS_LOGS/$2")" 2>/dev/null || true; }

# drivers NAME PACKAGE EXECUTABLE...: adds the namespace of a node that drives links to `driving`; a suspended one
# (SIGSTOP) is resumed, as it could not disarm its link otherwise.
driving=
drivers() {
  case "$2 $3" in 'fss_arm_driver link' | 'fss_arm_driver arm') ;; *) return 0 ;; esac
  held "$1.node" || return 0
  send CONT "$1.node"
  case " $driving " in *" /$FSS_NAMESPACE "*) ;; *) driving="$driving /$FSS_NAMESPACE" ;; esac
}

# members SESSION: prints the process ids of a session. The session of a node has its keeper's process id.
members() {
  for stat in /proc/[0-9]*/stat; do
    { read -r line <"$stat"; } 2>/dev/null || continue   # it has just ended
    # shellcheck disable=SC2086  # state, parent, group, session
    set -- "$1" ${line##*) }
    [ "$5" != "$1" ] || [ "$2" = Z ] || echo "${line%% *}"
  done
}

gone() {
  tries=$((FSS_STOP_TIMEOUT * 10))
  while held "$1.keep" || held "$1.node" || [ "$(members "$2")" ]; do
    [ "$tries" -gt 0 ] || return 1
    tries=$((tries - 1))
    sleep 0.1
  done
}

stopped=
stop() {
  held "$1.keep" || held "$1.node" || return 0
  stopped=yes
  session=$(cat "$FSS_LOGS/$1.keep") || session=0
  # Its keeper stops the node; a node without a keeper gets the signal itself.
  if held "$1.keep"; then send TERM "$1.keep"; else send TERM "$1.node"; fi
  if ! gone "$1" "$session"; then
    status=1
    # shellcheck disable=SC2046  # numbers
    kill -KILL $(members "$session") 2>/dev/null || true
    if ! gone "$1" "$session"; then
      echo "$1 cannot be stopped, still there: $(members "$session" | tr '\n' ' ')" >&2
      return 0
    fi
    log_event "$1 did not stop and was killed"
    say "$1 was killed"
    return 0
  fi
  say "$1 has stopped"
}

reversed=
for name in $fss_nodes; do reversed="$name $reversed"; done
# Nodes that were removed from the configuration meanwhile are stopped first.
for file in $(cd "$FSS_LOGS${fss_vehicle:+/$fss_vehicle}" && find . -name '*.node'); do
  name=${file#./} name=${fss_vehicle:+$fss_vehicle/}${name%.node}
  case " $fss_nodes " in *" $name "*) ;; *) reversed="$name $reversed" ;; esac
done

status=0
each_node drivers
for space in $driving; do
  if answer=$("$fss_scripts/fss_arm.sh" --vehicle "$space" disarm); then
    say "$answer"
  else
    echo "not all links are known to be disarmed: a joint that is on will be held, under power" >&2
    status=1
  fi
done
for name in $reversed; do stop "$name"; done
[ "$stopped" ] || say "no node of $fss_config runs on this computer"
exit $status
