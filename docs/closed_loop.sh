#!/usr/bin/env bash
# The loop closed: what `diagnose` finds on a machine goes back into the simulator, where policy and identifier are
# trained again. declared/evaluation and mended/evaluation have the errors and successes on such machines before and after.
# Use: docs/closed_loop.sh FOLDER [tiny | full]
#   tiny: object scooping, whose arm goes 8 mm to the side of where it is told. A label says where to scoop whatever the
#         arm does: the declared estimate is off by these 8 mm, and succeeds as often; the mended one is right
#   full: table air hockey, whose arm follows its commands as late as the Panda does (docs/worlds.md)
# The machine is the task's plant with an effect that no model declares. With --world robosuite in the place of these
# effects, in steps 2 and 7, it is the Panda itself, half a second of a core for each stroke.
set -euo pipefail
folder=$1 size=${2:-full}
capture=${CAPTURE:-capture}
mkdir -p "$folder"
cd "$folder"

case $size in
tiny)
  task=scooping
  machine=(--effect control-bias@spatula_x=0.008)
  noise=0.0003 strokes=3
  policy=(--steps 640 --envs 32 --width 32 --lr 0.003 --evaluations 1)
  histories=(--pairs 128 --rounds 4)
  identifier=(--identifier posterior --width 16 --layers 1 --heads 2 --steps 100 --batch 32)
  diagnosis=(--starts 1 --most-effects 1 --no-expression)
  judged=capture-refined=
  evaluation=(--pairs 10 --seeds 1 --rounds 8)
  ;;
full)
  task=air-hockey
  lag=control-second-order-lag
  machine=(--effect $lag@mallet_vx.time_constant=0.107 --effect $lag@mallet_vx.damping_ratio=0.78
    --effect $lag@mallet_vy.time_constant=0.119 --effect $lag@mallet_vy.damping_ratio=0.63)
  noise=0.001 strokes=10
  policy=(--steps 24000 --evaluations 12)
  histories=(--pairs 8192)
  identifier=(--identifier capture-trajectory --width 64 --steps 5000 --batch 128)
  diagnosis=()
  judged=
  evaluation=(--pairs 100 --seeds 3 --rounds 10)
  ;;
*)
  echo "$size: tiny or full" >&2
  exit 2
  ;;
esac

learn() { # NAME OPTIONS: a policy, and an identifier of what it does, in the simulator that the options describe
  $capture train-policy --task $task "${@:2}" "${policy[@]}" --out "$1/policy" --quiet
  $capture gen-histories --task $task "${@:2}" --policy "$1/policy" "${histories[@]}" --out "$1/histories.zarr" --quiet
  $capture train-sysid --histories "$1/histories.zarr" "${identifier[@]}" --out "$1/identifier" --quiet
}

# 1. what is known before the machine is seen: the declared model
mkdir -p declared mended
learn declared
# 2. the machine, with parameters that nobody is told
$capture record --task $task "${machine[@]}" --random-parameters --noise $noise --episodes $strokes --seed 3 \
  --out log.zarr --quiet
# 3. the declared model does not explain it
$capture identify --real-log log.zarr --identifier declared/identifier --out declared/estimate --quiet
# 4. what it lacks
$capture diagnose --real-log log.zarr --estimate declared/estimate "${diagnosis[@]}" --out diagnosis --quiet
# 5. the same in the mended simulator
learn mended --estimate diagnosis
# 6. which explains the log
$capture identify --real-log log.zarr --identifier mended/identifier --out mended/estimate --quiet
# 7. on other such machines: what was learned before, and after
for name in declared mended; do
  $capture eval-sim2sim --task $task "${machine[@]}" --identifier "$judged$name/identifier" --policy $name/policy \
    "${evaluation[@]}" --out $name/evaluation --quiet
done
echo "done: declared/evaluation/tables.md and mended/evaluation/tables.md in $PWD have errors and successes before and after"
