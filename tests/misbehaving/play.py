"""Plays foreign controllers, drives and masters and stalls of the machine in real time, on canrig's embedded bus: no root, no kernel CAN.
tests/system/test_attribution.py compares what their verdicts say with tests/data/attribution/cases.txt.

    python tests/misbehaving/play.py CANRIG [CASE…]

plays each case once, and puts its recording, cut to what matters, into tests/data/attribution/cases.zst. A case is KIND/MISBEHAVIOUR, or
KIND/MISBEHAVIOUR+MISBEHAVIOUR_OF_THE_NODE_BESIDE_IT, or a KIND for all of it; without any, all are played. Recordings that follow from
others are made anew by tests/misbehaving/edit.py.

Needs canopen and python-can."""

import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import threading

from archive import cut, read_archive, read_cases, write_archive
from embedded import EMULATED, EmbeddedBus, wait_for_zero, wait_until

HERE = pathlib.Path(__file__).resolve().parent
PYTHON = sys.executable
PATIENCE_SECONDS = 60
FOREIGN = 0x20

SCENARIO = """schema = 1
rig = "{rig}"
name = "attribution"
duration_seconds = 3.0

[bus]
sync_period_milliseconds = {period}

[controller.sliding_mode]

[[reference.hold]]
at_seconds = 0.0
position_millimetres = 10.0

[expect]
position_millimetres_max = {{ max = 59.0 }}
"""
PERIODS = {"controller/never_enables": 100.0}


class Kind:
    """The pairs that are played together: options of `canrig run`, the node-ID of the drive, and the foreign programs with their words."""

    def __init__(self, options, drive, *programs):
        self.options, self.drive, self.programs = options, drive, programs
        self.rig = "rig.toml" if drive == FOREIGN else "sma_actuator"


REAL_DRIVE = ["--no-heating"]
KINDS = {
    "controller": Kind(["--external", "controller"], EMULATED, ["controller", "{address}", "scenario.toml", "{name}"]),
    "drive": Kind(REAL_DRIVE, FOREIGN, ["drive", "{address}", "{name}"]),
    "master": Kind([], EMULATED, ["master", "{address}", "0x10", "{name}"]),
    "master_beside_drive": Kind(REAL_DRIVE, FOREIGN, ["drive", "{address}", "{program}"], ["master", "{address}", "0x20", "{name}"]),
    "master_beside_controller": Kind(
        ["--external", "controller"], EMULATED,
        ["controller", "{address}", "scenario.toml", "{program}"], ["master", "{address}", "0x10", "{name}"],
    ),
    "stall": Kind([], EMULATED),
    "stall_beside_controller": Kind(["--external", "controller"], EMULATED, ["controller", "{address}", "scenario.toml", "{program}"]),
    "stall_beside_drive": Kind(REAL_DRIVE, FOREIGN, ["drive", "{address}", "{program}"]),
}

# Of a foreign controller the counter of its SYNC says that there are two.
MASTERS_BESIDE = [
    "master_beside_controller/sync_as_often_with_a_counter+none",
    "master_beside_drive/nmt_stops_the_drive+none",
    "master_beside_drive/one_command_of_900_permille+none",
    "master_beside_drive/sync_as_often+none",
    "master_beside_drive/twenty_commands_of_600_permille+none",
    "master_beside_drive/twenty_commands_of_600_permille+drops_each_3rd_position",
]

# Stalls: the process that is stopped (canrig itself, or one of its nodes), the time, and the duration in milliseconds.
FOR_EVER = 10_000
STALLS = {
    "stall/bench_2_ms": [("canrig", 1.0, 2)],
    "stall/bench_15_ms": [("canrig", 1.0, 15)],
    "stall/bench_30_ms": [("canrig", 1.0, 30)],
    "stall/bench_130_ms": [("canrig", 1.0, 130)],
    "stall/bench_130_ms_at_the_end": [("canrig", 2.9, 130)],
    "stall/controller_30_ms": [("controller", 1.0, 30)],
    "stall/controller_130_ms": [("controller", 1.0, 130)],
    "stall/emulator_30_ms": [("plant-emulator", 1.0, 30)],
    "stall/emulator_130_ms": [("plant-emulator", 1.0, 130)],
    "stall/emulator_for_ever": [("plant-emulator", 1.0, FOR_EVER)],
    "stall/all_130_ms": [("canrig", 1.0, 130), ("controller", 1.0, 130), ("plant-emulator", 1.0, 130)],
    "stall_beside_controller/30_ms_before+killed_at_1s": [("canrig", 0.5, 30)],
    "stall_beside_controller/88_ms_at_the_end+killed_at_1s": [("canrig", 2.9, 88)],
    "stall_beside_controller/30_ms+none": [("canrig", 1.0, 30)],
    "stall_beside_controller/30_ms+leaves_out_each_20th_sync": [("canrig", 1.0, 30)],
    "stall_beside_drive/30_ms_before+runs_away": [("canrig", 0.5, 30)],
    "stall_beside_drive/30_ms_before+switches_off": [("canrig", 0.5, 30)],
}


