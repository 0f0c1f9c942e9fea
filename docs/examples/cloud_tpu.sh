#!/bin/bash
# One training on a Cloud TPU v5e with 4 hosts of 4 chips: bash cloud_tpu.sh
# The data set is read from a bucket. The run's folder lies on a file share that all hosts mount
# (Filestore at $SHARE, such as 10.0.0.2:/share), for Orbax writes from all of them.
set -e
NAME=cvn ZONE=us-west4-a SHARE=${SHARE:?} DATA=${DATA:?such as gs://BUCKET/set/} SOURCE=${SOURCE:?the repository}

on_all_hosts() { gcloud compute tpus tpu-vm ssh "$NAME" --zone="$ZONE" --worker=all --command="$1"; }

gcloud compute tpus tpu-vm create "$NAME" --zone="$ZONE" \
  --accelerator-type=v5litepod-16 --version=v2-alpha-tpuv5-lite
on_all_hosts "sudo apt-get -qq install -y nfs-common python3-venv && sudo mkdir -p /share &&
  sudo mount $SHARE /share && git clone -q $SOURCE cvn && python3 -m venv cvn/.venv &&
  cvn/.venv/bin/pip install -q -c cvn/constraints.txt -e cvn &&
  cvn/.venv/bin/pip install -q -U 'jax[tpu]'"
# All hosts start the same command; JAX finds the others by itself.
on_all_hosts "cd cvn && .venv/bin/python -m experiments.train \
  --network=shape --data=$DATA --workdir=/share/shape --batch_size=256"
