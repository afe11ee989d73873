#!/usr/bin/env bash
# The online loop: propose an action, run it, add the episode to the log, take the estimate up. docs/online.md explains.
# Use: docs/online_loop.sh FOLDER [EPISODES] [TASK]; the robot's side is the function `robot`, here a simulated machine.
set -euo pipefail
folder=$1 episodes=${2:-3} task=${3:-air-hockey}
capture=${CAPTURE:-capture}
mkdir -p "$folder"

robot() { # PROPOSAL LOG NUMBER: run the proposed action, write what was measured
  $capture record --task "$task" ${TRUTH:-} --noise 0.0003 --actions-from "$1" --out "$2" --seed "$3" --quiet
}

# two episodes to begin with; nothing is held out while there are so few
$capture record --task "$task" ${TRUTH:-} --noise 0.0003 --episodes 2 --out "$folder/log.zarr" --quiet
$capture identify --real-log "$folder/log.zarr" ${IDENTIFIER:+--identifier "$IDENTIFIER"} --test none \
  --out "$folder/estimate" --quiet

for number in $(seq "$episodes"); do
  $capture propose "$folder/estimate" --out "$folder/proposal-$number.json"
  robot "$folder/proposal-$number.json" "$folder/episode-$number.zarr" "$number"
  $capture import-log "$folder/episode-$number.zarr" --task "$task" --out "$folder/log.zarr" --append --quiet
  $capture identify --real-log "$folder/log.zarr" --out "$folder/estimate" --resume --quiet
done
