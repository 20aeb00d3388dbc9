#!/bin/sh
# Copies this workspace to another computer as a new release, checks it there,
# and makes it the current one. It starts and arms nothing.
# usage: fss_deploy.sh USER@HOST CONFIG      copy, check, switch
#        fss_deploy.sh USER@HOST --list      list releases (*: the current one)
#        fss_deploy.sh USER@HOST --rollback  switch to the release before
# Releases are in ~/fss_arm/releases, the current one is ~/fss_arm/current.
# RSYNC_RSH replaces `ssh`.
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
help "$@"
[ $# = 2 ] || fail "usage: fss_deploy.sh USER@HOST CONFIG | --list | --rollback"
host=$1
export RSYNC_RSH="${RSYNC_RSH:-ssh}"

# there COMMAND...: runs scripts/fss/release.sh there.
# shellcheck disable=SC2086  # RSYNC_RSH is a command with options
there() { $RSYNC_RSH "$host" sh -s -- "$@" <"$fss_scripts/fss/release.sh"; }

case $2 in
  --list) there list; exit ;;
  --rollback) there rollback; exit ;;
  -*) fail "unknown option '$2'; usage: fss_deploy.sh USER@HOST CONFIG | --list | --rollback" ;;
esac
command -v rsync >/dev/null || fail "rsync is missing; install it with: sudo apt install rsync"
fss_root=${fss_scripts%/*}
config=$(readlink -f -- "$2") || config=
[ -f "$config" ] || fail "$2: no such configuration"
case $config in
  "$fss_root"/*) config=${config#"$fss_root"/} ;;
  *) fail "$2 is outside of $fss_root: put it, the arm's description and the law into the workspace" ;;
esac
case $config in *[!A-Za-z0-9_./-]*) fail "$2: expected a name of letters, digits and _./-" ;; esac

# copy OPTION...: synchronizes the release with this workspace.
copy() {
  rsync --archive --checksum --delete --exclude=/.git --exclude=/RELEASE --filter=':- .gitignore' "$@" \
    "$fss_root/" "$host:fss_arm/releases/$number/"
}
commit=$(python3 "$fss_root/src/fss_arm_ros/fss_arm_ros/source_version.py" 2>/dev/null) || commit=unknown
begun=$(there begin)
number=${begun%% *} last=${begun#* }
copy ${last:+"--link-dest=../$last"}
[ -z "$(copy --dry-run --itemize-changes)" ] ||
  fail "files changed while release $number was copied; call this again"
there finish "$number" "$config" "$commit"
