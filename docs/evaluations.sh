#!/usr/bin/env bash
# The commands behind docs/dev/evaluation.md: runs/evaluation, made again. Run those that you need.
# runs/sysid/air-hockey/capture, equal/N/air-hockey (but expert-distillation and tunenet), ablations, noisy and distance were trained on an H100 or H200 (--device cuda): others give other bytes.
set -eu

# Air hockey: the main table, then the paper's network, noise and fits on the same pairs.
capture gen-histories --task air-hockey --policy runs/policies/air-hockey --pairs 8192 --seed 1 --out randomized-binary.zarr
capture gen-histories --task air-hockey --policy runs/policies/air-hockey --search scattered --pairs 1536 --seed 2 --out scattered.zarr
capture train-sysid --histories randomized-binary.zarr --identifier capture-trajectory --width 64 --steps 5000 --batch 128 --out runs/sysid/air-hockey/capture-trajectory
capture train-sysid --histories randomized-binary.zarr --identifier expert-distillation --width 64 --steps 3000 --batch 128 --out runs/sysid/air-hockey/expert-distillation
capture train-sysid --histories randomized-binary.zarr --identifier tunenet --width 64 --steps 3000 --batch 128 --out runs/sysid/air-hockey/tunenet
capture train-sysid --histories scattered.zarr --identifier capture-refined --width 64 --steps 1200 --batch 128 --out runs/sysid/air-hockey/capture-refined
capture eval-sim2sim --task air-hockey --policy runs/policies/air-hockey --identifier domain-randomization --identifier runs/sysid/air-hockey/expert-distillation --identifier runs/sysid/air-hockey/tunenet --identifier runs/sysid/air-hockey/capture-trajectory --identifier posterior=runs/sysid/air-hockey/capture-refined --identifier runs/sysid/air-hockey/capture-refined --rounds 30 --out runs/evaluation/air-hockey
capture train-sysid --histories randomized-binary.zarr --identifier capture --dropout 0.1 --steps 7000 --patience 50 --out runs/sysid/air-hockey/capture
capture eval-sim2sim --task air-hockey --policy runs/policies/air-hockey --identifier domain-randomization --identifier runs/sysid/air-hockey/capture --identifier runs/sysid/air-hockey/capture-trajectory --rounds 30 --out runs/evaluation/air-hockey-paper
capture eval-sim2sim --task air-hockey --policy runs/policies/air-hockey --noise scale --identifier domain-randomization --identifier runs/sysid/air-hockey/expert-distillation --identifier runs/sysid/air-hockey/tunenet --identifier runs/sysid/air-hockey/capture-trajectory --identifier runs/sysid/air-hockey/capture-refined --pairs 40 --seeds 1 --rounds 10 --out runs/evaluation/air-hockey-noise
capture eval-sim2sim --task air-hockey --policy runs/policies/air-hockey --identifier least-squares --identifier runs/sysid/air-hockey/capture-refined --seeds 1 --rounds 5 --out runs/evaluation/air-hockey-fits
capture eval-sim2sim --task air-hockey --policy runs/policies/air-hockey --identifier compass --identifier runs/sysid/air-hockey/capture-refined --identifier cma-es --pairs 12 --seeds 1 --rounds 5 --out runs/evaluation/air-hockey-budget

