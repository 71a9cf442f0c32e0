#!/bin/bash
# One part of an experiment per task of a Slurm job array. See experiments/studies/large-runs.md.
#
#   sbatch --array=1-18 scripts/slurm_array.sh RESULTS billiards
#   sbatch --array=1-8  scripts/slurm_array.sh RESULTS robust --seeds 1..200 --family crowded
#
# To run parts 7 and 9 of 18 again: PARTS=18 sbatch --array=7,9 scripts/slurm_array.sh RESULTS billiards
#
# All nodes must see the folder RESULTS. SMS names the program (default: sms-experiments). Arguments after the experiment's name
# are passed to it. Afterwards: sms-experiments merge RESULTS/parts --out RESULTS/merged
#SBATCH --job-name=sms-experiments
#SBATCH --cpus-per-task=2
#SBATCH --mem=6G
#SBATCH --time=04:00:00
#SBATCH --output=%x-%A_%a.log
set -euo pipefail

if [ $# -lt 2 ]; then
    echo "usage: sbatch --array=1-N $0 RESULTS EXPERIMENT [OPTIONS...]" >&2
    exit 2
fi
results=$1 bench=$2
shift 2
part="$SLURM_ARRAY_TASK_ID/${PARTS:-$SLURM_ARRAY_TASK_COUNT}"
parts="$results/parts"
mkdir -p "$parts"
export RAYON_NUM_THREADS="${SLURM_CPUS_PER_TASK:-2}"

case "$bench" in
# Results in folders, which parts may share: no two parts have the same scene or flight.
billiards | landing) out=(--out "$parts" --keep "$results/scans") ;;
masks | scan) out=(--out "$parts") ;;
materialize) out=(--out "$parts/$bench-$SLURM_ARRAY_TASK_ID.json" --keep "$results/scans") ;;
*) out=(--out "$parts/$bench-$SLURM_ARRAY_TASK_ID.json") ;;
esac
exec "${SMS:-sms-experiments}" "$bench" --shard "$part" "${out[@]}" "$@"
