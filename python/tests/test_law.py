"""Laws in Python: `canrig.law`."""

import canrig
import canrig.law
import pytest

LAW = """
import canrig.law

@canrig.law.register
class Proportional:
    def __init__(self, setup):
        self.gain = setup.parameters.gain

    def step(self, cycle, x):
        error = x.set_point_millimetres - x.position_millimetres
        return {RETURNED}

    def stop(self):
        print("stopped")
"""

SCENARIO = """
schema = 1
rig = "dc_motor"
name = "a law in Python"
duration_seconds = 1.0
[controller.program]
command = ["python3", "law.py"]
reads = ["position_millimetres", "set_point_millimetres"]
writes = ["current_amperes"]
terms = ["error_of_position"]
parameters = { gain = 0.05 }
[[reference.step]]
at_seconds = 0.2
position_millimetres = 10.0
"""

RIGHT = '{"current_amperes": self.gain * error, "error_of_position": error}'


@pytest.fixture
def law(tmp_path):
    def write(returned):
        (tmp_path / "law.py").write_text(LAW.replace("{RETURNED}", returned))
        scenario = tmp_path / "law.toml"
        scenario.write_text(SCENARIO)
        return scenario

    return write


def test_a_class_plays_and_its_parameters_are_set(law, output):
    scenario = law(RIGHT)
    run = canrig.simulate(scenario, output=output)
    assert run.outcome == "pass"
    assert (run.folder / "law.log").read_text() == "stopped\n"
    other = canrig.simulate(scenario, {"controller.program.parameters.gain": 0.1}, output=output)
    assert (run.folder / "bus.log").read_bytes() != (other.folder / "bus.log").read_bytes()


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero (law.py, line 11)"),
        ("x.speed", "there is no `speed`; known here: position_millimetres, set_point_millimetres"),
        ('{"current_amperes": 0.0}', "it lacks error_of_position"),
        ('{"current_amperes": 0.0, "error_of_position": 0.0, "b": 1.0}', "returned b, which is neither"),
        ("0.5", "step() is to return a dictionary with current_amperes, error_of_position, not float"),
    ],
)
def test_what_a_step_does_wrong_is_told(law, output, returned, said):
    run = canrig.simulate(law(returned), output=output)
    assert run.outcome == "fail"
    assert said in (run.folder / "verdict.json").read_text()


def test_a_class_can_be_tested_without_canrig(monkeypatch):
    monkeypatch.delenv("CANRIG_PORTS", raising=False)

    @canrig.law.register
    class Nothing:
        def step(self, cycle, x):
            return {"current_amperes": x.gain}

    assert Nothing().step(canrig.law.Cycle(), canrig.law.Names({"gain": 0.5})) == {"current_amperes": 0.5}
