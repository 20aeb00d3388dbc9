# Reads a configuration; sourced by the fss scripts, which stand in $fss_scripts.
# shellcheck shell=sh disable=SC1090,SC1091,SC2034,SC2154

fail() { echo "${0##*/}: $*" >&2; exit 1; }

# help OPTION...: prints what the script says of itself, and ends, if that is asked for.
help() {
  case " $* " in *' --help '* | *' -h '*) ;; *) return 0 ;; esac
  sed -n '2,/^[^#]/s/^# \{0,1\}//p' "$0"
  exit 0
}

# vehicle NAME: what --vehicle says: the namespace of all that follows.
vehicle() {
  [ "$1" ] || fail "--vehicle wants the name of a vehicle, its namespace"
  export FSS_NAMESPACE="$1"
}

# read_config CONFIG: its settings, the environment, and $fss_nodes, its nodes' names in order, each
# with its namespace before it: those in $FSS_NAMESPACE if that is set. A configuration whose nodes
# are all in one namespace sets it.
read_config() {
  fss_root=$(CDPATH='' cd -- "$fss_scripts/.." && pwd -P)
  fss_config=$(readlink -f -- "${1:-$fss_root/config/fss.sh}") || fss_config=   # nor its folder
  [ -f "$fss_config" ] || fail "${1:-config/fss.sh}: no such configuration"
  cd "$fss_root" || exit 1
  fss_name=${fss_config##*/} fss_name=${fss_name%.sh}
  FSS_LOGS=log/$fss_name   # of all nodes
  FSS_RESTARTS=3           # of a node that fails, until it has run for as long as the window
  FSS_WINDOW=600           # [s]
  FSS_STOP_TIMEOUT=10          # with a node that is to stop [s]
  FSS_NAMESPACE=${FSS_NAMESPACE:-} FSS_NAMESPACE=${FSS_NAMESPACE#/}
  fss_vehicle=$FSS_NAMESPACE fss_nodes='' fss_spaces=''
  . "$fss_config"
  FSS_NAMESPACE=$fss_vehicle
  [ "$fss_nodes" ] || fail "$fss_config: has no node${FSS_NAMESPACE:+ in the namespace $FSS_NAMESPACE}"
  case $fss_spaces in *' /'*) ;; *) FSS_NAMESPACE=${fss_spaces#/} ;; esac
  export FSS_NAMESPACE
  for fss_space in $fss_spaces; do mkdir -p "$FSS_LOGS$fss_space" || exit 1; done
  FSS_LOGS=$(readlink -f -- "$FSS_LOGS")
  export ROS_LOG_DIR="$FSS_LOGS/ros" FSS_EVENTS="$FSS_LOGS/events.log"
  . scripts/env.sh || exit 1
}

# each_node COMMAND...: runs it with the name, package, executable and arguments of each node, in
# the node's $FSS_NAMESPACE.
each_node() {
  fss_each=$* FSS_NAMESPACE=$fss_vehicle
  node() {
    ! elsewhere || return 0
    fss_node=${FSS_NAMESPACE:+$FSS_NAMESPACE/}$1
    shift
    $fss_each "$fss_node" "$@"
  }
  . "$fss_config"
  FSS_NAMESPACE=$fss_vehicle
}

# elsewhere: whether the node of this line is in another namespace than all is to be for.
elsewhere() { [ "$fss_vehicle" ] && [ "$FSS_NAMESPACE" != "$fss_vehicle" ]; }

# In a configuration: node NAME PACKAGE EXECUTABLE [ARGUMENT...], in the namespace FSS_NAMESPACE.
node() {
  case /$FSS_NAMESPACE/ in
    // | /[A-Za-z]*/) ;;
    *) fail "$fss_config: FSS_NAMESPACE is '$FSS_NAMESPACE', expected the name of a vehicle" ;;
  esac
  case $FSS_NAMESPACE in
    *[!A-Za-z0-9_/]* | */ | *//*)
      fail "$fss_config: FSS_NAMESPACE is '$FSS_NAMESPACE', expected letters, digits and _" ;;
  esac
  case ${1:-} in
    '' | *[!A-Za-z0-9_]*) fail "$fss_config: node '${1:-}': expected letters, digits and _" ;;
  esac
  [ $# -ge 3 ] || fail "$fss_config: node $1: expected NAME PACKAGE EXECUTABLE [ARGUMENT...]"
  ! elsewhere || return 0
  set -- "${FSS_NAMESPACE:+$FSS_NAMESPACE/}$1"
  case " $fss_nodes " in *" $1 "*) fail "$fss_config: node $1 is there twice" ;; esac
  fss_nodes="${fss_nodes:+$fss_nodes }$1"
  case " $fss_spaces " in *" /$FSS_NAMESPACE "*) ;; *) fss_spaces="${fss_spaces:+$fss_spaces }/$FSS_NAMESPACE" ;; esac
}

# Each node and its keeper hold the lock of a file with their process's number in it. A lock ends
# with its process, and nobody else can have the number before that. A keeper's last word stays in
# its file: ended, failed or stopped.
held() { [ -e "$FSS_LOGS/$1" ] && ! flock -s -n "$FSS_LOGS/$1" true; }

# hold FILE: takes its lock on descriptor 9, for this process and what it starts or becomes.
hold() {
  exec 9>>"$FSS_LOGS/$1"
  flock -w 5 9 || fail "$1 is held: another process is at it"
}

# tell WORDS: to the log of events, and to the terminal of who started the nodes.
tell() {
  fss_line="$(date '+%F %T') $*"
  echo "$fss_line" >>"$FSS_EVENTS"
  # In a process of its own: neither a terminal that hangs nor one that is gone is to matter.
  [ -z "${FSS_TTY:-}" ] || { printf '\r%s\r\n' "$fss_line" >"$FSS_TTY"; } 2>/dev/null 9>&- &
}

# refuse_systemd VERB: the nodes are systemd's to start and stop if it runs them.
refuse_systemd() {
  ! systemctl --quiet is-active "$fss_name.target" 2>/dev/null ||
    fail "systemd runs these nodes: systemctl $1 $fss_name.target"
}
