#!/bin/sh
# Starts the nodes of a configuration that do not run yet, and shows their status.
# They outlive this shell and its connection; a node that fails is restarted a
# few times.
# usage: fss_up.sh [--vehicle NAME] [CONFIG]     config/fss.sh by default
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
help "$@"
case ${1:-} in --vehicle) vehicle "${2:-}"; shift 2 ;; esac
read_config "${1:-}"
refuse_systemd start

FSS_TTY=$(tty) || FSS_TTY=
export FSS_TTY
known=$(ros2 pkg executables)

check() {
  printf '%s\n' "$known" | grep -qxF "$2 $3" ||
    fail "$fss_config: node $1: there is no executable '$3' in a package '$2'"
}
start() {
  ! held "$1.keep" || return 0
  ! held "$1.node" || fail "$1 runs without its supervisor: fss_down.sh first"
  [ ! -e "$FSS_LOGS/$1.log" ] || [ -w "$FSS_LOGS/$1.log" ] || fail "cannot write to $FSS_LOGS/$1.log"
  (
    hold "$1.keep" && exec setsid -f "$fss_scripts/fss/keep.sh" "$fss_config" "$1"
  ) </dev/null >>"$FSS_LOGS/$1.log" 2>&1 ||
    fail "$1 cannot be started: $(tail -n 1 "$FSS_LOGS/$1.log"); scripts/fss_down.sh $fss_config, then try again"
}
each_node check
# Two laboratories in one domain would drive each other's links.
while read -r pid name other; do
  [ "${other:-$fss_config}" != "$fss_config" ] || continue
  case " $fss_nodes " in *" $name "*) ;; *) continue ;; esac
  domain=$(tr '\0' '\n' 2>/dev/null <"/proc/$pid/environ" | sed -n 's/^ROS_DOMAIN_ID=//p') || continue
  [ "${domain:-0}" != "${ROS_DOMAIN_ID:-0}" ] ||
    fail "$name of $other runs in ROS domain ${domain:-0} already; stop it with" \
      "scripts/fss_down.sh $other, or choose another ROS_DOMAIN_ID"
done <<END
$(keepers)
END
echo "ROS domain ${ROS_DOMAIN_ID:-0}, logs in $FSS_LOGS"
started=
for name in $fss_nodes; do
  if held "$name.keep"; then started=; break; fi
  started="$started $name"
done
[ -z "$started" ] || FSS_TTY='' log_event "nodes are started:$started"   # older events belong to another session
[ -z "${fss_unwritten:-}" ] || fail "cannot write to $FSS_LOGS: is the disk full? df -h $FSS_LOGS shows it"
each_node start
exec "$fss_scripts/fss_status.sh" --wait 60 "$fss_config"
