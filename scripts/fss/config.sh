# Reads a configuration; sourced by the fss scripts, in $fss_scripts.
# shellcheck shell=sh disable=SC1090,SC1091,SC2034,SC2154

fail() { trap - EXIT; echo "${0##*/}: $*" >&2; exit 1; }

# help OPTION...: prints the script's leading comment and exits, if --help or -h is given.
help() {
  case " $* " in *' --help '* | *' -h '*) ;; *) return 0 ;; esac
  sed -n '2,/^[^#]/s/^# \{0,1\}//p' "$0"
  exit 0
}

# set_up OPTION...: sets the workspace up. --help needs no set-up: it is the script's own, or, if
# nothing is built yet, its leading comment.
set_up() {
  case " $* " in
    *' --help '* | *' -h '*) [ -f "$fss_scripts/../install/setup.sh" ] || help "$@" ;;
    *) FSS_SETUP_NEXT='' "$fss_scripts/setup.sh" ;;
  esac
}

# vehicle NAME: sets the namespace given by --vehicle.
vehicle() {
  [ "$1" ] || fail "--vehicle: the name (namespace) of a vehicle is missing"
  export FSS_NAMESPACE="$1"
}

# check_domain: fails unless $ROS_DOMAIN_ID is a ROS domain.
check_domain() {
  case ${ROS_DOMAIN_ID:-0} in
    *[!0-9]* | ????* | 23[3-9] | 2[4-9]? | [3-9]??)
      fail "ROS_DOMAIN_ID is '$ROS_DOMAIN_ID', expected a whole number from 0 to 232" ;;
  esac
}

# read_config CONFIG: reads its settings, sets the environment, and lists in $fss_nodes the names of
# its nodes in order, each with its namespace; only those in $FSS_NAMESPACE if that is set. A
# configuration whose nodes are all in one namespace sets $FSS_NAMESPACE.
read_config() {
  fss_root=$(CDPATH='' cd -- "$fss_scripts/.." && pwd -P)
  fss_config=$(readlink -f -- "${1:-$fss_root/config/fss.sh}") || fss_config=   # the folder does not exist either
  if [ ! -f "$fss_config" ]; then
    case ${1:-/} in /*) ;; *) fss_said=" in $PWD" ;; esac
    fail "${1:-config/fss.sh}: no such configuration${fss_said:-}; there are $(cd "$fss_root" && echo config/*.sh) in $fss_root"
  fi
  cd "$fss_root" || exit 1
  fss_name=${fss_config##*/} fss_name=${fss_name%.sh}
  FSS_LOGS=log/$fss_name   # of all nodes
  FSS_RESTARTS=3           # of a failing node within the window
  FSS_WINDOW=600           # [s]
  FSS_STOP_TIMEOUT=10          # for a node to stop [s]
  FSS_NAMESPACE=${FSS_NAMESPACE:-} FSS_NAMESPACE=${FSS_NAMESPACE#/}
  fss_vehicle=$FSS_NAMESPACE fss_nodes='' fss_spaces='' fss_priority='' fss_cores=''
  check_domain
  trap 'fail "$fss_config: stopped before its end, by an exit or an error in it"' EXIT
  . "$fss_config"
  trap - EXIT
  FSS_NAMESPACE=$fss_vehicle
  check_domain
  [ "$fss_nodes" ] || fail "$fss_config: has no node${FSS_NAMESPACE:+ in the namespace $FSS_NAMESPACE}"
  case $fss_spaces in *' /'*) ;; *) FSS_NAMESPACE=${fss_spaces#/} ;; esac
  export FSS_NAMESPACE
  for fss_space in $fss_spaces; do
    fss_said=$(mkdir -p "$FSS_LOGS$fss_space" 2>&1) ||
      fail "$fss_said$([ -w . ] || echo '; make a clone of your own')"
  done
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

# elsewhere: true if the node of this line is not in the selected namespace.
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
  case " $fss_nodes " in *" $1 "*) fail "$fss_config: node $1 is defined twice" ;; esac
  fss_nodes="${fss_nodes:+$fss_nodes }$1"
  case " $fss_spaces " in *" /$FSS_NAMESPACE "*) ;; *) fss_spaces="${fss_spaces:+$fss_spaces }/$FSS_NAMESPACE" ;; esac
}

