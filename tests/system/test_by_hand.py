"""The nodes as programs that a hand starts, on the embedded bus of a run that starts neither."""

import pathlib
import signal
import subprocess

from stalls import while_time_flows

SCENARIO = """schema = 1
rig = "sma_actuator"
name = "by hand"
duration_seconds = 2.0
[bus]
sync_period_milliseconds = 100.0
[controller.open_loop]
[[controller.open_loop.step]]
at_seconds = 0.0
current_amperes = 0.3
[expect]
current_amperes_rms = { min = 0.2, max = 0.4 }
"""


def test_a_run_of_two_programs_passes(canrig, release, tmp_path):
    while_time_flows(lambda: play(canrig, release, tmp_path))


def play(canrig, release, tmp_path):
    scenario = tmp_path / "by_hand.toml"
    scenario.write_text(SCENARIO)
    externals = [word for name in ["controller", "drive", "disturbance"] for word in ["--external", name]]
    command = [canrig, "run", scenario, "--bus", "embedded", *externals, "--no-heating", "--output", tmp_path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as run:
        head = "bus address: "
        address = next(line for line in run.stdout if line.startswith(head)).removeprefix(head).strip()
        programs = [release / name for name in ["plant-emulator", "controller"]]
        nodes = [subprocess.Popen([program, "--bus", address, "--scenario", scenario]) for program in programs]
        try:
            text = run.stdout.read()
        finally:
            for node in nodes:
                node.send_signal(signal.SIGINT)
                node.wait()
    assert run.wait() == 0, text


def test_a_wrong_command_line_or_file_or_bus_has_its_exit_code(told, release, tmp_path):
    scenario = tmp_path / "by_hand.toml"
    scenario.write_text(SCENARIO)
    for name in ["plant-emulator", "controller"]:
        program = release / name
        assert "--scenario" in told("--help", program=program)
        told(scenario, code=2, program=program)
        told("--bus", "embedded:/nowhere", "--scenario", "missing.toml", code=3, program=program)
        told("--bus", "embedded:/nowhere", "--scenario", scenario, code=4, program=program)


def test_an_emulator_of_several_plants_asks_which(told, release):
    scenario = pathlib.Path(__file__).parents[2] / "scenarios" / "four_drives_courses.toml"
    arguments = ["--bus", "embedded:/nowhere", "--scenario", scenario]
    program = release / "plant-emulator"
    for plant in [[], ["--plant", "motor"]]:
        assert "--plant: `motor_grip`, `motor_x`" in told(*arguments, *plant, code=3, program=program)
    told(*arguments, "--plant", "motor_x", code=4, program=program)
