#!/usr/bin/env bash
# Every stage once, on sizes that take minutes and teach little: what it takes for real stands in the comments.
# Use: docs/pipeline.sh FOLDER
set -euo pipefail
folder=$1 task=scooping
capture=${CAPTURE:-capture}
mkdir -p "$folder"
cd "$folder"

# who chooses the actions (150 000 episodes)
$capture train-policy --task "$task" --steps 512 --out policy --quiet
# histories to learn from (tens of thousands)
$capture gen-histories --task "$task" --policy policy --pairs 128 --rounds 4 --out histories.zarr --quiet
# the identifier (20 000 steps, width 128)
$capture train-sysid --histories histories.zarr --identifier posterior --width 16 --layers 1 --heads 2 \
  --steps 100 --batch 32 --out identifier --quiet
# on simulated truths (100 pairs, 3 seeds, 30 rounds)
$capture eval-sim2sim --task "$task" --policy policy --identifier identifier --identifier domain-randomization \
  --pairs 4 --seeds 1 --rounds 3 --out evaluation --quiet
# a machine: here a simulated one with parameters that nobody is told, and a sensor whose scale nobody knows of
$capture record --task "$task" --policy policy --random-parameters --effect sensor-scale@rod_tilt.change=-0.1 \
  --noise 0.0003 --episodes 4 --seed 3 --out log.zarr --quiet
$capture identify --real-log log.zarr --identifier identifier --out estimate --quiet
$capture diagnose --real-log log.zarr --estimate estimate --starts 1 --out diagnosis --quiet
echo "done: $PWD/diagnosis/report.html says what was found"
