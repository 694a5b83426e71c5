"""Makes those recordings of tests/data/attribution that follow from others, by the table below.

    python tests/misbehaving/edit.py CANRIG

Their names begin with `edited/`. The others are those that tests/misbehaving/play.py made, and two that CANRIG simulates."""

import json
import pathlib
import subprocess
import sys
import tempfile

from archive import CUT, cut, is_enabled, read_archive, write_archive

NEVER = float("inf")
SYNC, POSITION, COMMAND, HEARTBEAT, TEMPERATURE = "080", "190", "210", "710", "290"
OF_A_CONTROLLER = (SYNC, POSITION, COMMAND)
REAL_POSITION, REAL_HEARTBEAT = "1A0", "720"

# Simulated: a step from 10 to 20 mm, and a load that rests for long enough that 22 cycles are less than 1 %.
SCENARIO = """schema = 1
rig = "sma_actuator"
name = "attribution"
duration_seconds = {duration:.1f}

[bus]
sync_period_milliseconds = {period:.1f}

[controller.sliding_mode]

[[reference.hold]]
at_seconds = 0.0
position_millimetres = {position:.1f}

[expect]
position_millimetres_max = {{ max = 59.0 }}
"""
STEP = "\n[[reference.step]]\nat_seconds = 0.6\nposition_millimetres = 20.0\n"
CRASH = '\n[[fault.node.crash]]\nfrom_seconds = 1.0\nnode = "controller"\n'
NOISE = "\n[[fault.sensor.noise]]\nfrom_seconds = 0.0\nnoise_millimetres_rms = 0.01\n"
SLOW = '\n[[fault.node.slow_cycle]]\nfrom_seconds = 0.0\nnode = "controller"\ndelay_milliseconds = 0.1\n'
LIMIT = "position_millimetres_max = { max = 59.0 }"


class Recording:
    """The files of a case, and its frames with their scenario times."""

    def __init__(self, files):
        self.files = dict(files)
        lines = files["bus.log"].splitlines()
        self.frames = [(float(line[1:].split(")")[0]), line) for line in lines]
        enabled = next(at for at, line in enumerate(lines) if is_enabled(line))
        self.zero = next(time for time, line in self.frames[enabled:] if " 080#" in line)

    def save(self):
        self.files["bus.log"] = "".join(f"{line}\n" for _, line in self.frames)
        return self.files


def drop(ids, begin, end=NEVER):
    """Frames that never came."""
    ids = (ids,) if isinstance(ids, str) else ids
    def edit(own):
        is_dropped = lambda time, line: begin <= time - own.zero < end and line.split()[2].split("#")[0] in ids
        own.frames = [(time, line) for time, line in own.frames if not is_dropped(time, line)]
    return edit


def stall(begin, seconds, who="machine", what="stood still"):
    """Evidence that somebody was held up."""
    def edit(own):
        header, *rows = own.files.get("stalls.csv", "from_seconds,until_seconds,who,what\n").splitlines()
        rows.append(f"{own.zero + begin:.6f},{own.zero + begin + seconds:.6f},{who},{what}")
        own.files["stalls.csv"] = "\n".join([header, *sorted(rows, key=lambda row: float(row.split(",")[0]))]) + "\n"
    return edit


def limit(text):
    """Another limit, or none."""
    return lambda own: own.files.update({"scenario.toml": own.files["scenario.toml"].replace(LIMIT, text)})


def scenario(text):
    return lambda own: own.files.update({"scenario.toml": own.files["scenario.toml"] + text})


def hits(row):
    """What the faults of the new scenario hit: without it a recording does not say that."""
    header = "fault,effect,node,identifier,from_seconds,until_seconds,frames,amount"
    return lambda own: own.files.update({"hits.csv": f"{header}\n{row}\n"})


SLOW_HITS = hits("fault.node.slow_cycle.0,late,controller,,0.000000,,0,0.100")
NOISE_HITS = hits("fault.sensor.noise.0,changed,drive,,0.000000,,0,0.000")
CRASH_HITS = hits("fault.node.crash.0,not_run,controller,,1.000000,,0,0.000")


def external(*nodes):
    def edit(own):
        own.files["verdict.json"] = json.dumps(json.loads(own.files["verdict.json"]) | {"external": nodes}) + "\n"
    return edit


def goes_on(own):
    """Beside a fault nobody ends the run of a node that is silent; it is a little shorter, so that it is recorded to its end."""
    verdict = json.loads(own.files["verdict.json"])
    verdict.pop("ended_early", None)
    own.files["verdict.json"] = json.dumps(verdict) + "\n"
    seconds = min(3.0, own.frames[-1][0] - own.zero - 0.02)
    own.files["scenario.toml"] = own.files["scenario.toml"].replace("duration_seconds = 3.0", f"duration_seconds = {seconds:.2f}")


# Cycles that a step of 1 kHz lost in stalls of 2 to 9 ms.
SHORT_STALLS = [edit for at, seconds in [(0.2, 0.002), (0.45, 0.009), (0.75, 0.004), (1.0, 0.009)]
                for edit in (stall(at, seconds), drop(OF_A_CONTROLLER, at + seconds - 0.002, at + seconds))]
LONG_STALL = [stall(0.5, 0.05), drop(OF_A_CONTROLLER, 0.5, 0.55)]

