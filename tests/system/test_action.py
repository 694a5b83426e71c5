"""The steps of the action in action.yml, run as a runner of GitHub runs them, in a repository that has only scenarios."""

import os
import subprocess

import pytest
import yaml
from conftest import ROOT

SCENARIO = """\
schema = 1
rig = "dc_motor"
name = "a step"
duration_seconds = 4.0

[controller.pid]
proportional_amperes_per_metre = 64.8
integral_amperes_per_metre_second = 489.0
derivative_ampere_seconds_per_metre = 3.74
set_point_weight = 0.377
derivative_filter_radians_per_second = 500.0

[[reference.step]]
at_seconds = 1.0
position_millimetres = 15.0

[expect]
steady_state_error_millimetres = { max = 1.0 }
settling_time_seconds = { max = 0.001 }

[[expect.signal]]
name = "current_amperes"
stays = { max = 0.01 }
"""


class Runner:
    """What a runner of GitHub gives a step: the action's folder, files for its results, and a path."""

    def __init__(self, folder, path):
        self.folder = folder
        self.checkout = folder / "checkout"
        (self.checkout / "scenarios").mkdir(parents=True)
        (folder / "temp").mkdir()
        names = ("GITHUB_STEP_SUMMARY", "GITHUB_OUTPUT", "GITHUB_PATH")
        self.files = {name: folder / name for name in names}
        self.environment = {
            **os.environ,
            **{name: str(file) for name, file in self.files.items()},
            "PATH": path,
            "GITHUB_ACTION_PATH": str(ROOT),
            "RUNNER_TEMP": str(folder / "temp"),
        }
        self.environment.pop("CANRIG_PROGRAM", None)
        action = yaml.safe_load((ROOT / "action.yml").read_text())
        self.steps = {step["name"]: step for step in action["runs"]["steps"]}
        self.inputs = {name: one.get("default", "") for name, one in action["inputs"].items()}

    def run(self, name, **inputs):
        """Runs a step; returns its exit code and its output."""
        values = {
            f"${{{{ inputs.{name} }}}}": value for name, value in {**self.inputs, **inputs}.items()
        }
        environment = {
            name: values.get(value, value) for name, value in self.steps[name]["env"].items()
        }
        ended = subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", self.steps[name]["run"]],
            cwd=self.checkout,
            env={**self.environment, **environment},
            capture_output=True,
            text=True,
        )
        return ended.returncode, ended.stdout + ended.stderr


@pytest.fixture
def runner(tmp_path, release):
    return Runner(tmp_path, f"{release}:/usr/bin:/bin")


def test_missed_limits_are_annotated_at_their_keys(runner):
    scenario = runner.checkout / "scenarios" / "step.toml"
    scenario.write_text(SCENARIO)
    code, text = runner.run("play scenarios")
    assert code == 1, text
    lines = SCENARIO.splitlines()
    for key, name in [
        ("settling_time_seconds", "settling_time_seconds"),
        ("stays", "current_amperes stays"),
    ]:
        number = next(number for number, line in enumerate(lines, 1) if line.startswith(key))
        assert f"::error file=scenarios/step.toml,line={number}::{name}" in text, text
    assert text.count("::error ") == 2, text
    summary = runner.files["GITHUB_STEP_SUMMARY"].read_text()
    assert "| a step (`scenarios/step.toml`) | fail | 1 of 3 | settling_time_seconds " in summary
    assert runner.files["GITHUB_OUTPUT"].read_text() == "outcome=fail\n"


def test_what_passes_has_no_annotation_and_several_paths_are_played(runner):
    for name in ("one", "two"):
        (runner.checkout / f"{name}.toml").write_text(SCENARIO.split("[expect]")[0])
    code, text = runner.run("play scenarios", scenarios="one.toml\ntwo.toml\n", output="out")
    assert code == 0, text
    assert "::error" not in text
    assert runner.files["GITHUB_OUTPUT"].read_text() == "outcome=pass\n"
    assert len(list((runner.checkout / "out").glob("*/verdict.json"))) == 2


def test_an_invalid_scenario_is_an_annotation(runner):
    (runner.checkout / "scenarios" / "wrong.toml").write_text(
        SCENARIO.replace("duration_seconds", "duration_second")
    )
    code, text = runner.run("play scenarios")
    assert code == 3, text
    assert "::error" in text and "duration_second" in text
    code, text = runner.run("play scenarios", scenarios="none.toml")
    assert code == 3 and "::error" in text, text
    assert runner.files["GITHUB_OUTPUT"].read_text() == "outcome=incomplete\n" * 2


def test_the_wheel_is_installed_from_a_path_and_a_missing_one_is_named(request, runner):
    code, text = runner.run("install canrig", path=str(runner.folder / "canrig-9.whl"))
    assert code == 1 and "::error::canrig cannot be installed from" in text, text
    wheel = request.config.getoption("--wheel")
    if wheel is None:
        pytest.skip("not run here: no wheel is named by --wheel (python/test_wheel makes one)")
    code, text = runner.run("install canrig", path=str(wheel.resolve(strict=True)))
    assert code == 0, text
    assert runner.files["GITHUB_PATH"].read_text().endswith("/canrig/bin\n")
