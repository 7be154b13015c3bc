#!/usr/bin/env bash
# Start a SLURM of one machine: munged, slurmctld and slurmd, as root, without systemd and cgroups.
#
#   bash up.sh DIR CPUS PORT
#
# It listens on PORT and PORT + 1; all its files are in DIR.  CPUS may be more than there are.  Then:
#
#   export SLURM_CONF=DIR/slurm.conf PATH=DIR/bin:$PATH
#
# down.sh DIR stops it.  Needs the packages slurm-wlm and munge of Debian.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
dir=$1 cpus=$2 port=$3
mkdir -p "$dir"/{bin,log,munge,spool,state}
dir=$(cd "$dir" && pwd)
host=$(hostname -s)
memory=$(awk '/MemTotal/ {print int($2 / 1024) - 512}' /proc/meminfo)

# A key and a socket of its own: /etc and /run stay as they are.
dd if=/dev/urandom of="$dir/munge/key" bs=1024 count=1 status=none
chmod 700 "$dir/munge"
chmod 400 "$dir/munge/key"
munged --force --key-file="$dir/munge/key" --socket="$dir/munge/socket" \
    --pid-file="$dir/munged.pid" --log-file="$dir/log/munged.log" --seed-file="$dir/munge/seed"

# cred_expire: after so many seconds a job that went back to the queue may begin again.
# Partition high pre-empts low: jobs get SIGUSR2, SIGCONT and SIGTERM, have ten seconds, and go back
# to the queue.  preempt_send_user_signal: what a job has asked for by --signal.
cat > "$dir/slurm.conf" <<CONF
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$port
SlurmdPort=$((port + 1))
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$dir/munge/socket,cred_expire=5
CredType=cred/munge
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool
SlurmctldPidFile=$dir/slurmctld.pid
SlurmdPidFile=$dir/slurmd.pid
SlurmctldLogFile=$dir/log/slurmctld.log
SlurmdLogFile=$dir/log/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SwitchType=switch/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=0,sched_interval=1,sched_min_interval=0,bf_interval=1
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
SlurmctldParameters=preempt_send_user_signal
JobRequeue=1
KillWait=5
MinJobAge=3600
ReturnToService=2
SlurmdParameters=config_overrides
NodeName=$host NodeAddr=127.0.0.1 CPUs=$cpus RealMemory=$memory
PartitionName=low Nodes=$host Default=YES MaxTime=INFINITE PriorityTier=1 PreemptMode=REQUEUE GraceTime=10
PartitionName=high Nodes=$host MaxTime=INFINITE PriorityTier=2 PreemptMode=OFF
CONF
printf 'CgroupPlugin=cgroup/v1\nCgroupAutomount=no\n' > "$dir/cgroup.conf"
install -m 755 "$here/sacct.sh" "$dir/bin/sacct"

export SLURM_CONF=$dir/slurm.conf
slurmctld -c
slurmd -c
for _ in $(seq 100); do
    [ "$(sinfo --noheader --format=%T --partition=low 2> /dev/null)" = idle ] && exit 0
    sleep 0.2
done
echo "SLURM did not come up:" >&2
tail -n 20 "$dir"/log/*.log >&2
exit 1
