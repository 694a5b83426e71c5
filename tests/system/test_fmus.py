"""FMUs of other makers in canrig as plants and as laws, beside FMPy: those of pythonfmu3 (FMI 3.0) and pythonfmu (FMI 2.0), and one in C
that does what FMUs must not do. Then canrig's own in FMPy: validated, played, and imported again.

Needs gcc, and a Python with its shared library (Debian: libpython3-dev)."""

import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import fmpy
import pytest
from conftest import ROOT
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

LIMIT = 1e-9
FMUS = ROOT / "tests" / "fmu"
# The program, the one that plays an FMU alone, and the folder of the FMUs and of what is played with them: set by `fmus`.
canrig, fmu_play, work = None, None, None


@pytest.fixture(scope="module", autouse=True)
def fmus(release, tmp_path_factory):
    """The FMUs of other makers, in a folder of their own."""
    global canrig, fmu_play, work
    canrig, fmu_play, work = release / "canrig", release / "examples/fmu_play", tmp_path_factory.mktemp("fmu")
    # The FMUs start the Python of this environment, and the law in Python imports canrig's package.
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setenv("PATH", path)
        monkeypatch.setenv("PYTHONPATH", str(ROOT / "python"))
        for maker, sources in (("pythonfmu3", ["heater.py", "gain3.py"]), ("pythonfmu", ["spring.py", "gain2.py"])):
            for source in sources:
                subprocess.run([maker, "build", "-f", source, "-d", work], cwd=FMUS, check=True)
        library = work / "awkward/binaries" / f"{platform.machine()}-linux" / "awkward.so"
        library.parent.mkdir(parents=True)
        shutil.copy(FMUS / "awkward.xml", work / "awkward/modelDescription.xml")
        headers = Path(fmpy.__file__).parent / "c-code"
        flags = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-I", headers]
        subprocess.run(["gcc", *flags, FMUS / "awkward.c", "-o", library], check=True)
        shutil.make_archive(str(work / "awkward"), "zip", work / "awkward")
        (work / "awkward.zip").rename(work / "awkward.fmu")
        for plant in OURS:
            for fmi in [2, 3]:
                tells(run("fmu", "--export", plant, "--output", work / f"{plant}{fmi}.fmu", "--fmi", fmi), f"{plant}, FMI {fmi}.0")
        yield


def check(is_met, words):
    assert is_met, words


