#!/bin/bash
# One training on all GPUs of two nodes: sbatch --export=ALL,DATA=/shared/set,WORK=/shared/work slurm.sh
#SBATCH --job-name=cvn-shape
#SBATCH --nodes=2
#SBATCH --gpus-per-node=4
#SBATCH --ntasks-per-node=4    # one process for each GPU: JAX then gives each process its own
#SBATCH --cpus-per-task=8
#SBATCH --time=24:00:00
#SBATCH --signal=TERM@120      # two minutes before the end of the time: the run saves and stops
#SBATCH --requeue
#SBATCH --open-mode=append

# DATA and WORK lie where all nodes see them. 64 views a step are 8 for each of 8 GPUs.
srun --kill-on-bad-exit=1 .venv/bin/python -m experiments.train \
  --network=shape --data="$DATA" --workdir="$WORK/shape" --batch_size=64
status=$?

# 143 is 128 + SIGTERM: it was stopped and has saved. The same job goes on from there.
if [ $status -eq 143 ]; then scontrol requeue "$SLURM_JOB_ID"; fi
exit $status