def names():
    """All cases."""
    listed = {program: subprocess.run([PYTHON, HERE / program], capture_output=True, text=True, check=True).stdout.split()
              for program in ("controller", "drive", "master")}
    of_programs = [f"{kind}/{name}" for kind, listing in listed.items() for name in listing]
    return of_programs + ["controller/never_there"] + MASTERS_BESIDE + list(STALLS)


def play(canrig, case, folder):
    """The run folder of a case."""
    kind_name, _, names = case.partition("/")
    name, _, program = names.partition("+")
    kind = KINDS[kind_name]
    (folder / "scenario.toml").write_text(SCENARIO.format(rig=kind.rig, period=PERIODS.get(case, 20.0)))
    shutil.copy(HERE / "rig.toml", folder)
    shutil.copy(HERE.parent / "foreign" / "servo.eds", folder)
    words = [canrig, "run", "scenario.toml", "--bus", "embedded", "--output", "runs", *kind.options]
    environment = {**os.environ, "NO_COLOR": "1"}
    bench = subprocess.Popen(words, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    address = next(line for line in bench.stdout if line.startswith("bus address: ")).split()[-1]
    values = {"address": address, "name": name, "program": program}
    programs = [
        subprocess.Popen(
            [PYTHON, HERE / program, *(word.format(**values) for word in words)],
            cwd=folder, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )
        for program, *words in kind.programs
        if name != "never_there"
    ]
    threading.Thread(target=stand_still, args=(bench, address, kind.drive, STALLS.get(case, [])), daemon=True).start()
    bench.communicate(timeout=PATIENCE_SECONDS)
    for program in programs:
        program.kill()
        program.wait()
    (run,) = (folder / "runs").iterdir()
    return run


def stand_still(bench, address, drive, stalls):
    """Stops processes at their times, and lets them go on."""
    if not stalls:
        return
    bus = EmbeddedBus(address)
    zero = wait_for_zero(bus, drive)
    bus.shutdown()
    of_name = processes(bench.pid)
    for who, at, _ in stalls:
        wait_until(zero + at + 0.005)
        os.kill(of_name[who], signal.SIGSTOP)
    for who, at, milliseconds in stalls:
        wait_until(zero + at + 0.005 + milliseconds / 1e3)
        try:
            os.kill(of_name[who], signal.SIGCONT)
        except ProcessLookupError:
            pass  # its run is over


def processes(bench):
    """The numbers of canrig and of its nodes, by name."""
    of_name = {"canrig": bench}
    for thread in pathlib.Path(f"/proc/{bench}/task").iterdir():
        for child in (thread / "children").read_text().split():
            words = pathlib.Path(f"/proc/{child}/cmdline").read_text().split("\0")
            of_name[words[2]] = int(child)
    return of_name


def found(canrig, run):
    """Outcome, node and duty of a run folder."""
    verdict = json.loads(subprocess.run([canrig, "replay", "--json", run], capture_output=True, text=True).stdout)
    cause = verdict.get("cause", {})
    return verdict["outcome"], cause.get("node", "-"), cause.get("duty", "-")


def matches(expected, result):
    return all(want in ("*", got) for want, got in zip(expected, result))


def main():
    canrig, *wanted = sys.argv[1:]
    canrig = str(pathlib.Path(canrig).resolve())
    expected = read_cases()
    archive = read_archive()
    for case in [case for case in names() if not wanted or case in wanted or case.split("/")[0] in wanted]:
        with tempfile.TemporaryDirectory() as folder:
            run = play(canrig, case, pathlib.Path(folder))
            result = found(canrig, run)
            archive[case] = cut(run)
            write_archive(archive)
        is_right = matches(expected.get(case, ("?",) * 3), result)
        print(f"{case}: {' '.join(result)}{'' if is_right else ', expected ' + ' '.join(expected.get(case, ['nothing']))}", flush=True)


if __name__ == "__main__":
    main()
