# Written by `canrig submit --engine hyperqueue`: a job with one task for each part of a campaign.
#
#     python3 job.py submit       submits it and prints its number
#     python3 job.py state JOB    prints how far it is, as JSON
import json
import os
import sys

# Its errors come without the frames of its own source.
os.environ["RUST_BACKTRACE"] = "0"
import hyperqueue
from hyperqueue.ffi.protocol import ResourceRequest


class Enough(Exception):
    """The state is known; nobody waits for the end here."""


def submit(client):
    job = hyperqueue.Job(default_workdir=FOLDER, max_fails=None, name=NAME)
    for part in PARTS:
        log = f"{LOGS}/hyperqueue-part-{part}.txt"
        resources = {"mem": MEBIBYTES} if MEBIBYTES else {}
        job.program(
            [*COMMAND, "--shard", f"{part}/{OF}"],
            name=f"part {part} of {OF}",
            stdout=log,
            stderr=log + ".errors",
            resources=ResourceRequest(cpus=CORES, resources=resources),
        )
    print(client.submit(job).id)


def state(client, job):
    counts = {}

    def show(jobs):
        counts.update(jobs[job])
        raise Enough

    try:
        client.connection.wait_for_jobs([job], show)
    except Enough:
        pass
    errors = {}
    if counts["completed"] and counts["failed"]:
        failed = client.connection.get_failed_tasks([job])[job]
        # Tasks are numbered from 0, in the order of the parts.
        errors = {PARTS[task]: context.error for task, context in failed.items()}
    print(json.dumps({**counts, "errors": errors}))


if __name__ == "__main__":
    try:
        client = hyperqueue.Client(SERVER or None)
    except Exception as error:
        place = SERVER or "the default folder"
        sys.exit(f"no HyperQueue server answers from {place} ({error}); start one with `hq server start`, or name its folder by --queue")
    if sys.argv[1] == "submit":
        submit(client)
    else:
        state(client, int(sys.argv[2]))
