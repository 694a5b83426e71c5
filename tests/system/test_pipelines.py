"""The shell lines of the pipelines in docs/ci.md, as they are, in a repository that has only scenarios. Each pipeline runs in an
environment of its own, with only Python in it; steps that use actions are left out. `--wheel` names the wheel that is installed."""

import os
import re
import shutil
import subprocess
import time
import venv
import xml.etree.ElementTree

import pytest
import yaml
from conftest import ROOT


def pipelines():
    """Shell scripts by name, and where each looks for JUnit files."""
    text = (ROOT / "docs" / "ci.md").read_text()
    github, gitlab = (yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.DOTALL))
    assert github["jobs"]["bench"]["env"] == {"CANRIG_WHEEL": "${{ vars.CANRIG_WHEEL }}"}
    steps = github["jobs"]["bench"]["steps"]
    (reports,) = (step["with"]["report_paths"] for step in steps if "report_paths" in step.get("with", {}))
    return {
        "GitHub": ([step["run"] for step in steps if "run" in step], reports),
        "GitLab": (gitlab["bench"]["script"], gitlab["bench"]["artifacts"]["reports"]["junit"]),
    }


@pytest.mark.parametrize("name", ["GitHub", "GitLab"])
def test_a_pipeline_of_the_book(request, tmp_path, name):
    wheel = request.config.getoption("--wheel")
    if wheel is None:
        pytest.skip("not run here: no wheel is named by --wheel (python/test_wheel makes one)")
    scripts, reports = pipelines()[name]
    venv.create(tmp_path / "python", with_pip=True)
    checkout = tmp_path / "checkout"
    shutil.copytree(ROOT / "scenarios", checkout / "scenarios")
    path = f"{tmp_path / 'python' / 'bin'}:/usr/bin:/bin:/usr/sbin:/sbin"
    environment = {**os.environ, "PATH": path, "CANRIG_WHEEL": str(wheel.resolve(strict=True))}
    environment.pop("CANRIG_PROGRAM", None)
    for script in scripts:
        begun = time.monotonic()
        # As GitHub runs them; GitLab's are single commands.
        ended = subprocess.run(["bash", "-e", "-o", "pipefail", "-c", script], cwd=checkout, env=environment, capture_output=True, text=True)
        print(f"{ended.returncode}  {time.monotonic() - begun:5.1f} s  {script.splitlines()[0]}", flush=True)
        assert ended.returncode == 0, f"{script}\n{ended.stdout[-3000:]}\n{ended.stderr[-3000:]}"
    suites = [xml.etree.ElementTree.parse(path).getroot() for path in checkout.glob(reports)]
    cases = sum(len(list(suite.iter("testcase"))) for suite in suites)
    folders = len(list(checkout.glob("runs/**/verdict.json")))
    print(f"{len(suites)} JUnit files with {cases} cases, {folders} run folders")
    assert 0 < cases < folders, (cases, folders)
