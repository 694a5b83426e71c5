"""Kills canrig, the controller and the plant emulator at random times of runs, and each process of four drives, in turn in real time
and in lock-step, on embedded buses.

No process is left, no socket, no current in a motor whose process lives on, and a run folder that says how far the run came and
which process was killed, and that canrig itself can read again."""

import json
import os
import pathlib
import random
import signal
import subprocess
import tempfile
import time

import pytest
from stalls import while_time_flows

PATIENCE_SECONDS = 10
SCENARIO = """schema = 1
rig = "sma_actuator"
name = "hold"
duration_seconds = {duration}

[controller.sliding_mode]

[[reference.hold]]
at_seconds = 0.0
position_millimetres = 10.0
"""
MOTORS = ("motor_x", "motor_y", "motor_z", "motor_grip")
# With a fault to come each plant says which current flows. The cycle is so long that no node loses another on a busy machine.
RIG_OF_FOUR = """schema = 1
name = "four"
[bus]
sync_period_milliseconds = 10.0
[defaults.drive]
amplifier = { rated = 1.0, min = -1.0, max = 1.0 }
sensor = { unit = "millimetres", min = 0.0, max = 60.0, resolution_bits = 16 }
[node.controller]
kind = "controller"
node_id = 1
"""
MOTOR = """[plant.{motor}.dc_motor]
[node.{drive}]
kind = "drive"
node_id = {node_id}
amplifier.port = "{motor}.current_amperes"
sensor.port = "{motor}.position_metres"
[loop.{drive}]
feedback = "{drive}.position"
outputs = ["{drive}.current"]
"""
SCENARIO_OF_FOUR = """schema = 1
rig = "rig.toml"
name = "four"
duration_seconds = {duration}
[controller.all.open_loop]
[[controller.all.open_loop.step]]
at_seconds = 0.0
current_amperes = 0.05
"""
FAULT_TO_COME = """[[fault.sensor.noise]]
node = "{drive}"
from_seconds = {from_seconds}
noise_millimetres_rms = 0.01
"""
# A real-time run takes so long and a little more; a lock-step run has so much to do that it takes about as long.
DURATIONS_SECONDS = {"real-time": 1.0, "lockstep": 15.0}
LATEST_KILL_SECONDS = 1.3


def processes(mark):
    """Process ids by node name, canrig's own as "canrig", of all whose command line has the mark."""
    found = {}
    for folder in pathlib.Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
            is_zombie = ") Z " in (folder / "stat").read_text()
        except OSError:
            continue
        if not is_zombie and any(mark in word for word in words):
            name = words[words.index("node") + 1] if "node" in words else "canrig"
            if "--plant" in words:
                name = words[words.index("--plant") + 1]
            found[name] = int(folder.name)
    return found


def within_patience(condition):
    end = time.monotonic() + PATIENCE_SECONDS
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def drive_of(motor):
    return motor.removeprefix("motor_")


def write_scenario(path, is_of_four, duration):
    if not is_of_four:
        path.write_text(SCENARIO.format(duration=duration))
        return
    drives = [(drive_of(motor), motor, 0x10 + number) for number, motor in enumerate(MOTORS)]
    rig = [MOTOR.format(drive=drive, motor=motor, node_id=node_id) for drive, motor, node_id in drives]
    path.with_name("rig.toml").write_text(RIG_OF_FOUR + "".join(rig))
    faults = [FAULT_TO_COME.format(drive=drive, from_seconds=0.99 * duration) for drive, _, _ in drives]
    path.write_text(SCENARIO_OF_FOUR.format(duration=duration) + "".join(faults))


