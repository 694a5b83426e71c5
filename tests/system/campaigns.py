"""Campaigns on engines: on Slurm and HyperQueue for real, with nodes, workers and tasks that are lost on the way.

    python tests/system/campaigns.py CANRIG alone|slurm|hyperqueue

test_engines.py runs it. As root it goes on as nobody, since an ordinary user is what all of this is for. What is merged must be what one
machine plays, to the byte. The manifest for Kubernetes is validated, not run. Ends in 1 if anything is not so.
"""

import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time

import cluster

NOBODY = 65534
PATIENCE_SECONDS = 100
RUNS = 240
PARTS = 12

SCENARIO = f"""schema = 1
rig = "sma_actuator"
name = "held"
duration_seconds = 6.0

[controller.sliding_mode]

[[reference.hold]]
at_seconds = 0.0
position_millimetres = 10.0

[expect]
position_millimetres_max = {{ max = 10.4 }}

[sweep]
draws = {RUNS // 2}

[[sweep.list]]
key = "node.drive.sensor.noise_rms"
values = [0.0, 0.03]

[[sweep.uniform]]
key = "plant.wire.mechanics.load_kilograms"
from = 0.03
to = 0.05

[[sweep.uniform]]
key = "seed"
from = 0
to = 1000
"""

RESULTS = ["runs.csv", "runs.parquet", "report.html"]
failures = []


def check(name, is_so, words=""):
    print(f"{'ok    ' if is_so else 'FAILED'}  {name}{f': {words}' if words else ''}", flush=True)
    if not is_so:
        failures.append(name)


def within_patience(condition, seconds=PATIENCE_SECONDS):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


class Campaign:
    """`canrig submit` at work on a campaign of its own."""

    def __init__(self, canrig, work, engine, environment, *options, scenario="held.toml"):
        self.output = work / f"of-{engine}-{len(list(work.iterdir()))}"
        self.environment = {**os.environ, **environment, "NO_COLOR": "1"}
        self.command = [canrig, "submit", work / scenario, "--output", self.output, *options]
        self.engine = engine
        self.begun = time.monotonic()
        self.child = None

    def start(self, *options):
        self.child = subprocess.Popen(
            [*self.command, *options], env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        return self

    def end(self, seconds=PATIENCE_SECONDS):
        try:
            said, _ = self.child.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            self.child.kill()
            said, _ = self.child.communicate()
            said += "\n(it did not end)"
        self.seconds = time.monotonic() - self.begun
        return self.child.returncode, said

    @property
    def folder(self):
        found = [path for path in self.output.glob("*") if (path / "engine").is_dir()] if self.output.exists() else []
        return found[0] if found else None

    def parts(self):
        return sorted(self.folder.glob("engine/parts/*-of-*")) if self.folder else []

    def rows(self):
        """Rows on the disk so far."""
        return sum(max(lines - 1, 0) for files in self.attempts().values() for _, lines in files)

    def attempts(self):
        """Machine and whole lines of each file of rows, by part."""
        return {part.name.rsplit("-", 3)[1]: [attempt(path) for path in files_of(part)] for part in self.parts()}


def files_of(folder):
    """Files of rows in a folder, in the order in which they were begun."""
    return sorted(folder.glob("rows*.jsonl"), key=lambda path: int(path.stem.removeprefix("rows").lstrip("-") or 1))


def attempt(path):
    lines = path.read_bytes().split(b"\n")[:-1]
    return json.loads(lines[0])["header"]["node"] if lines else "?", len(lines)


def cases(folder):
    """Cases of a folder's rows, each as often as it was played."""
    lines = (line for path in files_of(folder) for line in path.read_text().splitlines()[1:])
    return sorted(json.loads(line)["row"]["case"] for line in lines if line.endswith("}}"))


def processes(*words):
    """Process ids of all whose command line has the words."""
    found = []
    for folder in pathlib.Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                line = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                if (folder / "stat").stat().st_uid == os.getuid() and all(word in line for word in words):
                    found.append(int(folder.name))
            except OSError:
                pass
    return [pid for pid in found if pid != os.getpid()]


def same(whole, folder):
    return [name for name in RESULTS if (whole / name).read_bytes() != (folder / name).read_bytes()]


def report(campaign, seconds_alone):
    """The tasks that were lost and run again, and the cost of the engine."""
    attempts = campaign.attempts()
    began = sum(map(len, attempts.values()))
    print(f"        {campaign.engine}: part  lost on                   rows kept")
    for part, files in sorted(attempts.items(), key=lambda item: int(item[0])):
        lost = files[:-1]
        if lost:
            kept = sum(max(lines - 1, 0) for _, lines in lost)
            print(f"        {campaign.engine}: {part:>4}  {', '.join(node for node, _ in lost):<24}  {kept} of {RUNS // PARTS}")
    overhead = (campaign.seconds - seconds_alone) / PARTS
    print(
        f"        {campaign.engine}: {began} attempts at {PARTS} parts in {campaign.seconds:.1f} s, "
        f"{began / campaign.seconds:.2f} tasks/s, {RUNS / campaign.seconds:.1f} rows/s "
        f"(one machine alone {RUNS / seconds_alone:.1f} rows/s), {overhead:.2f} s per part more than alone",
        flush=True,
    )


def main():
    canrig, part = pathlib.Path(sys.argv[1]).resolve(), sys.argv[2]
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="canrig-engines-") as work:
        work = pathlib.Path(work)
        # User "nobody" may not be able to read the build folder.
        program = work / "canrig"
        shutil.copy(canrig, program)
        if os.getuid() == 0:
            for path in (work, program):
                os.chown(path, NOBODY, NOBODY)
            become_nobody()
        (work / "held.toml").write_text(SCENARIO)
        (work / "torture.toml").write_text(SCENARIO.split("[sweep]")[0])
        alone, seconds_alone = play_alone(program, work)
        if part == "alone":
            manifest(program, work)
            refused(program, work)
            lost_disk(program, work, alone)
            twice_at_once(program, work)
        elif part == "slurm":
            with cluster.slurm(work) as slurm:
                on_slurm(program, work, slurm, alone, seconds_alone)
        else:
            with cluster.hyperqueue(work) as queue:
                on_hyperqueue(program, work, queue, alone, seconds_alone)
    print(f"{len(failures)} failures, {time.monotonic() - began:.0f} s")
    return 1 if failures else 0


