"""CONTRIBUTING.md by its steps to the letter: the metric and the fault are added to a copy of the tree, and schema, check, judge and
torture know them. Only our own crates are compiled again, in a quick profile; nothing is left of them but what cargo keeps."""

import json
import os
import re
import subprocess

import pytest
from conftest import ROOT

# A metric in so many lines.
METRIC_LINES_MAX = 40
TOP = ["canrig", "controller", "dbc", "plant-emulator"]
# A step: the file, where in it, and what is put there.
STEP = re.compile(r"^\d+\. (?P<words>.*?)^   ```\w+\n(?P<block>.*?)^   ```$", re.MULTILINE | re.DOTALL)
PLACE = re.compile(r"`(?P<file>[\w./-]+\.(?:rs|toml))`, (?:behind `(?P<line>[^`]+)`|(?P<end>at the end)|(?P<new>a new file, here `(?P<name>\w+)`))")


def section(name):
    text = (ROOT / "CONTRIBUTING.md").read_text()
    return text.split(f"\n### {name}\n")[1].split("\n### ")[0]


def copied(folder):
    """A copy of the tree's files, and of no build."""
    files = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout
    tree = folder / "canrig"
    tree.mkdir()
    pack = subprocess.Popen(["tar", "--null", "--files-from=-", "-c"], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    unpack = subprocess.Popen(["tar", "-x"], cwd=tree, stdin=pack.stdout)
    pack.stdin.write(files)
    pack.stdin.close()
    assert unpack.wait() == 0 and pack.wait() == 0, "the tree cannot be copied"
    return tree


def follow(tree, name):
    """Does the steps of a section; how many lines it added to the code."""
    steps = list(STEP.finditer(section(name)))
    assert steps, f"CONTRIBUTING.md has no steps for {name}"
    lines = 0
    for step in steps:
        place = PLACE.search(step["words"])
        assert place, f"no file and place in: {step['words']}"
        file = tree / place["file"].replace("NAME", place["name"] or "")
        block = re.sub(r"^ {3}", "", step["block"], flags=re.MULTILINE)
        if place["new"]:
            assert not file.exists(), f"{place['file']} is there already"
            file.write_text(block)
            continue
        text = file.read_text()
        if place["end"]:
            text += block
        else:
            assert text.count(place["line"] + "\n") == 1, f"{place['file']} has not once: {place['line']}"
            text = text.replace(place["line"] + "\n", place["line"] + "\n" + block)
        file.write_text(text)
        lines += block.count("\n")
    return lines


def built(tree, folder, release):
    """The copy's program, under a name of its own: a crate with a law in it has every command."""
    # Beside the copy: what lies below a workspace belongs to it.
    bench = folder / "bench"
    bench.mkdir()
    subprocess.run([release / "canrig", "new", "law", "probe", "--path", bench / "probe", "--canrig", tree], check=True, stdout=subprocess.DEVNULL)
    manifest = (bench / "probe/Cargo.toml").read_text()
    (bench / "Cargo.toml").write_text('[workspace]\nmembers = ["probe"]\nresolver = "3"\n\n' + manifest[manifest.index("[profile.release"):])
    (bench / "Cargo.lock").write_bytes((tree / "Cargo.lock").read_bytes())
    packages = [path.name for path in [*tree.glob("crates/*"), *(tree / name for name in TOP)]]
    quick = bench / "quick.toml"
    quick.write_text("".join(f"[profile.release.package.{name}]\nopt-level = 1\ncodegen-units = 16\n" for name in packages))
    environment = {**os.environ, "CARGO_TARGET_DIR": str(release.parent)}
    subprocess.run(["cargo", "build", "--release", "--offline", "--config", quick], cwd=bench, env=environment, check=True)
    return release / "probe"


@pytest.fixture
def changed_tree(tmp_path):
    """A copy of the tree with the metric and the fault."""
    tree = copied(tmp_path)
    lines = follow(tree, "A metric")
    assert lines <= METRIC_LINES_MAX, f"a metric takes {lines} lines (limit {METRIC_LINES_MAX})"
    follow(tree, "A fault")
    return tree


def test_each_step_finds_its_place(changed_tree):
    assert (changed_tree / "scenarios/faults/amplifier_reversed.toml").exists()


@pytest.mark.slow
def test_schema_check_judge_and_torture_know_both(changed_tree, tmp_path, release):
    canrig = built(changed_tree, tmp_path, release)
    try:
        show(canrig, changed_tree / "scenarios/faults/amplifier_reversed.toml", tmp_path)
    finally:
        canrig.unlink()


def show(canrig, scenario, folder):
    def told(*words, code=0):
        ended = subprocess.run([canrig, *map(str, words)], capture_output=True, text=True)
        text = ended.stdout + ended.stderr
        assert ended.returncode == code, f"{words} ended in {ended.returncode} instead of {code}:\n{text}"
        return " ".join(text.split())

    schema = told("schema")
    assert '"rise_time_seconds"' in schema and '"reversed"' in schema, "the schema does not know them"
    assert "valid" in told("check", scenario)
    wrong = folder / "wrong.toml"
    text = scenario.read_text()
    wrong.write_text(text.replace("rise_time_seconds = { max = 0.25 }", "rise_time_seconds = { maxx = 0.2 }"))
    assert "unknown key `maxx`" in told("check", wrong, code=3)
    wrong.write_text(text.replace("from_seconds = 2.0", "from_second = 2.0"))
    assert "unknown key `from_second`" in told("check", wrong, code=3)
    (verdict,) = json.loads(told("simulate", scenario, "--json", "--output", folder / "runs"))
    rise = next(row for row in verdict["metrics"] if row["name"] == "rise_time_seconds")
    assert 0.01 < rise["value"] < 0.25 and rise["passed"], rise
    wrong.write_text(text.replace("max = 0.25", "max = 0.001"))
    assert "FAIL" in told("simulate", wrong, "--output", folder / "runs", code=1)
    drawn = told("torture", scenario, "--runs", 60, "--seed", 1, "--output", folder / "tortured")
    assert "all invariants held" in drawn, drawn

