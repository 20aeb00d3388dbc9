#!/bin/sh
# Keeps one node of a configuration running: restarts it when it fails, a bounded number of times,
# and logs each failure. fss_up.sh starts it with the lock on descriptor 9, in a separate session
# that survives a lost connection. usage: keep.sh CONFIG NAME
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
read_config "$1"
name=$2
echo $$ >"$FSS_LOGS/$name.keep"

ending='' node=''
trap 'ending=1; [ -z "$node" ] || kill "$node" 2>/dev/null || true' TERM INT HUP
failures=0
while [ -z "$ending" ]; do
  began=$(date +%s)
  "$fss_scripts/fss/node.sh" "$fss_config" "$name" 9>&- &
  node=$!
  [ -z "$ending" ] || kill "$node" 2>/dev/null || true   # the signal came before the node was started
  code=0
  wait "$node" || code=$?
  while kill -0 "$node" 2>/dev/null; do   # a signal interrupts `wait` before the node has exited
    code=0
    wait "$node" || code=$?
  done
  node=''
  [ -z "$ending" ] || break
  if [ "$code" = 0 ]; then
    log_event "$name has ended"
    echo ended >"$FSS_LOGS/$name.keep"
    exit 0
  fi
  [ $(($(date +%s) - began)) -lt "$FSS_WINDOW" ] || failures=0
  failures=$((failures + 1))
  why=''
  if [ "$code" = 1 ]; then   # the last line of its log is the reason
    why=$(grep -v '^ *$' "$FSS_LOGS/$name.log" 2>/dev/null | tail -n 1 | tr -d '\000-\037\177' |
      sed "s/^\[[A-Z]*\] \[[0-9.]*\] //; s/^\[\{0,1\}$name]\{0,1\}: //" | cut -c 1-200) || why=''
  fi
  why=${why:-exit code $code}
  if [ "$failures" -gt "$FSS_RESTARTS" ]; then
    log_event "$name failed ($why) $failures times and is not started again; see $FSS_LOGS/$name.log"
    echo failed >"$FSS_LOGS/$name.keep"
    exit 1
  fi
  log_event "$name failed ($why), starting it again ($failures of $FSS_RESTARTS)"
  sleep 1
done
echo stopped >"$FSS_LOGS/$name.keep"
