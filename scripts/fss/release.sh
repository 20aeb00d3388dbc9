#!/bin/sh
# Releases on the computer that they are copied to, where fss_deploy.sh runs this with `sh -s`.
# usage: release.sh begin | finish NUMBER CONFIG COMMIT | list | rollback
#
# A release counts once its file RELEASE exists, which is the last step of its check. Both that file
# and the link `current` appear by a rename, so that whatever is interrupted leaves the old release or
# the new one. Numbers are not used twice.
set -eu

fail() { echo "fss_deploy.sh: $*" >&2; exit 1; }

releases() { find releases -maxdepth 2 -name RELEASE | tr -dc '0-9\n' | sort -n; }

current() { readlink current | tr -dc 0-9; }

refuse_running() {
  ! grep -qsa "$folder/releases/[0-9]" /proc/[0-9]*/cmdline ||
    fail "nodes of a release run: stop them there with fss_arm/current/scripts/fss_down.sh, which disarms the links"
}

begin() {
  for release in releases/*; do
    [ ! -d "$release" ] || [ -e "$release/RELEASE" ] || rm -rf "$release"
  done
  number=$(($(cat last 2>/dev/null || echo 0) + 1))
  echo "$number" >last.new
  mv last.new last
  mkdir "releases/$number"
  echo "$number $(current)"
}

# finish NUMBER CONFIG COMMIT: releases share the logs of a configuration, bags, and the Python
# libraries if those are the same.
finish() {
  cd "releases/$1" || fail "release $1 is gone"
  name=${2##*/} name=${name%.sh}
  libraries=venv-$(cat scripts/requirements*.txt | sha256sum | cut -c -10)
  mkdir -p log "$folder/log/$name" "$folder/out"
  ln -s "../../$libraries" .venv
  ln -s "../../../log/$name" "log/$name"
  ln -s ../../out out
  FSS_SETUP_NEXT='' scripts/setup.sh </dev/null
  scripts/fss/check.sh "$2" </dev/null
  cd "$folder"
  refuse_running
  echo "$3 $(date +%FT%T) $2" >"releases/$1/RELEASE.new"
  sync
  mv "releases/$1/RELEASE.new" "releases/$1/RELEASE"
  switch "$1"
}

switch() {
  ln -sfn "releases/$1" current.new
  mv -T current.new current
  sync -f current
  echo "release $1 is current: $(cat "current/RELEASE")"
}

list() {
  for number in $(releases); do
    mark=' '
    [ "$number" != "$(current)" ] || mark='*'
    echo "$mark $number $(cat "releases/$number/RELEASE")"
  done
}

rollback() {
  refuse_running
  now=$(current) before=
  for number in $(releases); do
    [ "$number" -ge "${now:-0}" ] || before=$number
  done
  [ "$before" ] || fail "there is no release before the current one"
  switch "$before"
}

main() {
  mkdir -p ~/fss_arm/releases
  cd ~/fss_arm
  folder=$(pwd -P)
  if [ "$1" = list ]; then list; exit; fi
  command -v rsync >/dev/null || fail "rsync is missing there; install it with: sudo apt install rsync"
  exec 9>lock
  flock -n 9 || fail "another deployment to this computer is in progress"
  [ "$1" != begin ] || refuse_running
  "$@"
}
main "$@"
