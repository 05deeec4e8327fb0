#!/bin/sh
# Starts Slurm on this machine, with one node of two processors, or stops it: slurm.sh start|stop FOLDER [PID]
# It also stops when process PID has ended.
set -eu
act=$1 dir=$2
case $act in
start)
    pid=${3:-}
    mkdir -p "$dir/state" "$dir/spool" "$dir/munge"
    # A small file system of its own, where that is allowed: tests fill it.
    mount -t tmpfs -o size=16m tmpfs "$dir/state" 2>/dev/null || true
    chmod 700 "$dir/munge"
    dd if=/dev/urandom of="$dir/munge/key" bs=1024 count=1 2>/dev/null
    chmod 400 "$dir/munge/key"
    host=$(hostname -s)
    memory=$(awk '$1 == "MemTotal:" { print $2 }' /proc/meminfo)
    port=$((20000 + $$ % 20000))
    cat >"$dir/slurm.conf" <<EOF
ClusterName=here
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmctldPort=$port
SlurmdPort=$((port + 1))
AuthType=auth/munge
AuthInfo=socket=$dir/munge/socket
CredType=cred/munge
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool
SlurmctldPidFile=$dir/slurmctld.pid
SlurmdPidFile=$dir/slurmd.pid
SlurmctldLogFile=$dir/slurmctld.log
SlurmdLogFile=$dir/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
MpiDefault=none
SchedulerParameters=sched_interval=1,batch_sched_delay=0,defer_batch
KillWait=5
NodeName=$host NodeAddr=127.0.0.1 CPUs=2 Feature=bench RealMemory=$((memory / 1024)) State=UNKNOWN
PartitionName=all Nodes=$host Default=YES MaxTime=INFINITE State=UP
EOF
    munged --force --key-file="$dir/munge/key" --socket="$dir/munge/socket" --pid-file="$dir/munge/pid" \
        --log-file="$dir/munge/log" --seed-file="$dir/munge/seed"
    export SLURM_CONF="$dir/slurm.conf"
    slurmctld -c
    slurmd
    for n in $(seq 100); do
        case $(sinfo -h -o %T 2>/dev/null) in idle*) break ;; esac
        [ "$n" != 100 ] || { echo "Slurm does not answer: $(cat "$dir"/slurm*.log | tail -n 5)" >&2; exit 1; }
        sleep 0.2
    done
    watch="while kill -0 $pid 2>/dev/null; do sleep 1; done; sh '$0' stop '$dir'; rm -rf '$dir'"
    [ -z "$pid" ] || setsid sh -c "$watch" >/dev/null 2>&1 </dev/null &
    ;;
stop)
    for pid in slurmd.pid slurmctld.pid munge/pid; do
        [ ! -s "$dir/$pid" ] || kill "$(cat "$dir/$pid")" 2>/dev/null || true
    done
    umount -l "$dir/state" 2>/dev/null || true
    ;;
esac