def become_nobody():
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)
    os.environ["HOME"] = "/nonexistent"
    os.environ["USER"] = os.environ["LOGNAME"] = "nobody"


def play_alone(canrig, work):
    begun = time.monotonic()
    output = work / "alone"
    played = subprocess.run([canrig, "sweep", work / "held.toml", "--output", output, "--quiet"], capture_output=True)
    seconds = time.monotonic() - begun
    check("one machine plays all of it", played.returncode in (0, 1), f"{RUNS / seconds:.1f} rows/s with {os.cpu_count()} cores")
    for threads in (1, 2):
        begun = time.monotonic()
        folder = work / f"threads-{threads}"
        command = [canrig, "sweep", work / "held.toml", "--shard", "1/4", "--threads", str(threads), "--for-engine", "--quiet"]
        code = subprocess.run([*command, "--output", folder]).returncode
        rate = RUNS / 4 / (time.monotonic() - begun)
        check(f"a part with {threads} at a time", code == 0, f"{rate:.1f} rows/s")
    return next(output.iterdir()), seconds


def manifest(canrig, work):
    """The Job for Kubernetes: valid by the official schemas. It is not run: here is no cluster."""
    command = [canrig, "submit", work / "held.toml", "--engine", "kubernetes", "--parts", str(PARTS), "--task-minutes", "30"]
    command += ["--task-mebibytes", "512", "--queue", "tests", "--claim", "disk", "--output", work / "k8s", "--dry-run"]
    written = subprocess.run(command, capture_output=True, text=True)
    path = work / "job.json"
    path.write_text(written.stdout)
    validate = pathlib.Path(sys.executable).with_name("kubernetes-validate")
    judged = subprocess.run([validate, "--strict", path], capture_output=True, text=True)
    check("the manifest for Kubernetes is valid (it is not run)", judged.returncode == 0, judged.stdout + judged.stderr)
    broken = json.loads(written.stdout)
    broken["spec"]["backoffLimitPerIndex"] = "two"
    path.write_text(json.dumps(broken))
    judged = subprocess.run([validate, "--strict", path], capture_output=True)
    check("one that is wrong is not", judged.returncode != 0)
    check("--dry-run leaves nothing behind", not (work / "k8s").exists())


