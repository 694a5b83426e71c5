"""Several at a time, and ended by the user."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import canrig
import pytest
from conftest import write_hold

PLAY = "import canrig, sys; print(canrig.simulate(sys.argv[1], output=sys.argv[2]).folder)"
# Whoever runs the tests may have signals ignored.
WAIT = """\
import canrig, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    canrig.run(sys.argv[1], output=sys.argv[2], bus="embedded")
except KeyboardInterrupt:
    print("interrupted")
"""


def test_runs_of_threads_and_processes_do_not_meet(hold, output):
    processes = [
        subprocess.Popen([sys.executable, "-c", PLAY, str(hold), str(output)], stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    with ThreadPoolExecutor(4) as pool:
        runs = list(pool.map(lambda _: canrig.simulate(hold, output=output), range(8)))
    runs += [canrig.Run(process.communicate()[0].strip()) for process in processes]
    assert len({run.folder for run in runs}) == 11
    assert all(run.passed for run in runs)
    assert len({(run.folder / "bus.log").read_bytes() for run in runs}) == 1


def started(scenario, output, **options):
    """A process that plays in real time, as soon as the bus has frames."""
    process = subprocess.Popen(
        [sys.executable, "-c", WAIT, str(scenario), str(output)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )
    for _ in range(300):
        logs = list(output.glob("*/bus.log"))
        if logs and logs[0].stat().st_size > 0:
            return process, logs[0].parent
        assert process.poll() is None, process.communicate()
        time.sleep(0.1)
    raise AssertionError("no frame in 30 s")


def left_over(folder):
    """Processes that work on a run folder."""
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/cmdline", "rb") as command:
                    if os.fsencode(str(folder.parent)) in command.read():
                        found.append(entry)
            except OSError:
                pass
    return found


@pytest.mark.parametrize("to", ["process", "group"])
def test_an_interrupt_ends_the_bench_in_order(to, tmp_path, output):
    # A notebook's interrupt goes to the process; Ctrl-C on a terminal goes to its whole group.
    scenario = write_hold(tmp_path / "long.toml", seconds=120.0, period=100.0)
    process, folder = started(scenario, output)
    send = os.kill if to == "process" else os.killpg
    send(process.pid, signal.SIGINT)
    printed, said = process.communicate(timeout=30)
    assert (printed, process.returncode) == ("interrupted\n", 0), said
    assert left_over(folder) == []
    verdict = json.loads((folder / "verdict.json").read_text())
    assert verdict["outcome"] == "incomplete" and "interrupted" in verdict["reason"]
