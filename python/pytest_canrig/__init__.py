"""canrig in pytest: scenarios as tests, and a fixture that plays them.

Without ``--canrig``, or ``canrig = true`` in the ini file, nothing is collected and nothing but this file is imported. The fixture
``canrig_run`` is there either way, and imports canrig when a test asks for it.
"""

import pytest

WORLDS = ("simulate", "lockstep", "run")


def pytest_addoption(parser):
    group = parser.getgroup("canrig", "scenarios of canrig as tests")
    group.addoption("--canrig", action="store_true", help="collect every scenario (*.toml) below the given paths")
    group.addoption(
        "--canrig-world",
        choices=WORLDS,
        help="where scenarios are played: simulate (one process, virtual time; the default), lockstep (processes, virtual time), "
        "run (processes in real time, one scenario at a time)",
    )
    group.addoption("--canrig-output", metavar="FOLDER", help="the folder for run folders; default: runs, below the root")
    parser.addini("canrig", "collect scenarios, as --canrig does", type="bool", default=False)
    parser.addini("canrig_world", "as --canrig-world", default="simulate")
    parser.addini("canrig_output", "as --canrig-output", default="runs")
    parser.addini("canrig_inconclusive", "what an inconclusive run is: fail or pass", default="fail")


def pytest_configure(config):
    config.addinivalue_line("markers", "canrig(world): play scenarios in this world: simulate, lockstep or run")
    if config.getoption("canrig") or config.getini("canrig"):
        from canrig import _pytest

        config.pluginmanager.register(_pytest.Collector(), "canrig-scenarios")


@pytest.fixture
def canrig_run(request):
    """Plays a scenario in the world of the test: ``canrig_run(scenario, values)`` returns a ``canrig.Run``.

    A relative path is looked for beside the test first. The run's requirements and folder become properties of the test's
    JUnit entry. The test itself asserts the result, for example ``assert run.passed, run.explain()``.
    """
    from canrig import _pytest

    return _pytest.player_of(request)