def run(*words, code=0, program=None):
    done = subprocess.run([program or canrig, *map(str, words)], capture_output=True, text=True, timeout=60)
    check(done.returncode == code, f"{words} ended in {done.returncode}, not {code}:\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def run_alone(*words, code=0):
    return run(*words, code=code, program=fmu_play)


def tells(text, *all_words):
    flat = " ".join(text.split())
    for words in all_words:
        check(words in flat, f"no word of `{words}` in:\n{text}")


def table(name, ports, start="", more=""):
    path = work / f"{name}.toml"
    ports = "\n".join(f"{port} = {{ variable = \"{variable}\" }}" for port, variable in ports.items())
    file = name.split("-")[0] + ".fmu"
    path.write_text(f"[plant.p.fmu]\nfile = \"{file}\"\n{more}\n[plant.p.fmu.start]\n{start}\n[plant.p.fmu.ports]\n{ports}\n")
    return path


def play(path, steps, inputs=None, step_milliseconds=1.0):
    words = [path, "--steps", steps, "--step-milliseconds", step_milliseconds]
    if inputs:
        file = work / "inputs.csv"
        names = list(inputs)
        rows = [",".join(names)] + [",".join(map(repr, row)) for row in zip(*inputs.values())]
        file.write_text("\n".join(rows) + "\n")
        words += ["--inputs", file]
    lines = run_alone(*words).splitlines()
    names = lines[0].split(",")
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
    return {name: [row[place] for row in rows] for place, name in enumerate(names)}


def oracle(fmu, steps, step, inputs, outputs, start=None):
    """The same by FMPy: sets the inputs, steps, reads the outputs."""
    description = fmpy.read_model_description(fmu, validate=False)
    variables = {variable.name: variable for variable in description.modelVariables}
    folder = tempfile.mkdtemp(dir=work)
    fmpy.extract(str(fmu), folder)
    is_three = description.fmiVersion.startswith("3")
    kind = FMU3Slave if is_three else FMU2Slave
    slave = kind(guid=description.guid, unzipDirectory=folder, modelIdentifier=description.coSimulation.modelIdentifier, instanceName="p")
    slave.instantiate()

    def access(what, name, *values):
        variable = variables[name]
        call = getattr(slave, f"{what}{variable.type}")
        reference = [variable.valueReference]
        return call(reference, *values) if values else call(reference)[0]

    for name, value in (start or {}).items():
        access("set", name, [value])
    if not is_three:
        slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    result = {name: [access("get", name)] for name in outputs}
    for index in range(steps):
        for name, values in inputs.items():
            access("set", name, [values[index]])
        slave.doStep(currentCommunicationPoint=index * step, communicationStepSize=step)
        for name in outputs:
            result[name].append(access("get", name))
    slave.terminate()
    slave.freeInstance()
    shutil.rmtree(folder)
    return result


def furthest(ours, theirs):
    check(len(ours) == len(theirs) and len(ours) > 1, f"{len(ours)} and {len(theirs)} values")
    return max(abs(a - b) for a, b in zip(ours, theirs))


def equal(what, ours, theirs, limit=LIMIT, moves=True):
    apart = furthest(ours, theirs)
    check(apart <= limit, f"{what}: {apart} apart")
    check((max(theirs) - min(theirs) > 1e-6) == moves, f"{what}: {'nothing' if moves else 'something'} moves")
    print(f"{what}: {len(ours)} values, at most {apart:.1e} apart")


def test_heater():
    fmu = work / "Heater.fmu"
    told = run("fmu", fmu)
    tells(told, "Heater, FMI 3.0", "PythonFMU3", "(this machine)", "steps: of any length", "current kA", "temperature degC", "needsExecutionTool")
    tells(run("fmu", fmu, "--rig"), "[plant.heater.fmu]", "temperature_celsius = { variable = \"temperature\" }")
    steps = 500
    current = [0.5 if index < 250 else 1.5 for index in range(steps)]
    path = table("Heater", {"current_amperes": "current", "block_kelvins": "temperature", "steps": "steps"}, "capacity = 30.0")
    ours = play(path, steps, {"current_amperes": current})
    inputs = {"current": [value / 1e3 for value in current]}
    theirs = oracle(fmu, steps, 1e-3, inputs, ["temperature", "steps"], {"capacity": 30.0})
    equal("pythonfmu3, temperature in kelvins", ours["block_kelvins"], [value + 273.15 for value in theirs["temperature"]])
    equal("pythonfmu3, whole numbers", ours["steps"], theirs["steps"])


def test_spring():
    fmu = work / "Spring.fmu"
    tells(run("fmu", fmu), "Spring, FMI 2.0", "(this machine)", "force", "damped start true")
    steps = 400
    force = [1.0 if index % 200 < 100 else -0.5 for index in range(steps)]
    ports = {"force_newtons": "force", "position_metres": "position", "speed": "speed"}
    path = table("Spring", ports, "mass = 0.4\ndamped = false\nlabel = \"x\"")
    ours = play(path, steps, {"force_newtons": force})
    start = {"mass": 0.4, "damped": False}
    theirs = oracle(fmu, steps, 1e-3, {"force": force}, ["position", "speed"], start)
    equal("pythonfmu, position", ours["position_metres"], theirs["position"])
    equal("pythonfmu, speed", ours["speed"], theirs["speed"])
    # pythonfmu says of every discarded step that it wants no more.
    words = [path, "--steps", 1, "--step-milliseconds", 8.0]
    tells(run_alone(*words, code=1), "Spring.fmu: the FMU ended the simulation by itself at 0 s")


def test_awkward():
    fmu = work / "awkward.fmu"
    ports = {"u": "u", "y": "y", "count": "count", "valve": "valve"}
    tells(run("fmu", fmu), "it has events", "valve")
    steps = 100
    u = [1.0 + 0.01 * index for index in range(steps)]
    valve = [float(index >= 50) for index in range(steps)]

    def mode(number, code=0, step_milliseconds=1.0):
        path = table(f"awkward-{number}", ports, f"mode = {number}")
        if code:
            return run_alone(path, "--steps", steps, code=code)
        return play(path, steps, {"u": u, "valve": valve}, step_milliseconds)

    integral = [0.0]
    for value, is_open in zip(u, valve):
        integral.append(integral[-1] + (value + is_open) * 1e-3)
    equal("C, plain", mode(0)["y"], integral)
    equal("C, every step refused and halved", mode(1)["y"], integral)
    path = table("awkward-events", ports, "mode = 2\nu = 3.0")
    words = [path, "--steps", "100"]
    (work / "inputs.csv").write_text("u,valve\n3.0,0\n")
    lines = run_alone(*words, "--inputs", work / "inputs.csv").splitlines()
    names = lines[0].split(",")
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
    result = fmpy.simulate_fmu(
        str(fmu), validate=False, stop_time=0.1, output_interval=1e-3, start_values={"mode": 2, "u": 3.0}, output=["y", "count"],
        use_event_mode=True, early_return_allowed=True)
    theirs = {round(float(row["time"]), 9): row for row in result}
    for name in ["y", "count"]:
        place = names.index(name)
        pairs = [(row[place], float(theirs[round(row[0], 9)][name])) for row in rows if round(row[0], 9) in theirs]
        check(len(pairs) > 90, f"{len(pairs)} times in common")
        equal(f"C, events, {name}", [pair[0] for pair in pairs], [pair[1] for pair in pairs])
    check(rows[-1][names.index("count")] == 9.0, "nine events in 0.1 s")
    tells(mode(4, code=1), "awkward.fmu: the process that had it loaded was ended by signal 11", "while it stepped; only this run is lost")
    tells(mode(5, code=1), "awkward.fmu: variable `y` is NaN at 0.05", "the FMU computed it")
    tells(mode(6, code=1), "exited with code 3 while it stepped", "it said: no licence")
    tells(mode(7, code=1), "the FMU ended the simulation by itself at 0.05")
    tells(mode(8, code=1), "DoStep failed (error) at 0.05", "it said: the solver did not converge")
    tells(mode(9, code=3), "EnterInitializationMode failed (error); it said: the mode is one that refuses")
    tells(mode(3, code=1), "it did not return within 5s while it stepped; its process was ended")


RIG = """schema = 1
name = "{name}"
{plant}
[node.controller]
kind = "controller"
node_id = 1
[node.drive]
kind = "drive"
node_id = 16
amplifier = {{ port = "p.current_amperes", min = -1.0, max = 1.0 }}
sensor = {{ port = "p.{position}", unit = "{unit}", min = {min}, max = 100.0, resolution_bits = 16 }}
{node}
[loop.l]
feedback = "drive.position"
outputs = ["drive.current"]
"""
WORLDS = {"simulate": ["simulate"], "lock-step": ["run", "--clock", "lockstep", "--bus", "embedded"]}


def behind(name, plant, scenario, position, unit, low, node=""):
    """A rig with the plant behind a drive, and its scenario."""
    rig = RIG.format(name=name, plant=plant, position=position, unit=unit, min=low, node=node)
    (work / f"{name}-rig.toml").write_text(rig)
    path = work / f"{name}-scenario.toml"
    path.write_text(f"schema = 1\nrig = \"{name}-rig.toml\"\nname = \"{name}\"\n{scenario}")
    run("check", path)
    return path


def judged(path, world, *more, code=0):
    folder = Path(tempfile.mkdtemp(dir=work))
    told = run(*WORLDS[world], path, "--output", folder, *more, code=code)
    runs = list(folder.iterdir())
    check(len(runs) == 1, f"{len(runs)} runs")
    return told, runs[0]


def same(what, runs, files=("bus.log", "signals.csv", "verdict.json")):
    one, other = runs
    for file in files:
        check((one / file).read_bytes() == (other / file).read_bytes(), f"{what}: {file} is another one")


def test_heater_behind_a_drive():
    """The FMU of pythonfmu3 behind a drive: its temperature follows the current."""
    plant = """[plant.p.fmu]
file = "Heater.fmu"
[plant.p.fmu.start]
capacity = 4.0
[plant.p.fmu.ports]
current_amperes = { variable = "current" }
temperature_celsius = { variable = "temperature" }
block_celsius = { variable = "temperature", range = [0.0, 100.0] }
calls = { variable = "steps", range = [0, 30000] }"""
    scenario = """duration_seconds = 2.0
[[controller.open_loop.step]]
at_seconds = 0.0
current_amperes = 1.0
[[expect.signal]]
name = "block_celsius"
from_seconds = 1.9
stays = { min = 20.8, max = 20.95 }
[[expect.signal]]
name = "calls"
from_seconds = 1.9
stays = { min = 1900, max = 6000 }
"""
    path = behind("heater", plant, scenario, "temperature_celsius", "celsius", 0.0)
    runs = [judged(path, world)[1] for world in WORLDS]
    same("pythonfmu3 in one process and in several", runs)
    print("pythonfmu3 behind a drive: judged, the same bytes in one process and in several")


def test_awkward_behind_a_drive():
    plant = """[plant.p.fmu]
file = "awkward.fmu"
[plant.p.fmu.start]
mode = 0
[plant.p.fmu.ports]
current_amperes = { variable = "u" }
position_millimetres = { variable = "y", factor = 50.0 }
count = { variable = "count", range = [0, 30000] }"""
    scenario = """duration_seconds = 2.0
[controller.pid]
proportional_amperes_per_metre = 100.0
integral_amperes_per_metre_second = 0.0
set_point_weight = 1.0
derivative_ampere_seconds_per_metre = 0.0
[[reference.step]]
at_seconds = 0.2
position_millimetres = 20.0
[expect]
position_millimetres_max = { max = 21.0 }
[[expect.signal]]
name = "position_millimetres"
from_seconds = 1.9
stays = { min = 19.5, max = 20.5 }
"""
    path = behind("awkward", plant, scenario, "position_millimetres", "millimetres", -10.0)
    mode = lambda number: ["--set", f"plant.p.start.mode={number}"]
    plain = [judged(path, world, *mode(0))[1] for world in WORLDS]
    same("C in one process and in several", plain)
    discards = [judged(path, world, *mode(1))[1] for world in WORLDS]
    same("C that discards, in one process and in several", discards)
    # Each event takes half of what was integrated: the limits are missed, and that it had them is recorded.
    events = [judged(path, world, *mode(2), code=1)[1] for world in WORLDS]
    same("C with events, in one process and in several", events)
    rows = (events[0] / "signals.csv").read_text().splitlines()
    place = rows[0].split(",").index("count")
    check(float(rows[-1].split(",")[place]) > 100, f"too few events: {rows[-1]}")
    for number, words in {
        3: ["it did not return within 5s while it stepped"],
        4: ["was ended by signal 11", "only this run is lost"],
        5: ["variable `y` is NaN at 0.0", "the FMU computed it"],
        6: ["exited with code 3 while it stepped", "it said: no licence"],
        7: ["the FMU ended the simulation by itself at 0.0"],
        8: ["DoStep failed (error) at 0.0", "the solver did not converge"],
    }.items():
        for world in WORLDS:
            told, folder = judged(path, world, *mode(number), code=1)
            tells(told, "cannot go on", "awkward.fmu", *words)
            run("replay", folder, code=1)
    for world in WORLDS:
        told = run(*WORLDS[world], path, "--output", work / "refused", *mode(9), code=3)
        tells(told, "EnterInitializationMode failed (error); it said: the mode is one that refuses")
    print("C behind a drive: discards, events, hang, crash, NaN, exit, end and errors, in one process and in several")


def test_motor_behind_a_drive():
    """The motor as FMU beside the emulator's own, under the same limits."""
    examples = ROOT / "docs" / "examples"
    places = {name: work / name for name in ["of-fmu", "of-emulator"]}
    for place in places.values():
        place.mkdir()
        for name in ["motor_rig.toml", "motor_step.toml"]:
            shutil.copy(examples / name, place)
    shutil.copy(work / "dc_motor3.fmu", places["of-fmu"] / "motor.fmu")
    rig = places["of-emulator"] / "motor_rig.toml"
    text = rig.read_text()
    first, last = text.index("[plant.motor.fmu]"), text.index("[node.controller]")
    rig.write_text(f"{text[:first]}[plant.motor.dc_motor]\nload_kilograms = 0.2\n\n{text[last:]}")
    runs = {
        name: [judged(place / "motor_step.toml", world)[1] for world in WORLDS]
        for name, place in places.items()
    }
    same("the motor as FMU in one process and in several", runs["of-fmu"])
    fmu, own = (runs[name][0] for name in places)
    verdicts = [json.loads((folder / "verdict.json").read_text()) for folder in (fmu, own)]
    metrics = [{metric["name"]: metric for metric in verdict["metrics"]} for verdict in verdicts]
    check(metrics[0].keys() == metrics[1].keys(), "other metrics")
    apart = 0.0
    for name, metric in metrics[0].items():
        check(metric.get("passed") == metrics[1][name].get("passed"), f"{name}: another outcome")
        values = [metric.get("value"), metrics[1][name].get("value")]
        if all(isinstance(value, float) for value in values):
            apart = max(apart, abs(values[0] - values[1]))
    lines = [(folder / "bus.log").read_text().splitlines() for folder in (fmu, own)]
    check(len(lines[0]) == len(lines[1]), f"{len(lines[0])} and {len(lines[1])} frames")
    other = sum(one != two for one, two in zip(*lines))
    print(f"motor as FMU and the emulator's own: the same outcomes, metrics at most {apart:.1e} apart, {other} of {len(lines[0])} frames differ")


def test_refused():
    """An FMU that cannot be loaded is an error with its name, and exit code 3."""
    folder = work / "awkward"
    library = next(folder.glob("binaries/*/awkward.so"))
    ports = {"u": "u", "y": "y"}

    def packed(name, change):
        copy = work / f"copy-{name}"
        shutil.copytree(folder, copy)
        change(copy)
        shutil.make_archive(str(work / name), "zip", copy)
        (work / f"{name}.zip").rename(work / f"{name}.fmu")
        return run_alone(table(name, ports), "--steps", 1, code=3)

    def written(source):
        def change(copy):
            code = work / "code.c"
            code.write_text(source)
            target = copy / library.relative_to(folder)
            subprocess.run(["gcc", "-shared", "-fPIC", code, "-o", target], check=True)
        return change

    def elsewhere(copy):
        (copy / library.relative_to(folder)).parent.rename(copy / "binaries" / "riscv64-linux")

    def token(copy):
        xml = copy / "modelDescription.xml"
        xml.write_text(xml.read_text().replace("instantiationToken=\"awkward\"", "instantiationToken=\"x\""))

    tells(packed("elsewhere", elsewhere), "elsewhere.fmu: it has no library for this machine", "it has riscv64-linux")
    tells(packed("token", token), "fmi3InstantiateCoSimulation made no instance; it said: another FMU's token")
    tells(packed("empty", written("int x;")), "its library has no function `fmi3")
    tells(packed("needy", written("extern int cblas(void); int f(void) { return cblas(); }")), "cannot be loaded", "undefined symbol: cblas")
    tells(packed("text", lambda copy: (copy / library.relative_to(folder)).write_text("no library")), "cannot be loaded")
    path = table("awkward-typo", {"x": "yy"})
    tells(run_alone(path, code=3), "variable `yy` is not in the FMU")


STEPS = 2000
CURRENT = [0.8 if index % 1000 < 600 else -0.2 if index % 1000 < 800 else 0.3 for index in range(STEPS)]
OTHER_CURRENT = [0.5 if 700 <= index < 1500 else 0.0 for index in range(STEPS)]
DISTURBANCES = {
    "convection_factor": [1.0 if index < 1200 else 3.0 for index in range(STEPS)],
    "added_load_kilograms": [0.0 if index % 500 < 300 else 0.02 for index in range(STEPS)],
}
AXIS = {"current_amperes": CURRENT, **DISTURBANCES}
JOINT = {"flexor_current_amperes": list(map(abs, CURRENT)), "extensor_current_amperes": OTHER_CURRENT, **DISTURBANCES}
# Start values, inputs, and the comment of an input of each plant that ships.
OURS = {
    "sma": ({"heat.ambient_celsius": 25.0}, AXIS, "Current that the amplifier puts out."),
    "dc_motor": ({"load_kilograms": 0.3}, AXIS, "Current that the amplifier puts out."),
    "sma_pair": ({"pulley_radius_millimetres": 9.0}, JOINT, "Current through the extensor."),
}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("plant", OURS)
def test_a_plant_of_ours(plant, fmi):
    """Validated by FMPy, played by it as the emulator plays it, and imported again."""
    from fmpy.validation import validate_fmu

    start, inputs, comment = OURS[plant]
    fmu = work / f"{plant}{fmi}.fmu"
    run("fmu", "--export", plant, "--output", fmu, "--fmi", fmi, code=4)
    problems = validate_fmu(str(fmu))
    check(not problems, f"FMPy finds in {fmu.name}: {problems}")
    told = run("fmu", fmu)
    tells(told, "steps: of any length", "current_amperes A start 0", comment)
    check("note:" not in told, told)
    description = fmpy.read_model_description(fmu)
    outputs = [variable.name for variable in description.modelVariables if variable.causality == "output"]
    theirs = oracle(fmu, STEPS, 1e-3, inputs, outputs, start)
    ports = {name: name for name in [*inputs, *outputs]}
    text = "\n".join(f"\"{name}\" = {value}" for name, value in start.items())
    again = play(table(f"{plant}{fmi}", ports, text), STEPS, inputs)
    emulated = emulator(plant, start, inputs)
    for name in outputs:
        # The wire's kinetics that is exported by default remembers no turns, and so forgets none.
        moves = not name.endswith("turns_not_remembered")
        equal(f"{name}: FMPy and ours imported", again[name], theirs[name], moves=moves)
        equal(f"{name}: FMPy and the emulator", emulated[name], theirs[name], moves=moves)
    wrong = next(iter(start))
    text = f"\"{wrong}\" = 1e6"
    tells(run_alone(table(f"{plant}{fmi}-wrong", ports, text), code=3), f"variable `{wrong}` cannot start with 1000000")


def test_an_unknown_plant_is_not_exported():
    tells(run("fmu", "--export", "steam", code=2), "there is no plant `steam` to export; there are: sma, dc_motor, sma_pair")


@pytest.mark.parametrize("fmi", [2, 3])
def test_parameters_that_make_no_sense_are_refused_by_the_plant(fmi):
    ports = {"position_metres": "position_metres"}
    text = "rotor_inertia_kilogram_square_metres = 1e-12\ngear_inertia_kilogram_square_metres = 0.0\nspring_newtons_per_metre = 1e6"
    told = run_alone(table(f"dc_motor{fmi}-fast", ports, text), code=3)
    tells(told, "ExitInitializationMode failed (error); it said: motion changes at up to")


@pytest.mark.slow
def test_cost():
    """A step of 1 ms in the worker beside one of the emulator's own plant; printed, since machines differ."""
    for plant in ["sma", "dc_motor"]:
        outputs = {"position_metres": "position_metres"}
        path = table(f"{plant}3-cost", {"current_amperes": "current_amperes", **outputs})
        words = ["--steps", 20000, "--cost"]
        own = run_alone("--plant", plant, *words).strip()
        worker = run_alone(path, *words).strip()
        print(f"{plant}: {own} in the emulator, {worker} as an FMU in its worker")


def emulator(plant, start, inputs):
    """The same by the emulator's own code, without FMI."""
    changes = [word for name, value in start.items() for word in ["--start", f"{name}={value}"]]
    file = work / "inputs.csv"
    rows = [",".join(inputs)] + [",".join(map(repr, row)) for row in zip(*inputs.values())]
    file.write_text("\n".join(rows) + "\n")
    lines = run_alone("--plant", plant, *changes, "--inputs", file, "--steps", len(rows) - 1).splitlines()
    names = lines[0].split(",")
    columns = zip(*([float(cell) for cell in line.split(",")] for line in lines[1:]))
    return dict(zip(names, map(list, columns)))


def test_laws():
    """The controllers of pythonfmu and pythonfmu3 beside the same law as a program: no exporter adds a delay."""
    (work / "gain.py").write_text("""import canrig.law

@canrig.law.register
class Gain:
    def __init__(self, setup):
        self.gain = setup.parameters.gain

    def step(self, cycle, x):
        error = x.set_point_millimetres - x.position_millimetres
        return {"current_amperes": self.gain * error, "seen_millimetres": x.position_millimetres}
""")
    of_fmu = """reads = { y = "position_millimetres", r = "set_point_millimetres" }
writes = { u = "current_amperes" }
terms = { seen = "seen_millimetres" }
parameters = { gain = 0.06 }"""
    tables = {
        "program": """[controller.program]
command = ["python3", "gain.py"]
reads = ["position_millimetres", "set_point_millimetres"]
writes = ["current_amperes"]
terms = ["seen_millimetres"]
parameters = { gain = 0.06 }""",
        "pythonfmu": f"[controller.fmu]\nfile = \"Gain2.fmu\"\n{of_fmu}",
        "pythonfmu3": f"[controller.fmu]\nfile = \"Gain3.fmu\"\n{of_fmu}",
    }
    logs = {}
    for name, law in tables.items():
        path = work / f"law-{name}.toml"
        path.write_text(f"""schema = 1
rig = "dc_motor"
name = "a gain"
duration_seconds = 1.0
{law}
[[reference.step]]
at_seconds = 0.2
position_millimetres = 10.0
""")
        runs = [judged(path, world)[1] for world in WORLDS]
        same(f"{name} as a law in one process and in several", runs)
        logs[name] = (runs[0] / "bus.log").read_bytes()
    for name in ["pythonfmu", "pythonfmu3"]:
        check(logs[name] == logs["program"], f"{name}: another bus.log than that of the program")
    print("pythonfmu and pythonfmu3 as laws: the bytes of the same law as a program")