def trial(canrig, victim, clock, after, is_of_four):
    """One run with one kill: whether the victim was there to be killed, and all that is not as it should be."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        runtime, runs, scenario = folder / "runtime", folder / "runs", folder / "hold.toml"
        runtime.mkdir()
        write_scenario(scenario, is_of_four, DURATIONS_SECONDS[clock])
        command = [canrig, "run", scenario, "--bus", "embedded", "--clock", clock, "--output", runs]
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(runtime), "TMPDIR": str(runtime)}
        run = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        time.sleep(after)
        target = processes(str(folder)).get(victim)
        if target:
            try:
                os.kill(target, signal.SIGKILL)
            except ProcessLookupError:
                target = None
        stdout, stderr = run.communicate(timeout=60)

        faults = []
        # The run may be over before the kill comes, well or not.
        allowed = {0, 4, 5} | ({-signal.SIGKILL} if victim == "canrig" and target else set())
        if run.returncode not in allowed:
            faults.append(f"exit code {run.returncode}")
        if "panicked" in stderr or "internal error" in stderr:
            faults.append("a panic")
        if not within_patience(lambda: not processes(str(folder))):
            faults.append(f"processes stay: {processes(str(folder))}")
        if victim == "canrig" and list(runtime.iterdir()):
            # Killed before a node could know of the socket; the next run tidies up.
            write_scenario(scenario, is_of_four, 0.1)
            subprocess.run([*command[:-1], folder / "next"], env=environment, capture_output=True)
        if not within_patience(lambda: not list(runtime.iterdir())):
            faults.append(f"files stay: {list(runtime.iterdir())}")
        for left in runs.iterdir() if runs.exists() else ():
            faults += of_folder(canrig, left, run.returncode)
            if is_of_four and run.returncode == 4:
                faults += of_four(left, victim)
        return target is not None, [*faults, stderr] if faults else []


def of_folder(canrig, folder, code):
    """The mistakes in a run folder."""
    if not (folder / "verdict.json").exists():
        # Killed between the making of the folder and its first file.
        return [] if not any((folder / name).exists() for name in ("bus.log", "signals.csv")) else ["no verdict"]
    outcome = json.loads((folder / "verdict.json").read_text())["outcome"]
    faults = []
    if (code == 4) != (outcome == "incomplete") and code in (0, 4):
        faults.append(f"exit code {code}, outcome {outcome}")
    again = subprocess.run([canrig, "replay", folder], capture_output=True, text=True)
    # 3: killed before the first frame.
    if again.returncode not in (0, 3, 4, 5) or "panicked" in again.stderr:
        faults.append(f"replay ends in {again.returncode}: {again.stderr}")
    return faults


def of_four(folder, victim):
    """The mistakes in the report of a killed process in a run folder of four drives."""
    verdict = json.loads((folder / "verdict.json").read_text())
    faults = []
    what = f"the emulator of {victim} and its drive {drive_of(victim)}" if victim in MOTORS else f"the {victim}"
    reason = verdict.get("reason", "")
    if reason.count(f"{what} was killed by signal 9") != 1:
        faults.append(f"the reason: {reason}")
    log = (folder / "bus.log").read_text().splitlines() if (folder / "bus.log").exists() else []
    for number, motor in enumerate(MOTORS):
        said = [line for line in log if f" {0x6B0 + number:03X}#" in line]
        # The first two bytes are the current.
        if motor != victim and said and not said[-1].split("#")[1].startswith("0000"):
            faults.append(f"a current in {motor}: {said[-1]}")
    return faults


OF_ONE = [(victim, False) for victim in ("canrig", "controller", "plant-emulator")]
OF_FOUR = [(victim, True) for victim in ("canrig", "controller", *MOTORS)]


def kill_often(canrig, victim, is_of_four, count, seed):
    """Kills a process in so many runs, in each world at least once; prints how often it was alive."""
    chance = random.Random(f"{seed} {victim} {is_of_four}")
    hits, wrong = 0, []
    for number in range(count):
        clock, after = ("real-time", "lockstep")[number % 2], chance.uniform(0, LATEST_KILL_SECONDS)
        was_hit, faults = trial(canrig, victim, clock, after, is_of_four)
        hits += was_hit
        wrong += [f"killed after {after:.3f} s, {clock}: " + "; ".join(faults)] if faults else []
    print(f"{victim}{' of four drives' if is_of_four else ''}: {count - len(wrong)} of {count} clean; {hits} met it alive")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("victim, is_of_four", OF_ONE + OF_FOUR)
def test_nothing_is_left_of_a_run_that_is_killed(canrig, victim, is_of_four):
    while_time_flows(lambda: kill_often(canrig, victim, is_of_four, 2, 1))


@pytest.mark.slow
@pytest.mark.parametrize("victim, is_of_four", OF_ONE + OF_FOUR)
def test_nothing_is_left_of_many_runs_that_are_killed(canrig, victim, is_of_four):
    while_time_flows(lambda: kill_often(canrig, victim, is_of_four, 10, time.time_ns()))