# Equal data: everything that learns has the same 1,000 histories, three times, with histories of its own.
equal() { # TASK N NAME:DROPOUT; of dropouts of 0 and 0.1 each has the one that lost less held out (validation_loss of identifier.json; of scooping, in training 1); capture of air hockey, 0.1
  case $1 in
    air-hockey) size="--width 64" ;;
    scooping) size="--width 32 --layers 2 --heads 2" ;;
  esac
  capture gen-histories --task $1 --policy runs/policies/$1 --pairs 1000 --seed $2 --out equal/$1-$2.zarr
  for identifier in "${@:3}"; do
    capture train-sysid --histories equal/$1-$2.zarr --identifier "${identifier%:*}" --dropout "${identifier#*:}" $size --batch 64 --steps 3000 --patience 50 --precision float32 --seed $(($2 - 1)) --out "equal/$2/$1/${identifier%:*}"
  done
}
equal air-hockey 1 expert-distillation:0.1 expert-distillation-all-rounds:0 tunenet:0.1 tunenet-all-rounds:0.1 capture-trajectory:0.1 capture-refined:0 capture:0.1
equal air-hockey 2 expert-distillation:0.1 expert-distillation-all-rounds:0 tunenet:0.1 tunenet-all-rounds:0 capture-trajectory:0.1 capture-refined:0
equal air-hockey 3 expert-distillation:0.1 expert-distillation-all-rounds:0.1 tunenet:0.1 tunenet-all-rounds:0 capture-trajectory:0.1 capture-refined:0
equal scooping 1 expert-distillation:0 expert-distillation-all-rounds:0 tunenet:0 tunenet-all-rounds:0.1 capture-trajectory:0 capture-refined:0 capture:0
equal scooping 2 expert-distillation:0 expert-distillation-all-rounds:0 tunenet:0 tunenet-all-rounds:0.1 capture-trajectory:0 capture-refined:0
equal scooping 3 expert-distillation:0 expert-distillation-all-rounds:0 tunenet:0 tunenet-all-rounds:0.1 capture-trajectory:0 capture-refined:0
rows() { # FOLDER
  echo --identifier domain-randomization
  for identifier in expert-distillation expert-distillation-all-rounds tunenet tunenet-all-rounds capture-trajectory; do
    echo --identifier "equal/$1/$identifier"
  done
  echo --identifier "posterior=equal/$1/capture-refined" --identifier "equal/$1/capture-refined"
}
for task in air-hockey scooping; do for n in 1 2 3; do
  capture eval-sim2sim --task $task --policy runs/policies/$task $(rows $n/$task) --seeds 1 --rounds 10 --out runs/evaluation/$task-equal/$n
done; done
# neural posterior estimation by sbi (extra `benchmarks`), from the same histories
for task in air-hockey scooping; do for n in 1 2 3; do
  python -m docs.neural_posterior --task $task --policy runs/policies/$task --histories equal/$task-$n.zarr --seed $((n - 1)) --out runs/evaluation/$task-equal+npe/$n
done; done
capture eval-sim2sim --task air-hockey --policy runs/policies/air-hockey --identifier domain-randomization --identifier equal/1/air-hockey/capture --identifier equal/1/air-hockey/capture-trajectory --seeds 1 --rounds 10 --out runs/evaluation/air-hockey-equal-paper
capture eval-sim2sim --task scooping --policy runs/policies/scooping --identifier domain-randomization --identifier equal/1/scooping/capture --identifier equal/1/scooping/capture-trajectory --out runs/evaluation/scooping-equal-paper

# L and k: three trainings, each from histories of its own; their checkpoints are not shipped.
train_ablation() { # L NAME OPTIONS
  capture train-sysid --histories "ablations/$task-L$1-$n.zarr" --identifier capture-trajectory $size --steps 2000 --batch 128 --precision float32 --seed $((n - 1)) --out "ablations/$n/$task/$2" "${@:3}"
}
for task in air-hockey scooping; do for n in 1 2 3; do
  case $task in
    air-hockey) size="--width 64" rounds=20 ;;
    scooping) size="--width 32 --layers 2 --heads 2" rounds=$((n == 1 ? 30 : 10)) ;;
  esac
  for L in 5 7 9 13; do
    capture gen-histories --task $task --policy runs/policies/$task --rounds $L --pairs 1536 --seed $n --out ablations/$task-L$L-$n.zarr
    train_ablation $L L$L
  done
  for k in 2 3 5 6; do
    train_ablation 7 k$k --window $k
  done
  capture eval-sim2sim --suite paper --cell $task-L --cell $task-k --identifier ablations/$n --policy runs/policies --seeds 1 --rounds $rounds --out runs/evaluation/$task-ablations/$n
done; done