def refused(canrig, work):
    """Engines that are not there, and parts that nobody numbers."""
    for engine, words in (("slurm", "sbatch cannot be started"), ("kubernetes", "kubectl cannot be started")):
        campaign = Campaign(canrig, work, engine, {"PATH": "/nowhere"}, "--engine", engine).start()
        code, said = campaign.end()
        check(f"no {engine} here", code == 4 and words in said, said.strip()[-160:])
    command = [canrig, "sweep", work / "held.toml", "--shard", "auto", "--output", work / "none"]
    played = subprocess.run(command, capture_output=True, text=True)
    check("no engine runs the part", played.returncode == 3 and "no engine runs this command" in played.stderr)


def lost_disk(canrig, work, alone):
    """A file that may not grow is what a full disk is to a program: nothing that was done is lost."""
    command = [canrig, "sweep", work / "held.toml", "--shard", "1/1", "--for-engine", "--quiet", "--output", work / "full"]
    full = subprocess.run(["sh", "-c", "ulimit -f 40; exec \"$@\"", "sh", *command], capture_output=True, text=True)
    check("a full disk is a loss", full.returncode == 4 and "cannot be written" in full.stderr, full.stderr.strip()[-120:])
    again = subprocess.run(command, capture_output=True, text=True)
    folder = next((work / "full").iterdir())
    (_, kept), (_, rest) = map(attempt, files_of(folder))
    check("what was done was kept", kept > 1 and kept - 1 + rest - 1 == RUNS, f"{kept - 1} rows")
    check("the row that was cut is named", f"line {kept + 1} of " in again.stderr, again.stderr.strip()[-120:])
    finished = subprocess.run([word for word in command if word != "--for-engine"], capture_output=True)
    check("with room again, the tables are the same", again.returncode == 0 and finished.returncode in (0, 1) and not same(alone, folder))


def twice_at_once(canrig, work):
    """The same part by two at the same time, with no locks between them: the tables are those of one."""
    command = [canrig, "sweep", work / "held.toml", "--shard", "2/6", "--for-engine", "--quiet", "--output"]
    subprocess.run([*command, work / "once"])
    both = [subprocess.Popen([*command, work / "twice"]) for _ in range(2)]
    codes = [one.wait() for one in both]
    once, twice = (next((work / name).iterdir()) for name in ("once", "twice"))
    check("both end well, each with a file of its own", codes == [0, 0] and len(files_of(twice)) == 2, str(codes))
    check("no case is missing", sorted(set(cases(twice))) == cases(once))
    for name in ("once", "twice"):
        subprocess.run([*(word for word in command if word != "--for-engine"), work / name], capture_output=True)
    check("a part played twice at once has the same tables", not same(once, twice), str(same(once, twice)))


