#!/bin/bash
# A farm of one machine: slurmctld and slurmd in a scratch configuration run a job array of 5 tasks over a sequence, all into
# one dataset. Skipped (status 77) where Slurm is not installed or we are not root.
# Usage: slurm_farm_test.sh BRICKYARD FOLDER_WITH_VDB
set -euo pipefail

brickyard=$1
plume=$2
root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/../.." && pwd)

skip() {
    echo "skipped: $1"
    exit 77
}
[ "$(id -u)" -eq 0 ] || skip "Slurm's daemons need root"
for program in slurmctld slurmd sbatch squeue sinfo munged; do
    command -v "$program" >/dev/null || [ -x "/usr/sbin/$program" ] || skip "$program is not installed"
done
export PATH=$PATH:/usr/sbin

scratch=$(mktemp -d /tmp/brickyard-farm-XXXXXX)
pids=()
cleanup() {
    for pid in "${pids[@]}"; do kill "$pid" 2>/dev/null || true; done
    for pid in "${pids[@]}"; do wait "$pid" 2>/dev/null || true; done
    rm -rf "$scratch"
}
trap cleanup EXIT
fail() {
    echo "failed: $1"
    tail -n 20 "$scratch"/*.log "$scratch"/task-*.out 2>/dev/null || true
    exit 1
}

# Frames enough for each task to have some.
mkdir "$scratch/in" "$scratch/state" "$scratch/spool" "$scratch/munge"
i=0
for round in 1 2 3 4; do
    for file in "$plume"/plume.*.vdb; do
        i=$((i + 1))
        cp "$file" "$(printf '%s/in/plume.%04d.vdb' "$scratch" "$i")"
    done
done

# Credentials of this test alone.
chmod 700 "$scratch/munge"
head -c 1024 /dev/urandom >"$scratch/munge/key"
chmod 400 "$scratch/munge/key"
munged --foreground --force --key-file="$scratch/munge/key" --socket="$scratch/munge/socket" \
    --pid-file="$scratch/munge/pid" --seed-file="$scratch/munge/seed" --log-file="$scratch/munged.log" \
    >"$scratch/munged.out" 2>&1 &
pids+=($!)

node=$(hostname -s)
port=$((20000 + RANDOM % 20000))
cat >"$scratch/slurm.conf" <<CONF
ClusterName=brickyard
SlurmctldHost=$node(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$scratch/munge/socket
CredType=cred/munge
SlurmctldPort=$port
SlurmdPort=$((port + 1))
StateSaveLocation=$scratch/state
SlurmdSpoolDir=$scratch/spool
SlurmctldPidFile=$scratch/slurmctld.pid
SlurmdPidFile=$scratch/slurmd.pid
SlurmctldLogFile=$scratch/slurmctld.log
SlurmdLogFile=$scratch/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=sched_interval=1
MpiDefault=none
ReturnToService=2
MailProg=/bin/true
NodeName=$node NodeAddr=127.0.0.1 CPUs=$(nproc) State=UNKNOWN
PartitionName=farm Nodes=$node Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF=$scratch/slurm.conf
for _ in $(seq 50); do [ -S "$scratch/munge/socket" ] && break || sleep 0.1; done
slurmctld -D >"$scratch/slurmctld.out" 2>&1 &
pids+=($!)
slurmd -D -N "$node" >"$scratch/slurmd.out" 2>&1 &
pids+=($!)
for _ in $(seq 100); do sinfo -h -o %t 2>/dev/null | grep -q '^idle' && break || sleep 0.2; done
sinfo -h -o %t | grep -q '^idle' || fail "the node does not come up"

export BRICKYARD=$brickyard
job=$(sbatch --parsable --array=0-4 --export=ALL --output="$scratch/task-%a.out" "$root/tools/farm/convert.sbatch" \
    "$scratch/in" "$scratch/farm.bricks")
for _ in $(seq 300); do [ -n "$(squeue -h -j "$job" 2>/dev/null)" ] || break; sleep 0.2; done
[ -z "$(squeue -h -j "$job" 2>/dev/null)" ] || fail "the job array does not end"

"$brickyard" verify "$scratch/farm.bricks" || fail "the dataset is not sound"
description=$("$brickyard" info "$scratch/farm.bricks")
grep -qx "  frames 1-$i" <<<"$description" || fail "frames are missing"
[ -z "$(find "$scratch/farm.bricks" -name '.tmp-*')" ] || fail "temporary files were left"
echo "5 tasks converted frames 1-$i into one dataset"