A_POSITION_LOST = [stall(0.5, 0.025), drop(REAL_POSITION, 0.495, 0.515)]

CASES = {
    # Row 1: lasting faults.
    "killed_controller_beside_noise": ("controller/killed_at_1s", goes_on, scenario(NOISE), NOISE_HITS),
    "each_20th_sync_beside_noise": ("controller/leaves_out_each_20th_sync", goes_on, scenario(NOISE), NOISE_HITS),
    "no_command_beside_noise": ("controller/no_command_from_1s", goes_on, scenario(NOISE), NOISE_HITS),
    "dead_drive_beside_slow_cycle": ("drive/none", drop((REAL_POSITION, REAL_HEARTBEAT), 1.5), scenario(SLOW), SLOW_HITS),
    "mute_drive_beside_slow_cycle": ("drive/none", drop(REAL_POSITION, 1.5), scenario(SLOW), SLOW_HITS),
    "each_3rd_position_beside_slow_cycle": ("drive/drops_each_3rd_position", goes_on, scenario(SLOW), SLOW_HITS),
    "killed_on_purpose": ("simulated/crash", limit(""), CRASH_HITS),
    # Row 3: limits beside stalls.
    "limit_met_beside_short_stalls": ("simulated/step", *SHORT_STALLS),
    "limit_missed_by_far_beside_short_stalls": ("simulated/step", *SHORT_STALLS, limit("position_millimetres_max = { max = 12.0 }")),
    "limit_missed_after_a_long_stall": ("simulated/step", *LONG_STALL, limit("position_millimetres_max = { max = 19.0 }")),
    "limit_missed_before_a_long_stall": ("simulated/step", *LONG_STALL, limit("position_millimetres_max = { max = 9.0 }")),
    "limit_missed_without_a_stall": ("simulated/step", limit("position_millimetres_max = { max = 19.0 }")),
    "run_away_after_a_stall": ("drive/runs_away", *A_POSITION_LOST),
    "switched_off_after_a_stall": ("drive/switches_off", *A_POSITION_LOST),
    # Losses that a stall explains, and some that it does not.
    "one_sync_in_a_stall": ("controller/none", stall(1.0, 0.03), drop(OF_A_CONTROLLER, 1.005, 1.03)),
    "six_syncs_in_a_stall": ("controller/none", stall(1.0, 0.13), drop(OF_A_CONTROLLER, 1.005, 1.13)),
    "six_syncs_without_a_stall": ("controller/none", drop(OF_A_CONTROLLER, 1.005, 1.13)),
    "six_syncs_long_after_a_stall": ("controller/none", stall(0.5, 0.13), drop(OF_A_CONTROLLER, 1.005, 1.13)),
    "silent_for_a_second_with_a_stall_in_it": ("controller/mute_from_1s_to_2s", stall(1.5, 0.13)),
    "dead_controller_with_a_stall_at_the_end": ("controller/killed_at_1s", stall(2.85, 0.088)),
    "dead_drive_with_a_stall_of_an_emulator": ("drive/mute", stall(1.4, 1.0, "plant-emulator", "waited for a processor")),
    # Row 8: dead at the end, in less than 1 % of the cycles.
    "drive_dead_in_the_last_22_cycles": ("simulated/rest", external("drive"), drop((POSITION, COMMAND, HEARTBEAT), 2.9775)),
    "controller_dead_in_the_last_22_cycles": ("simulated/rest", external("controller"), drop((*OF_A_CONTROLLER, "701"), 2.9775)),
    "no_command_in_the_last_22_cycles": ("simulated/rest", external("controller"), drop(COMMAND, 2.9775)),
    "drive_silent_in_the_last_3_cycles": ("simulated/rest", external("drive"), drop((POSITION, COMMAND), 2.9965)),
    "temperature_recorded_for_half": ("simulated/hold", drop(TEMPERATURE, 1.5), limit("temperature_celsius = { max = 140.0 }")),
    # Row 11: nothing is limited.
    "dead_drive_without_limits": ("drive/mute", limit("")),
    "sound_without_limits": ("drive/none", limit("")),
}


def simulated(canrig, text, ids=CUT):
    """The recording of a scenario in virtual time, without some of its frames."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        (folder / "scenario.toml").write_text(text)
        subprocess.run([canrig, "simulate", "-q", "scenario.toml", "--output", "runs"], cwd=folder, stdout=subprocess.DEVNULL)
        (run,) = (folder / "runs").iterdir()
        return cut(run, ids)


def main():
    canrig = str(pathlib.Path(sys.argv[1]).resolve())
    archive = {case: files for case, files in read_archive().items() if not case.startswith("edited/")}
    hold = SCENARIO.format(duration=3.0, period=20.0, position=10.0)
    bases = archive | {
        "simulated/step": simulated(canrig, SCENARIO.format(duration=1.2, period=1.0, position=10.0) + STEP),
        "simulated/rest": simulated(canrig, SCENARIO.format(duration=3.0, period=1.0, position=0.0)),
        "simulated/hold": simulated(canrig, hold, CUT.replace("|290", "")),
        "simulated/crash": simulated(canrig, hold + CRASH),
    }
    for name, (base, *edits) in CASES.items():
        own = Recording(bases[base])
        for edit in edits:
            edit(own)
        archive[f"edited/{name}"] = own.save()
    write_archive(archive)


if __name__ == "__main__":
    main()
