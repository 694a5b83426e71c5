"""What no single scenario can say. `pytest --canrig scenarios/` plays each scenario as a test, too."""

import pytest


@pytest.mark.parametrize("millimetres", [20.0, 30.0, 40.0])
def test_each_step_settles(canrig_run, millimetres):
    run = canrig_run("step.toml", {"reference.step[0].position_millimetres": millimetres})
    assert run.passed, run.explain()
    position = run.signals("lists")["position_millimetres"]
    assert position[-1] == pytest.approx(millimetres, abs=0.05)
