#!/usr/bin/env bash
# Builds the documentation as a site: the pages, and the Python API from the
# docstrings. A warning, such as a link that leads nowhere, is an error. The
# packages are installed once, into a venv of their own; the last line names the
# file to open.
# usage: docs.sh
set -euo pipefail

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$root/scripts/fss/config.sh"
help "$@"
[[ $# == 0 ]] || fail "unknown argument '$1'; usage: docs.sh"
venv=$root/.cache/docs pins=$root/scripts/requirements-docs.txt site=$root/build/docs

if ! cmp -s "$pins" "$venv/pins.txt"; then
  python=python3
  [[ ! -x $root/.venv/bin/python ]] || python=$root/.venv/bin/python
  rm -rf "$venv"
  "$python" -m venv "$venv"
  "$venv/bin/python" -m pip install --quiet --no-input --disable-pip-version-check --no-deps \
    --only-binary :all: -r "$pins"
  cp "$pins" "$venv/pins.txt"
fi

# The pages keep their places, so that their links to each other and to sources hold.
rm -rf "$site/pages"
mkdir -p "$site/pages/test"
cd "$root"
cp -rp ./*.md docs "$site/pages"
cp -p test/TRIALS.md "$site/pages/test"
for name in bench config scripts src LICENSE; do ln -s "$root/$name" "$site/pages"; done

unset PYTHONPATH
"$venv/bin/python" -m sphinx --fail-on-warning --keep-going --quiet --conf-dir docs \
  --doctree-dir "$site/doctrees" "$site/pages" "$site/html"
echo "$site/html/README.html"