# In a configuration: realtime PRIORITY CORES node NAME ...: this node has a real-time priority from 2
# to 98 (SCHED_FIFO), locked memory, and runs on CORES: numbers, such as 1 or 2,3; any: all.
realtime() {
  case ${1:-} in
    [2-9] | [1-8][0-9] | 9[0-8]) ;;
    *) fail "$fss_config: realtime: the priority is '${1:-}', expected a whole number from 2 to 98" ;;
  esac
  case ${2:-} in
    any) ;;
    '' | *[!0-9,]* | ,* | *, | *,,*) fail "$fss_config: realtime: the cores are '${2:-}', expected numbers such as 2,3, or any" ;;
  esac
  [ "${3:-}" = node ] || fail "$fss_config: realtime: '${3:-}' follows the cores, expected node"
  fss_priority=$1 fss_cores=${2#any}
  shift 2
  "$@"
  fss_priority='' fss_cores=''
}

# Each node and its keeper hold the lock of a file with their process id in it. The lock is released
# when the process exits, and its id cannot be reused before that. A keeper leaves its final state in
# its file: ended, failed or stopped.
held() { [ -e "$FSS_LOGS/$1" ] && ! flock -s -n "$FSS_LOGS/$1" true; }

# hold FILE: acquires its lock on descriptor 9, for this process, its children and what it execs.
hold() {
  exec 9>>"$FSS_LOGS/$1"
  flock -w 5 9 || fail "$1 is locked by another process"
}

# log_event WORDS: writes to the log of events, and to the terminal from which the nodes were started.
# Sets $fss_unwritten if the log cannot be written.
log_event() {
  fss_line="$(date '+%F %T') $*"
  { echo "$fss_line" >>"$FSS_EVENTS"; } 2>/dev/null || fss_unwritten=yes
  # In a separate process, so that a terminal that hangs or is closed does no harm.
  [ -z "${FSS_TTY:-}" ] || { printf '\r%s\r\n' "$fss_line" >"$FSS_TTY"; } 2>/dev/null 9>&- &
}

# keepers [KEEPER]: prints for each node that a keeper keeps on this computer, for any workspace or by
# the script KEEPER, the keeper's process id, the node's name and the configuration.
keepers() {
  grep -lsa '/fss/keep\.sh' /proc/[0-9]*/cmdline | while read -r fss_line; do
    fss_pid=${fss_line#/proc/} fss_pid=${fss_pid%/cmdline}
    tr '\0' '\n' 2>/dev/null <"$fss_line" |
      sed -n "\\#^${1:-.*/fss/keep\.sh}\$#{n;N;s/\(.*\)\n\(.*\)/$fss_pid \2 \1/p;}"
  done
}

# running_configs: prints this workspace's configurations with running nodes, one per line.
running_configs() { keepers "$fss_scripts/fss/keep.sh" | cut -d ' ' -f 3- | sort -u; }

# read_running_config CONFIG: as read_config; without CONFIG, the only one that runs.
read_running_config() {
  fss_running=
  [ "${1:-}" ] || fss_running=$(running_configs)
  case $fss_running in
    *"
"*) fail "several configurations run, name one of: $(echo "$fss_running" | tr '\n' ' ')" ;;
  esac
  read_config "${1:-$fss_running}"
}

# is_running: true if a node of the configuration runs.
is_running() {
  for fss_each in $fss_nodes; do
    ! held "$fss_each.keep" && ! held "$fss_each.node" || return 0
  done
  return 1
}

# refuse_systemd VERB: exits if systemd runs the nodes, as it must then start and stop them.
refuse_systemd() {
  ! systemctl --quiet is-active "$fss_name.target" 2>/dev/null ||
    fail "systemd runs these nodes: systemctl $1 $fss_name.target"
}