# Trained with the noise:
capture gen-histories --task air-hockey --policy runs/policies/air-hockey --noise scale --pairs 8192 --seed 1 --out noisy.zarr
capture train-sysid --histories noisy.zarr --identifier capture-trajectory --width 64 --steps 5000 --batch 128 --out noisy/capture
capture eval-sim2sim --task air-hockey --policy runs/policies/air-hockey --noise scale --identifier domain-randomization --identifier noisy/capture --seeds 1 --rounds 20 --out runs/evaluation/air-hockey-noise-trained

# Scooping: the main table, the same with noise, and where identifiers are told which labels are random.
on_scooping() { # FOLDER OPTIONS
  capture eval-sim2sim --task scooping --policy runs/policies/scooping "${@:2}" --identifier runs/sysid/scooping/capture-refined --out "runs/evaluation/$1"
}
others="--identifier domain-randomization --identifier runs/sysid/scooping/expert-distillation --identifier runs/sysid/scooping/tunenet --identifier runs/sysid/scooping/capture-trajectory --identifier posterior=runs/sysid/scooping/capture-refined"
on_scooping scooping $others
on_scooping scooping-noise --noise label $others
on_scooping scooping-known-noise --noise label --known-noise

# Scooping: the paper's network, on the pairs of the main table.
capture gen-histories --task scooping --policy runs/policies/scooping --pairs 8192 --seed 1 --out scooping.zarr
capture train-sysid --histories scooping.zarr --identifier capture --width 32 --layers 2 --heads 2 --batch 128 --steps 3000 --patience 50 --out runs/sysid/scooping/capture
capture eval-sim2sim --task scooping --policy runs/policies/scooping --identifier domain-randomization --identifier runs/sysid/scooping/capture --identifier runs/sysid/scooping/capture-trajectory --out runs/evaluation/scooping-paper

# Scooping: the observation that is not monotonic.
capture train-policy --task scooping-distance --steps 6000 --evaluations 6 --out distance/policy
capture gen-histories --task scooping-distance --policy distance/policy --pairs 4096 --seed 1 --out distance/histories.zarr
capture train-sysid --histories distance/histories.zarr --identifier capture-trajectory --width 32 --layers 2 --heads 2 --steps 2000 --batch 128 --out distance/sysid/capture
capture train-sysid --histories distance/histories.zarr --identifier expert-distillation --width 32 --layers 2 --heads 2 --steps 600 --batch 128 --out distance/sysid/expert-distillation
capture train-sysid --histories distance/histories.zarr --identifier tunenet --width 32 --layers 2 --heads 2 --steps 600 --batch 128 --out distance/sysid/tunenet
capture gen-histories --task scooping-distance --policy distance/policy --search scattered --pairs 4096 --seed 1 --out distance/scattered.zarr
capture train-sysid --histories distance/scattered.zarr --identifier capture-refined --width 32 --layers 2 --heads 2 --steps 2000 --batch 128 --out distance/sysid/capture-refined
capture eval-sim2sim --task scooping-distance --policy distance/policy --identifier domain-randomization --identifier distance/sysid/expert-distillation --identifier distance/sysid/tunenet --identifier distance/sysid/capture --identifier posterior=distance/sysid/capture-refined --identifier distance/sysid/capture-refined --out runs/evaluation/scooping-distance

# In robosuite scenes, robot by robot.
in_world() { # TASK ROBOT PAIRS OPTIONS
  capture eval-sim2sim --task "$1" --world robosuite --robot "$2" --pairs "$3" --policy "runs/policies/$1" --identifier domain-randomization --identifier "runs/sysid/$1/expert-distillation" --identifier "runs/sysid/$1/tunenet" --identifier "runs/sysid/$1/capture-trajectory" "${@:4}" --identifier "runs/sysid/$1/capture-refined" --seeds 1 --rounds 9 --out "runs/evaluation/$1-world-${2,,}"
}
for robot in Panda UR5e Sawyer IIWA Kinova3; do
  in_world scooping $robot 20 --identifier posterior=runs/sysid/scooping/capture-refined
done
for robot in Panda UR5e Sawyer IIWA; do
  in_world air-hockey $robot 8
done
