"""Fixtures of the suite: the program, runs to look at, and a kernel with CAN.

    cargo build --locked --release --workspace --examples
    pip install -r tests/system/requirements.txt
    pytest tests/system

The programs are those of the target folder; another folder is named by `--release-folder`. A test whose tools are missing is
skipped, with the command that installs them; with `--require-all` it fails."""

import os
import pathlib
import shutil
import subprocess

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]


def pytest_addoption(parser):
    target = os.environ.get("CARGO_TARGET_DIR", ROOT / "target")
    parser.addoption("--release-folder", type=pathlib.Path, default=pathlib.Path(target, "release"), help="folder with canrig, controller and plant-emulator")
    parser.addoption("--require-all", action="store_true", help="fail where a tool is missing, instead of skipping the test")
    parser.addoption("--wheel", type=pathlib.Path, help="wheel of canrig, which the pipelines of docs/ci.md install")
    parser.addoption("--pictures", type=pathlib.Path, help="folder in which the pictures of pages are left")


@pytest.fixture
def require(request):
    """A function that ends the test unless all programs are installed."""
    path = os.environ["PATH"] + ":/usr/sbin:/sbin"

    def require(package, *programs):
        for program in programs:
            if shutil.which(program, path=path):
                continue
            reason = f"not run here: `{program}` is missing (Debian: apt-get install {package})"
            (pytest.fail if request.config.getoption("--require-all") else pytest.skip)(reason)

    return require


@pytest.fixture(scope="session")
def release(request):
    """The folder of the programs."""
    folder = request.config.getoption("--release-folder").resolve()
    assert (folder / "canrig").exists(), f"no canrig in {folder}: `cargo build --locked --release --workspace --examples` makes it"
    return folder


@pytest.fixture(scope="session")
def canrig(release):
    """The program."""
    return release / "canrig"


@pytest.fixture(scope="session")
def told(canrig):
    """A function that runs the program, expects an exit code, and returns what it printed."""

    def told(*arguments, code=0, program=canrig, **options):
        ended = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, errors="replace", **options)
        text = ended.stdout + ended.stderr
        codes = code if isinstance(code, tuple) else (code,)
        assert ended.returncode in codes, f"{arguments} ended in {ended.returncode} instead of {code}:\n{text}"
        return text

    return told


def only(folder):
    """The only entry of a folder."""
    (entry,) = folder.iterdir()
    return entry


@pytest.fixture(scope="session")
def run_folder(told, tmp_path_factory):
    """The folder of a simulated step."""
    runs = tmp_path_factory.mktemp("step")
    told("simulate", ROOT / "scenarios/step.toml", "--quiet", "--output", runs)
    return only(runs)


@pytest.fixture(scope="session")
def motor_run(told, tmp_path_factory):
    """The folder of a simulated run whose plant does not have the frames of dbc/sma_actuator.dbc."""
    runs = tmp_path_factory.mktemp("motor")
    told("simulate", ROOT / "scenarios/motor_step.toml", "--quiet", "--output", runs)
    return only(runs)


@pytest.fixture(scope="session")
def sweep_folder(told, tmp_path_factory):
    """The folder of a sweep over 40 plants, some of which may be too much for the controller, which ends in 1."""
    sweeps = tmp_path_factory.mktemp("sweep")
    text = (ROOT / "scenarios/sweeps/plants.toml").read_text()
    assert "draws = 200\n" in text
    scenario = sweeps.with_name("plants.toml")
    scenario.write_text(text.replace("draws = 200\n", "draws = 20\n"))
    told("sweep", scenario, "--quiet", "--output", sweeps, code=(0, 1))
    return only(sweeps)


@pytest.fixture
def with_can(require):
    """A function that runs a command where a kernel has the CAN bus vcan0, and returns exit code and output."""
    if subprocess.run(["unshare", "--map-root-user", "--net", "ip", "link", "add", "type", "vcan"], capture_output=True).returncode:
        require("user-mode-linux", "linux.uml")

    def with_can(*command, timeout=300, options=()):
        script = [ROOT / "tests/vcan/with_can", "--timeout", timeout, *options, *command]
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        ended = subprocess.run([*map(str, script)], cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
        print(ended.stdout)
        return ended.returncode, ended.stdout

    return with_can


@pytest.fixture
def plays_on_can(with_can):
    """As `with_can`, for a command that must end in 0."""

    def plays_on_can(*command, **options):
        code, text = with_can(*command, **options)
        assert code == 0, text[-3000:]
        return text

    return plays_on_can
