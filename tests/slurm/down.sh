#!/usr/bin/env bash
# Stop what up.sh DIR has started, jobs included.
set -uo pipefail
dir=$1
export SLURM_CONF=$dir/slurm.conf
scancel --signal=KILL --full --user="$(id -un)" 2> /dev/null
scancel --user="$(id -un)" 2> /dev/null
for _ in $(seq 50); do
    [ -z "$(squeue --noheader 2> /dev/null)" ] && break
    sleep 0.2
done
for daemon in slurmd slurmctld munged; do
    pid=$(cat "$dir/$daemon.pid" 2> /dev/null) || continue
    kill "$pid" 2> /dev/null
    for _ in $(seq 50); do
        kill -0 "$pid" 2> /dev/null || continue 2
        sleep 0.2
    done
    kill -KILL "$pid"
done