def on_slurm(canrig, work, slurm, alone, seconds_alone):
    environment = slurm.environment
    options = ("--engine", "slurm", "--parts", str(PARTS), "--task-minutes", "10", "--task-mebibytes", "300")
    bad = Campaign(canrig, work, "slurm", environment, *options, "--queue", "nowhere").start()
    code, said = bad.end()
    check("a queue that refuses", code == 4 and "invalid partition" in said, said.strip()[-120:])

    campaign = Campaign(canrig, work, "slurm", environment, *options)
    campaign.start()
    check("tasks begin", within_patience(lambda: campaign.rows() > 10))
    # The watching command may end; the job goes on.
    campaign.child.send_signal(signal.SIGINT)
    code, said = campaign.end()
    check("the job goes on without canrig submit", code == 130 and "--resume" in said)
    again = subprocess.run(campaign.command, env=campaign.environment, capture_output=True, text=True)
    check("it is not submitted twice", again.returncode == 3 and "submitted already" in again.stderr, again.stderr.strip()[-100:])
    campaign.command = [word for word in campaign.command if word not in ("--engine", "slurm", "--parts", str(PARTS))]
    campaign.start("--resume")
    on_n1 = within_patience(lambda: slurm.tasks_on("n1"))
    slurm.kill_node("n1")
    check("a slurmd and its tasks are killed in the middle", on_n1, ", ".join(slurm.tasks_on("n1")))
    cancelled = within_patience(lambda: slurm.tasks_on("n0"))
    slurm.command("scancel", slurm.tasks_on("n0")[0] if cancelled else "1")
    check("a task is cancelled", cancelled)
    slurm.command("scontrol", "update", "NodeName=n0", "State=DRAIN", "Reason=test")
    check("a node is drained", "drain" in slurm.command("sinfo", "--noheader", "--format=%N %T"))
    slurm.start_node("n1")
    within_patience(lambda: slurm.tasks_on("n1"))
    for pid in processes("canrig", "--for-engine", str(campaign.output))[:1]:
        os.kill(pid, signal.SIGKILL)
    slurm.command("scontrol", "update", "NodeName=n0", "State=RESUME")
    check("Slurm runs the tasks of the lost node again", within_patience(slurm.release))
    code, said = campaign.end()
    check("the campaign comes to its end", code in (0, 1), "\n" + said[-1500:])
    if code in (0, 1):
        check("Slurm: merged bytes are those of one machine", not same(alone, campaign.folder), str(same(alone, campaign.folder)))
    report(campaign, seconds_alone)
    again = subprocess.run([*campaign.command, "--resume"], env=campaign.environment, capture_output=True, text=True)
    check("what is whole is not submitted again", again.returncode == code and "job" not in again.stdout.split("runs:")[0])
    foreign_parts(canrig, campaign)


def foreign_parts(canrig, campaign):
    """Rows of another part and lines that were changed: named, not counted."""
    rows = files_of(campaign.parts()[0])[-1]
    whole = rows.read_bytes()
    rows.write_bytes(files_of(campaign.parts()[1])[-1].read_bytes())
    merge = [canrig, "merge", *campaign.parts(), "--output", campaign.output / "merged", "--quiet"]
    merged = subprocess.run(merge, capture_output=True, text=True)
    check("a part in the place of another is found missing", merged.returncode == 3 and "are missing" in merged.stderr, merged.stderr.strip()[-120:])
    lines = whole.decode().splitlines(keepends=True)
    rows.write_text("".join([lines[0].replace('"version":"', '"version":"9'), lines[1].replace('"id":"', '"id":"9'), *lines[2:]]))
    merged = subprocess.run(merge, capture_output=True, text=True)
    said = all(f"line {line} of {rows} is damaged" in merged.stderr for line in (1, 2))
    check("damaged lines are named", merged.returncode == 3 and said and "1 of " in merged.stderr, merged.stderr.strip()[-120:])
    rows.write_bytes(whole)


def on_hyperqueue(canrig, work, queue, alone, seconds_alone):
    options = ("--engine", "hyperqueue", "--parts", str(PARTS), "--queue", queue.folder)
    campaign = Campaign(canrig, work, "hyperqueue", queue.environment, *options).start()
    check("HyperQueue's tasks begin", within_patience(lambda: campaign.rows() > 10))
    check("a worker is lost in the middle", queue.lose_worker())
    for pid in processes("canrig", "--for-engine", str(campaign.output))[:1]:
        os.kill(pid, signal.SIGKILL)
    code, said = campaign.end()
    check("the campaign comes to its end", code in (0, 1), "\n" + said[-1200:])
    if code in (0, 1):
        check("HyperQueue: merged bytes are those of one machine", not same(alone, campaign.folder), str(same(alone, campaign.folder)))
    report(campaign, seconds_alone)
    options = ("--engine", "hyperqueue", "--parts", "3", "--queue", queue.folder, "--torture", "60")
    torture = Campaign(canrig, work, "hyperqueue", queue.environment, *options, scenario="torture.toml").start()
    code, said = torture.end()
    check("torture by an engine", code in (0, 1) and "60 runs" in said, said.strip()[-200:])
    gone = Campaign(canrig, work, "hyperqueue", {**queue.environment, "CANRIG_PYTHON": "/nowhere/python"}, *options).start()
    code, said = gone.end()
    check("no client of HyperQueue here", code == 4 and "cannot be started" in said)


if __name__ == "__main__":
    sys.exit(main())
