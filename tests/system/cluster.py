"""Engines on one machine, as an ordinary user: Slurm with two nodes, HyperQueue with workers that can be killed."""

import contextlib
import os
import pathlib
import pwd
import signal
import socket
import subprocess
import sys
import time

SLURM = """ClusterName=canrig
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/none
CredType=cred/none
# How long a task that is run again waits, beside a few seconds.
AuthInfo=cred_expire=2
MpiDefault=none
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SwitchType=switch/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=batch_sched_delay=1,sched_min_interval=200000,sched_interval=1
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
SlurmdTimeout=3
KillWait=2
ReturnToService=2
JobRequeue=1
NodeName=n[0-1] NodeHostname={host} NodeAddr=127.0.0.1 Port=[{ports[1]}-{ports[2]}] CPUs=1 RealMemory=1000
PartitionName=short Nodes=n[0-1] Default=YES MaxTime=60 State=UP
"""


def free_ports(count):
    """Neighbouring ports that nobody uses."""
    for first in range(17000, 30000, count):
        try:
            for port in range(first, first + count):
                with socket.socket() as probe:
                    probe.bind(("127.0.0.1", port))
            return list(range(first, first + count))
        except OSError:
            continue
    raise OSError("no free ports")


class Slurm:
    def __init__(self, work):
        self.folder = work / "slurm"
        (self.folder / "state").mkdir(parents=True)
        text = SLURM.format(host=socket.gethostname().split(".")[0], user=pwd.getpwuid(os.getuid()).pw_name, folder=self.folder, ports=free_ports(3))
        (self.folder / "slurm.conf").write_text(text)
        self.environment = {"SLURM_CONF": str(self.folder / "slurm.conf"), "PATH": os.environ["PATH"] + ":/usr/sbin"}
        self.children = {}
        self.start("slurmctld", ["slurmctld", "-D"])
        for node in ("n0", "n1"):
            self.start_node(node)

    def start(self, name, command):
        with open(self.folder / f"{name}.out", "a") as output:
            environment = {**os.environ, **self.environment}
            self.children[name] = subprocess.Popen(command, env=environment, stdout=output, stderr=output)

    def start_node(self, node):
        self.start(node, ["slurmd", "-D", "-N", node])

    def command(self, *words):
        ran = subprocess.run(words, env={**os.environ, **self.environment}, capture_output=True, text=True)
        return ran.stdout + ran.stderr

    def tasks_on(self, node):
        return self.command("squeue", "--noheader", "--states=running", f"--nodelist={node}", "--format=%i").split()

    def kill_node(self, node):
        """A machine that is gone: Slurm's processes and the tasks, at once."""
        self.children[node].kill()
        self.children[node].wait()
        found = set()
        for folder in pathlib.Path("/proc").iterdir():
            try:
                if not folder.name.isdigit() or folder.stat().st_uid != os.getuid():
                    continue
                if f"SLURMD_NODENAME={node}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                    parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
                    found.add(int(folder.name))
                    if pathlib.Path(f"/proc/{parent}/comm").read_text().startswith("slurmstepd"):
                        found.add(parent)
            except OSError:
                continue
        for pid in found:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def release(self):
        """Lets tasks that Slurm runs again begin now, and not after two minutes; how many there were."""
        waiting = self.command("squeue", "--noheader", "--array", "--states=pending", "--format=%i %r").splitlines()
        waiting = [line.split()[0] for line in waiting if line.endswith("BeginTime")]
        for task in waiting:
            self.command("scontrol", "update", f"JobId={task}", "StartTime=now")
        return len(waiting)

    def is_up(self):
        return self.command("sinfo", "--noheader", "--format=%t").split() == ["idle"]

    def stop(self):
        self.command("scancel", "--user", str(os.getuid()))
        for child in self.children.values():
            child.terminate()
        for child in self.children.values():
            try:
                child.wait(5)
            except subprocess.TimeoutExpired:
                child.kill()


@contextlib.contextmanager
def slurm(work):
    slurm = Slurm(work)
    try:
        end = time.monotonic() + 20
        while not slurm.is_up() and time.monotonic() < end:
            time.sleep(0.2)
        yield slurm
    finally:
        slurm.stop()


# A server with two workers. In the wheel they are threads of the server's process, and nobody can kill one alone: what the
# server sees of a killed worker, its connection that ends, is done to its socket.
QUEUE = """
import json, os, pathlib, socket, sys
from hyperqueue.cluster import LocalCluster, WorkerConfig

cluster = LocalCluster(server_dir=sys.argv[1])
for _ in range(2):
    cluster.start_worker(WorkerConfig(cores=1))
access = json.loads(pathlib.Path(sys.argv[1], "hq-current", "access.json").read_text())
print("ready", flush=True)
for _ in sys.stdin:
    cut = False
    for descriptor in sorted(map(int, os.listdir("/proc/self/fd"))):
        try:
            end = socket.socket(fileno=os.dup(descriptor))
        except OSError:
            continue
        try:
            is_internet = end.family in (socket.AF_INET, socket.AF_INET6)
            if is_internet and not cut and end.getpeername()[1] == access["worker"]["port"]:
                end.shutdown(socket.SHUT_RDWR)
                cut = True
        except OSError:
            pass
        finally:
            end.close()
    print("cut" if cut else "nothing was cut", flush=True)
cluster.stop()
"""


class HyperQueue:
    def __init__(self, work):
        self.folder = str(work / "hyperqueue")
        self.environment = {"CANRIG_PYTHON": sys.executable}
        command = [sys.executable, "-c", QUEUE, self.folder]
        self.child = subprocess.Popen(command, cwd=work, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        while self.child.stdout.readline().strip() not in ("ready", ""):
            pass

    def lose_worker(self):
        """Cuts the connection of a worker to the server."""
        self.child.stdin.write("cut\n")
        self.child.stdin.flush()
        return self.child.stdout.readline().strip() == "cut"

    def stop(self):
        self.child.stdin.close()
        try:
            self.child.wait(10)
        except subprocess.TimeoutExpired:
            self.child.kill()


@contextlib.contextmanager
def hyperqueue(work):
    queue = HyperQueue(work)
    try:
        yield queue
    finally:
        queue.stop()
