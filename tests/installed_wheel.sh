#!/usr/bin/env bash
# What is committed, as a wheel, in an empty environment without extras and outside of this checkout.
# Use: tests/installed_wheel.sh PYTHON
set -euo pipefail
python=$(realpath --no-symlinks "$1")
checkout=$(git rev-parse --show-toplevel)
most=700 # MB, of the environment
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

git clone --quiet "$checkout" "$folder/clone"
"$python" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$folder" "$folder/clone"
"$python" -m venv "$folder/environment"
# wheels only: the core needs no compiler
"$folder/environment/bin/pip" install --quiet --disable-pip-version-check --only-binary=:all: \
  --constraint "$folder/clone/constraints/core.txt" "$folder"/capture-*.whl
cp -r "$folder/clone/datasets/air_hockey.zarr" "$folder/log.zarr"
rm -rf "$folder/clone"

cd "$folder"
export PATH="$folder/environment/bin:$PATH"
unset PYTHONPATH
test "$(python -c 'import capture_cli; print(capture_cli.__file__)')" \
  = "$(echo environment/lib/*/site-packages | sed "s#^#$folder/#")/capture_cli/__init__.py"
capture --version
capture tasks | grep -q air-hockey
capture effects | grep -q coulomb-friction
capture identify --real-log log.zarr --out estimate --json --quiet >estimate.json # by the shipped transformer
python -c 'import json; found = json.load(open("estimate.json")); assert found["identifier"] == "capture-refined", found'
test -s estimate/report.html
capture propose estimate --out proposal.json
capture export estimate --out identified.xml
capture record --task air-hockey --actions-from proposal.json --out episode.zarr --quiet
capture import-log episode.zarr --task air-hockey --out log.zarr --append --quiet
capture inspect log.zarr >/dev/null

if capture train-sysid --histories none.zarr --out none 2>message; then exit 1; else test $? = 2; fi
grep -q "pip install 'capture\[learn\]'" message
size=$(du -sm environment | cut -f1)
echo "the wheel works: $size MB installed"
test "$size" -le "$most"
