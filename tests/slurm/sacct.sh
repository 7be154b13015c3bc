#!/usr/bin/env bash
# What submitit asks sacct for, `sacct -o JobID,State,NodeList --parsable2 -j JOB [-j JOB ...]`, on a
# SLURM that has no data base of jobs: the same from scontrol.
echo 'JobID|State|NodeList'
while [ $# -gt 0 ]; do
    if [ "$1" = -j ]; then
        scontrol --oneliner show job "$2" 2> /dev/null
        shift
    fi
    shift
done | awk '{
    delete job
    for (i = NF; i > 0; i--)
        if (at = index($i, "="))
            job[substr($i, 1, at - 1)] = substr($i, at + 1)
    id = job["JobId"]
    if ("ArrayTaskId" in job) {
        task = job["ArrayTaskId"]
        id = job["ArrayJobId"] "_" (task ~ /^[0-9]+$/ ? task : "[" task "]")
    }
    print id "|" job["JobState"] "|" job["NodeList"]
}'
