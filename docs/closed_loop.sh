#!/usr/bin/env bash
# The loop closed: what `diagnose` finds on a machine goes back into the simulator, where policy and identifier are
# trained again. declared/evaluation and mended/evaluation have the errors and successes on such machines before and after.
# Which half gains what, at full size: python -m docs.closed_loop_halves FOLDER
# Use: docs/closed_loop.sh FOLDER [tiny | full | door] [ROBOT]
#   tiny: object scooping, whose arm goes 8 mm to the side of where it is told. A label says where to scoop whatever the
#         arm does: the declared estimate is off by these 8 mm, and succeeds as often; the mended one is right
#   full: table air hockey, played by a robot of robosuite, a Panda, that is late (docs/worlds.md). An hour of a core
#   door: the same with a door that the robot pushes ajar, and one effect at most. A quarter of an hour of a core
# What is in FOLDER is not made again, and what was cut off goes on. declared/policy and declared/identifier may be copies
# of runs/policies and runs/sysid.
set -euo pipefail
folder=$1 size=${2:-full} robot=${3:-Panda}
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
  machine=(--world robosuite --robot "$robot")
  noise=0.001 strokes=10
  policy=(--steps 24000 --evaluations 12)
  histories=(--search scattered --pairs 1536)
  identifier=(--identifier capture-refined --width 64 --steps 1200 --batch 128)
  diagnosis=()
  judged=
  evaluation=(--pairs 24 --seeds 1 --rounds 7)
  ;;
door)
  task=door
  machine=(--world robosuite --robot "$robot")
  noise=0.001 strokes=10
  policy=(--steps 6400 --evaluations 4)
  histories=(--search scattered --pairs 512)
  identifier=(--identifier capture-refined --width 32 --layers 2 --heads 2 --steps 600 --batch 64)
  diagnosis=(--most-effects 1 --no-expression)
  judged=
  evaluation=(--pairs 40 --seeds 1 --rounds 7)
  ;;
*)
  echo "$size: tiny, full or door" >&2
  exit 2
  ;;
esac

make() { # OUT COMMAND OPTIONS
  [ -e "$1" ] || $capture "${@:2}" --out "$1" --quiet
}

learn() { # NAME OPTIONS: a policy, and an identifier of what it does, in the simulator that the options describe
  [ ! -e "$1/identifier" ] || return 0
  make "$1/policy" train-policy --resume --task $task "${@:2}" "${policy[@]}"
  make "$1/histories.zarr" gen-histories --resume --task $task "${@:2}" --policy "$1/policy" "${histories[@]}"
  make "$1/identifier" train-sysid --resume --histories "$1/histories.zarr" "${identifier[@]}"
}

# 1. what is known before the machine is seen: the declared model
mkdir -p declared mended
learn declared
# 2. the machine, with parameters that nobody is told
make log.zarr record --task $task "${machine[@]}" --random-parameters --noise $noise --episodes $strokes --seed 3
# 3. the declared model does not explain it
make declared/estimate identify --real-log log.zarr --identifier declared/identifier
# 4. what it lacks
make diagnosis diagnose --resume --real-log log.zarr --estimate declared/estimate "${diagnosis[@]}"
# 5. the same in the mended simulator
learn mended --estimate diagnosis
# 6. which explains the log
make mended/estimate identify --real-log log.zarr --identifier mended/identifier
# 7. on other such machines: what was learned before, and after
for name in declared mended; do
  make $name/evaluation eval-sim2sim --resume --task $task "${machine[@]}" --identifier "$judged$name/identifier" \
    --policy $name/policy "${evaluation[@]}"
done
echo "done: declared/evaluation/tables.md and mended/evaluation/tables.md in $PWD have errors and successes before and after"
