"""python-can, python-canopen, can-isotp and udsoncan on canrig's bus: `canrig.can_interface` and `canrig.virtual`."""

import importlib.metadata
import os
import re
import subprocess
import sys
from pathlib import Path

import canrig
import pytest

# One environment of the pipeline has the libraries; outside of it they must be there.
if os.environ.get("CANRIG_TEST_LIBRARY", "lists") != "lists":
    pytest.skip("python-can is installed beside neither polars nor pandas", allow_module_level=True)

SCENARIO = """
schema = 1
rig = "{rig}"
name = "a node with python-can"
seed = 7
duration_seconds = {seconds}
[[reference.hold]]
at_seconds = 0.0
position_millimetres = 10.0
"""

ONE_PROGRAM = """
[node.controller]
program = ["python3", "controller.py"]
"""

TWO_PROGRAMS = """
schema = 1
name = "two programs"
[bus]
sync_period_milliseconds = 1.0
[node.controller]
kind = "controller"
node_id = 1
program = ["python3", "controller.py"]
[node.drive]
kind = "drive"
node_id = 16
program = ["python3", "drive.py"]
limits = { current_amperes = 1.0, min = -1.0, max = 45.0, rate_max = 600.0 }
[loop.position]
feedback = "drive.position"
outputs = ["drive.current"]
"""

# Leads the emulated drive with python-can alone; `does` is played at each position.
WITH_CAN = """
import struct
import can
import canrig.node

LOOP = canrig.node.part().loops[0]

def message(identifier, data=b"", **flags):
    return can.Message(arbitration_id=identifier, data=data, **{"is_extended_id": False, **flags})

def heard(bus, identifier):
    while True:
        seen = bus.recv(0.5)
        if seen is None or seen.arbitration_id == identifier:
            return seen

def bring_up(bus):
    bus.send_periodic(message(0x701, b"\\x05"), 0.02)
    bus.send(message(0x000, [130, 16]))
    while heard(bus, 0x710).data != b"\\0":
        pass
    for one in ["23161001e8030100", "23061000e8030000", "2f6060000a000000"]:
        bus.send(message(0x610, bytes.fromhex(one)))
        assert heard(bus, 0x590).data[0] == 0x60
    bus.send(message(0x000, [1, 0]))
    bus.send_periodic(message(0x080), 0.001)

def command(position):
    status, _ = struct.unpack_from("<Hi", position.data)
    word = {0x40: 6, 0x21: 7, 0x08: 0x80}.get(status & 0x6F, 15)
    return message(0x210, struct.pack("<Hh", word, 200 if status & 0x6F == 0x27 else 0))

FILTERS = [{"can_id": one, "can_mask": 0x7FF} for one in (0x190, 0x590, 0x710)]
"""

# The same with python-canopen.
WITH_CANOPEN = """
import canrig.virtual

import struct
import threading
import time

import canopen

network = canopen.Network().connect(interface="canrig")
drive = network.add_node(16, canopen.ObjectDictionary())
network.send_periodic(0x701, b"\\x05", 0.02)
is_up = threading.Event()
network.subscribe(0x710, lambda _id, data, _at: data == b"\\0" and is_up.set())
while not is_up.wait(0.5):
    drive.nmt.state = "RESET"

def on_position(_id, data, at):
    status, _ = struct.unpack_from("<Hi", data)
    word = {0x40: 6, 0x21: 7, 0x08: 0x80}.get(status & 0x6F, 15)
    network.send_message(0x210, struct.pack("<Hh", word, 200 if status & 0x6F == 0x27 else 0))

def lead():
    drive.sdo.download(0x1016, 1, struct.pack("<L", 0x0001_03E8))
    drive.sdo.download(0x1006, 0, struct.pack("<L", 1000))
    drive.sdo.download(0x6060, 0, b"\\x0A")
    drive.nmt.state = "OPERATIONAL"
    network.subscribe(0x190, on_position)
    network.sync.start(0.001)
    try:
        threading.Event().wait()
    finally:
        print("the end at", time.monotonic())
        network.disconnect()
"""

#: The same bus, for lines that are played on it.
LINES = WITH_CAN + "with can.Bus(interface='canrig') as bus:\n    "


@pytest.fixture
def play(tmp_path, output):
    """Plays a controller, and a drive if there is one; gives the run, and what they printed."""

    def played(controller, drive=None, seconds=0.2):
        (tmp_path / "controller.py").write_text(controller)
        scenario = tmp_path / "node.toml"
        if drive is None:
            scenario.write_text(SCENARIO.format(rig="dc_motor", seconds=seconds) + ONE_PROGRAM)
        else:
            (tmp_path / "drive.py").write_text(drive)
            (tmp_path / "rig.toml").write_text(TWO_PROGRAMS)
            scenario.write_text(SCENARIO.format(rig="rig.toml", seconds=seconds))
        run = canrig.simulate(scenario, output=output)
        printed = run.folder / "controller.log"
        return run, printed.read_text() if printed.exists() else ""

    return played


def test_the_wheel_registers_the_interface():
    registered = importlib.metadata.entry_points()
    registered = registered.select(group="can.interface") if hasattr(registered, "select") else registered["can.interface"]
    assert [point.value for point in registered if point.name == "canrig"] == ["canrig.can_interface:CanrigBus"]


def test_the_package_needs_no_library():
    said = subprocess.run([sys.executable, "-c", "import canrig, sys; print('can' in sys.modules)"], capture_output=True, check=True)
    assert said.stdout == b"False\n"


LEAD = """
with can.Bus(interface="canrig", can_filters=FILTERS) as bus:
    bring_up(bus)
    try:
        for seen in bus:
            if seen.arbitration_id == 0x190:
                bus.send(command(seen))
    finally:
        print("the end at", seen.timestamp)
        bus.send(message(0x210, bytes(4)))
"""


def test_a_program_with_python_can_leads_and_repeats_itself(play):
    first, said = play(WITH_CAN + LEAD)
    assert first.outcome == "pass", first.explain()
    logs = {(play(WITH_CAN + LEAD)[0].folder / "bus.log").read_bytes() for _ in range(20)}
    assert logs == {(first.folder / "bus.log").read_bytes()}
    assert b" 210#0F00C800" in min(logs)
    # The frame that it sent at the end still arrives.
    end = float(said.removeprefix("the end at "))
    last = [row for row in min(logs).decode().splitlines() if " 210#00000000" in row]
    assert len(last) == 1 and float(last[0][1:18]) == pytest.approx(end, abs=2e-3)


@pytest.mark.parametrize(
    ("does", "printed"),
    [
        ("bus.recv(0.3); print(bus.recv(0.3), bus.now_ns)", "None 600000000"),
        ("print(bus.recv(0), bus.recv(-1), bus.now_ns)", "None None 0"),
        ("task = bus.send_periodic(message(5), 0.01, duration=0.025); bus.recv(0.1); task.stop(); print(bus.now_ns)", "100000000"),
        ("print(bus.protocol.name, bus.state.name, bus)", "CAN_20 ACTIVE canrig lockstep:"),
        ("bus.shutdown(); bus.shutdown(); print('twice')", "twice"),
    ],
)
def test_time_is_that_of_the_bus(play, does, printed):
    # No frame of the run passes these filters.
    opened = WITH_CAN + "bus = can.Bus(interface='canrig', can_filters=[dict(can_id=0x7FF, can_mask=0x7FF)])\n"
    assert play(opened + does + "\n")[1].splitlines()[0].startswith(printed)


def test_filters_select_from_those_that_the_bus_was_opened_with(play):
    does = (
        "ask = message(0x610, bytes.fromhex('4000100000000000'))\n"
        "bus.set_filters([dict(can_id=0x123, can_mask=0x7FF)]); bus.send(ask); print(bus.filters, bus.recv(0.1))\n"
        "bus.filters = None; bus.send(ask); print(hex(heard(bus, 0x590).arbitration_id))\n"
    )
    opened = WITH_CAN + "bus = can.Bus(interface='canrig')\nbus.recv(0.1)\n"
    assert play(opened + does)[1].splitlines() == ["[{'can_id': 291, 'can_mask': 2047}] None", "0x590"]


def test_a_periodic_task_sends_changes_and_stops(play):
    run, _ = play(
        LINES
        + "task = bus.send_periodic([message(5, [1]), message(5, [2])], 0.01, duration=0.035, modifier_callback=lambda m: None)\n"
        + "    bus.recv(0); [bus.recv(0.1 / 3) for _ in range(6)]; task.modify_data([message(5, [3]), message(5, [4])]); task.start(); \n"
        + "    end = bus.now_ns + 50_000_000\n"
        + "    while bus.now_ns < end: bus.recv((end - bus.now_ns) / 1e9)\n"
    )
    sent = re.findall(r"\((\S+)\) can0 005#(\S\S)", (run.folder / "bus.log").read_text())
    assert [data for _, data in sent] == ["01", "02", "01", "02", "03", "04", "03", "04"]
    times = [float(at) for at, _ in sent]
    assert [round(after - before, 3) for before, after in zip(times, times[1:4])] == [0.01] * 3


@pytest.mark.parametrize(
    ("does", "sent"),
    [
        ("bus.send(message(0x12345678, [1], is_extended_id=True))", "12345678#01"),
        ("bus.send(message(0x123, is_remote_frame=True, dlc=4))", "123#R4"),
        ("bus.send(message(0x7FF))", "7FF#"),
    ],
)
def test_every_classic_frame_is_sent(play, does, sent):
    run, said = play(LINES + does + "; bus.recv(0.01)")
    print(said)
    assert f" {sent}\n" in (run.folder / "bus.log").read_text()


def test_every_classic_frame_is_received(play):
    drive = LINES + (
        "bus.send(message(0x12345678, [1, 2], is_extended_id=True))\n"
        "    bus.send(message(0x123, is_remote_frame=True, dlc=4))\n"
        "    bus.send(message(7))\n"
        "    bus.recv(0.1)\n"
    )
    controller = WITH_CAN + (
        "filters = [dict(can_id=0x12345678, can_mask=0x1FFFFFFF, extended=True), dict(can_id=0x123, can_mask=0x7FF)]\n"
        "with can.Bus(interface='canrig', can_filters=filters) as bus:\n"
        "    for _ in range(3):\n"
        "        seen = bus.recv(0.1)\n"
        "        print(seen and (hex(seen.arbitration_id), seen.is_extended_id, seen.is_remote_frame, seen.dlc, bytes(seen.data)))\n"
    )
    _, said = play(controller, drive)
    assert said.splitlines()[:3] == ["('0x12345678', True, False, 2, b'\\x01\\x02')", "('0x123', False, True, 4, b'')", "None"]


@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("bus.send(message(1, is_fd=True))", "CanOperationError: the bus has classic CAN, not CAN FD"),
        ("bus.send(message(0x800, is_extended_id=False))", "the identifier 0x800 does not fit 11 bits"),
        ("bus.send(message(1, is_error_frame=True))", "CanOperationError: an error frame cannot be sent"),
        ("[bus.send(message(1)) for _ in range(2000)]", "1024 frames wait to be sent"),
        ("bus.shutdown(); bus.send(message(1))", "CanOperationError: the bus is shut down"),
        ("bus.shutdown(); bus.recv()", "CanOperationError: the bus is shut down"),
        ("can.Bus(interface='canrig')", "a program has one bus in virtual time"),
        ("while True: bus.recv(0)", "does not move"),
        ("bus.send_periodic(message(1), 0)", "a period is at least 1 ns"),
        ("bus.fileno()", "NotImplementedError: there is no socket to wait for in virtual time"),
        ("raise ValueError('no gain')", "ValueError: no gain"),
        ("can.Notifier(bus, []); import time; time.sleep(0.1); bus.recv(0.1)", "make `import canrig.virtual` the first line"),
    ],
)
def test_what_cannot_be_is_named(play, does, said):
    run, printed = play(LINES + does)
    assert run.outcome == "fail"
    assert said in printed + (run.folder / "verdict.json").read_text()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("fd=True", "CanInitializationError: the bus has classic CAN, not CAN FD"),
        ("receive_own_messages=True", "a program does not receive its own messages"),
        ("bitrate=500000", "the bus has 1000000 bit/s, not 500000"),
        ("channel='lockstep:/nowhere'", "there is no bus at lockstep:/nowhere"),
        ("can_filters=[dict(can_id=1, can_mask=0x7FF)] * 600", "600 filters are too many: a bus has at most 512"),
        ("can_filters=[dict(can_id=0x190, can_mask=0x7FF)]).set_filters(None", "do not arrive: open the bus with them in can_filters"),
    ],
)
def test_a_bus_that_cannot_be_is_refused(play, arguments, said):
    run, printed = play(f"import can\ncan.Bus(interface='canrig', {arguments})\n")
    assert run.outcome == "fail"
    assert said in printed


@pytest.mark.parametrize(
    ("does", "reason"),
    [
        ("with bus: raise ValueError('no gain')", "gave up before the scenario began: ValueError: no gain"),
        ("raise ValueError('no gain')", "exited with code 1 before the scenario began; the end of its output"),
        ("bus.recv(0.1)", "exited with code 0 before the scenario began"),
    ],
)
def test_a_program_that_ends_early_is_named(play, does, reason):
    run, _ = play(f"import can\nbus = can.Bus(interface='canrig')\n{does}\n")
    assert run.outcome == "fail"
    assert reason in run.verdict.reason


@pytest.mark.parametrize(
    "program",
    [
        "import canrig.virtual\n" + WITH_CAN + """
class Listener(can.Listener):
    def on_message_received(self, message):
        if message.arbitration_id == 0x190:
            [][1]

with can.Bus(interface="canrig") as bus:
    bring_up(bus)
    can.Notifier(bus, [Listener()])
    canrig.virtual.time.sleep(1.0)
""",
        WITH_CANOPEN.replace("status, _ =", "[][1]; status, _ =") + "lead()\n",
    ],
    ids=["python-can", "canopen"],
)
def test_an_error_of_a_listener_ends_the_run_with_its_place(play, program):
    run, _ = play(program)
    assert run.outcome == "fail"
    assert "IndexError: list index out of range (controller.py, line" in run.verdict.reason


def test_error_frames_are_those_of_the_kernel():
    from canrig.can_interface import _message
    from canrig.node import Frame

    seen = _message(Frame(0.5, 0x20000004, bytes([0, 8, 0, 0, 0, 0, 96, 0])), 0.5)
    assert (seen.is_error_frame, seen.is_extended_id, seen.arbitration_id, seen.timestamp, seen.dlc) == (True, False, 4, 0.5, 8)


def test_frames_that_nobody_reads_are_dropped_with_a_word(play):
    program = WITH_CANOPEN.replace("import struct", "import struct\nimport canrig.can_interface", 1).replace(
        "network = ", "canrig.can_interface.INBOX_FRAMES_MAX = 5\nnetwork = ", 1
    )
    _, said = play(program + "drive.sdo.download(0x1017, 0, b'\\x01\\0'); network.notifier.stop(); time.sleep(0.1)\n")
    assert said.count("5 frames wait for recv(), and further ones are dropped: open the bus with can_filters") == 1


def test_a_notifier_stops_at_once_on_a_silent_bus(play):
    leads = WITH_CAN.replace("import struct", "import canrig.virtual\nimport struct\nimport time", 1) + (
        "bus = can.ThreadSafeBus(interface='canrig', can_filters=FILTERS)\n"
        "bring_up(bus)\n"
        "notifier = can.Notifier(bus, [lambda seen: seen.arbitration_id == 0x190 and bus.send(command(seen))])\n"
        "try:\n    time.sleep(60)\n"
        "finally:\n"
        "    bus.stop_all_periodic_tasks()\n    time.sleep(0.1)\n    before = time.monotonic_ns()\n    notifier.stop()\n"
        "    print(time.monotonic_ns() - before)\n    bus.shutdown()\n"
    )
    run, said = play(leads)
    assert (run.outcome, said) == ("pass", "0\n")


def test_a_bus_needs_an_address():
    environment = {name: value for name, value in os.environ.items() if name != "CANRIG_BUS"}
    program = "import canrig.virtual, can; can.Bus(interface='canrig')"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, env=environment, check=False)
    assert b"CanInitializationError: no bus is named: canrig starts this program" in ended.stderr


def test_canopen_plays_in_virtual_time(play):
    program = WITH_CANOPEN + (
        "begun = time.monotonic_ns()\n"
        "for _ in range(2000): assert drive.sdo.upload(0x1000, 0)\n"
        "print('2000 uploads in', time.monotonic_ns() - begun)\n"
        "absent = network.add_node(99, canopen.ObjectDictionary())\n"
        "absent.sdo.RESPONSE_TIMEOUT = 0.3\n"
        "begun = time.monotonic_ns()\n"
        "try: absent.sdo.upload(0x1000, 0)\n"
        "except canopen.SdoCommunicationError as error: print(error, time.monotonic_ns() - begun)\n"
        "try: drive.sdo.upload(0x7777, 0)\n"
        "except canopen.SdoAbortedError as error: print(error)\n"
        "begun = time.monotonic_ns()\n"
        "try: absent.nmt.wait_for_heartbeat(0.25)\n"
        "except canopen.nmt.NmtError as error: print(error, time.monotonic_ns() - begun)\n"
        "drive.sdo.download(0x1017, 0, struct.pack('<H', 20))\n"
        "drive.nmt.wait_for_heartbeat(0.5); begun = time.monotonic_ns()\n"
        "print(drive.nmt.wait_for_heartbeat(0.5), round((time.monotonic_ns() - begun) / 1e6))\n"
        "lead()\n"
    )
    plays = [play(program, seconds=0.1) for _ in range(2)]
    run, said = plays[0]
    assert run.outcome == "pass", run.explain() + said
    lines = said.splitlines()
    uploads = int(lines[0].removeprefix("2000 uploads in "))
    # A request of 117 to 135 bits and its answer, 2 000 times at 1 Mbit/s.
    assert 2000 * 2 * 110_000 < uploads < 2000 * 2 * 140_000
    assert lines[1:5] == [
        "Transfer aborted by client with code 0x05040000",
        "No SDO response received 300000000",
        "Code 0x06020000, Object does not exist",
        "No boot-up or heartbeat received 250000000",
    ]
    assert lines[5] == "PRE-OPERATIONAL 20"
    assert lines[6].startswith("the end at ")
    assert plays[1][1] == said
    assert len({(run.folder / "bus.log").read_bytes() for run, _ in plays}) == 1


def test_canopen_leaves_the_same_bytes_in_twenty_runs(play):
    program = WITH_CANOPEN + ("lead()\n")
    plays = [play(program, seconds=0.05) for _ in range(20)]
    assert {run.outcome for run, _ in plays} == {"pass"}, plays[0][1]
    assert len({(run.folder / "bus.log").read_bytes() for run, _ in plays}) == 1


def test_process_data_arrive_by_their_objects(play, tmp_path):
    subprocess.run([canrig.program(), "eds", f"--to={tmp_path / 'eds'}", "motor_step"], check=True, stdout=subprocess.DEVNULL)
    program = WITH_CANOPEN.replace("canopen.ObjectDictionary()", f"{str(tmp_path / 'eds' / 'drive.eds')!r}") + (
        "drive.tpdo.read(); drive.nmt.state = 'OPERATIONAL'\n"
        "try: drive.tpdo[1].wait_for_reception(0.2)\n"
        "finally: print(drive.tpdo[1].timestamp, time.monotonic_ns() % 1000)\n"
        "network.sync.start(0.001); begun = time.monotonic()\n"
        "at = drive.tpdo[1].wait_for_reception(0.2)\n"
        "print(begun < at < begun + 0.0005, [variable.name for variable in drive.tpdo[1]], hex(drive.tpdo[1][0].raw & 0x4F))\n"
        "drive.nmt.state = 'PRE-OPERATIONAL'; network.sync.stop(); lead()\n"
    )
    plays = [play(program) for _ in range(2)]
    run, said = plays[0]
    assert run.outcome == "pass", run.explain() + said
    lines = said.splitlines()
    assert lines[0] == "None 0"
    assert lines[1] == "True ['Statusword', 'Position actual value', 'Current actual value'] 0x40"
    assert plays[1][1] == said


SERVER = """
import canrig.virtual
import time
import canopen
from canopen import objectdictionary

objects = objectdictionary.ObjectDictionary()
for index, kind, value in ((0x2000, objectdictionary.UNSIGNED32, 77), (0x1017, objectdictionary.UNSIGNED16, 10)):
    variable = objectdictionary.ODVariable(hex(index), index)
    variable.data_type, variable.default = kind, value
    objects.add_object(variable)
network = canopen.Network().connect(interface="canrig")
network.create_node(16, objects).nmt.start_heartbeat(10)
while True:
    time.sleep(1.0)
"""


def test_a_local_node_serves(play):
    client = (
        "import canrig.virtual\nimport time\nimport canopen\n"
        "network = canopen.Network().connect(interface='canrig')\n"
        "node = network.add_node(16, canopen.ObjectDictionary())\n"
        "node.nmt.wait_for_heartbeat(1.0); begun = time.monotonic_ns(); node.nmt.wait_for_heartbeat(1.0)\n"
        "print(time.monotonic_ns() - begun)\n"
        "before = node.sdo.upload(0x2000, 0); node.sdo.download(0x2000, 0, bytes([5, 0, 0, 0]))\n"
        "print(before[0], node.sdo.upload(0x2000, 0)[0])\n"
        "network.scanner.search(); time.sleep(0.1); print(network.scanner.nodes); network.disconnect()\n"
    )
    assert play(client, SERVER)[1] == "10000000\n77 5\n[16]\n"


UDS_SERVER = """
import canrig.virtual
import can
import isotp
bus = can.Bus(interface="canrig")
stack = isotp.CanStack(bus, address=isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E8, rxid=0x7E0), params={"stmin": 1})
stack.start()
while True:
    request = stack.recv(block=True, timeout=1.0)
    if request == bytes.fromhex("22f190"):
        stack.send(bytes.fromhex("62f190") + b"WVWZZZ1JZ3W386752")
    elif request and request[0] == 0x10:
        stack.send(bytes([0x50, request[1], 0, 50, 1, 244]))
    elif request and request[0] == 0x22:
        stack.send(bytes([0x7F, 0x22, 0x31]))
"""

UDS_CLIENT = """
import canrig.virtual
import time
import can
import isotp
import udsoncan
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection

bus = can.Bus(interface="canrig")
address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E0, rxid=0x7E8)
{stack}
config = dict(udsoncan.configs.default_client_config, data_identifiers={{0xF190: udsoncan.AsciiCodec(17), 0x1234: "H"}})
config["p2_timeout"], config["use_server_timing"] = 0.3, False
with Client(PythonIsoTpConnection(stack), config=config) as client:
    begun = time.monotonic_ns()
    print({{client.read_data_by_identifier_first(0xF190) for _ in range(20)}}, time.monotonic_ns() - begun)
    print(client.change_session(3).service_data.session_echo)
    begun = time.monotonic_ns()
    try:
        client.tester_present()
    except udsoncan.exceptions.TimeoutException:
        print("a time-out", time.monotonic_ns() - begun)
    try:
        client.read_data_by_identifier(0x1234)
    except udsoncan.exceptions.NegativeResponseException as error:
        print(error.response.code_name)
print("done")
bus.shutdown()
"""


@pytest.mark.parametrize(
    "stack",
    [
        "stack = isotp.CanStack(bus, address=address)",
        "stack = isotp.NotifierBasedCanStack(bus, can.Notifier(bus, []), address=address)",
        # The layer without threads, which udsoncan calls in one of its own.
        "tools = isotp.CanStack(bus, address=address)\nstack = isotp.TransportLayerLogic(tools._rx_canbus, tools.txfn, address=address)",
    ],
    ids=["CanStack", "NotifierBasedCanStack", "TransportLayerLogic"],
)
def test_isotp_and_udsoncan_play_in_virtual_time(play, stack):
    plays = [play(UDS_CLIENT.format(stack=stack), UDS_SERVER) for _ in range(2)]
    lines = plays[0][1].splitlines()
    assert lines[0].startswith("{'WVWZZZ1JZ3W386752'} ")
    assert lines[1] == "3"
    said = [line for line in lines if line.startswith("a time-out ")]
    assert said == ["a time-out 300000000"]
    assert lines[-2:] == ["RequestOutOfRange", "done"]
    assert plays[1][1] == plays[0][1]
    assert len({(run.folder / "bus.log").read_bytes() for run, _ in plays}) == 1


def test_isotp_plays_without_its_threads(play):
    client = (
        "import canrig.virtual\nimport time\nimport can\nimport isotp\n"
        "bus = can.Bus(interface='canrig')\n"
        "stack = isotp.CanStack(bus, address=isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E0, rxid=0x7E8))\n"
        "stack.send(bytes.fromhex('22f190'))\n"
        "while not stack.available():\n    stack.process()\n    time.sleep(stack.sleep_time())\n"
        "print(stack.recv().hex())\n"
    )
    _, said = play(client, UDS_SERVER)
    assert said.splitlines()[0].startswith("62f1905756575a")


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("import threading\nthreading.Thread(target=print, name='mine').start()", "the thread `mine` of builtins.print is refused"),
        ("import threading\nthreading.Timer(1, print).start()", "of threading.Timer.run is refused"),
        ("from concurrent.futures import ThreadPoolExecutor\nThreadPoolExecutor().submit(print)", "the thread `ThreadPoolExecutor-0_0`"),
        ("import asyncio\nasyncio.run(asyncio.sleep(1))", "an asyncio loop is refused"),
        ("import time\ntime.sleep(1)", "no bus is open yet"),
        ("import threading\nthreading.Event().wait()", "no bus is open yet"),
        (
            "import can, queue\nbus = can.Bus(interface='canrig')\nbus.shutdown()\nqueue.Queue().get()",
            "waits without a time-out, and its bus is shut down",
        ),
        ("import can, time\nbus = can.Bus(interface='canrig')\ntime.sleep(-1)", "sleep length must be non-negative"),
        (
            "import can, _thread, time\nbus = can.Bus(interface='canrig')\n_thread.start_new_thread(bus.recv, ())\ntime.sleep(20)",
            "cannot use the bus",
        ),
    ],
)
def test_what_would_not_repeat_itself_is_refused(play, program, said):
    run, printed = play(f"import canrig.virtual\n{program}\n")
    assert run.outcome == "fail"
    assert said in printed


def test_a_late_import_is_refused(play):
    for early in ("can", "canopen"):
        run, said = play(f"import {early}\nimport canrig.virtual\n")
        assert run.outcome == "fail"
        assert "comes too late: it must stand before the import of can" in said


@pytest.mark.parametrize(
    ("loop", "took"),
    [
        ("while time.monotonic() < end: pass", 50_001_000),
        ("while time.time() <= end: bus.recv(end - time.time())", 50_001_000),
        ("while time.perf_counter() < end: bus.recv(0)", 50_001_000),
    ],
)
def test_a_loop_that_looks_at_a_clock_ends(play, loop, took):
    opened = "bus = can.Bus(interface='canrig', can_filters=[dict(can_id=0x7FF, can_mask=0x7FF)])\n"
    _, said = play(f"import canrig.virtual\nimport can, time\n{opened}end = time.time() + 0.05\n{loop}\nprint(bus.now_ns)\n")
    assert abs(int(said) - took) <= 2000


def test_a_long_transfer_keeps_the_separation_time(play):
    """A consecutive frame is sent when more than the separation time has passed, and the layer looks at the clock until then."""
    client = UDS_CLIENT[: UDS_CLIENT.index("config =")].format(
        stack="stack = isotp.CanStack(bus, address=address, params={'blocking_send': True})"
    )
    client += (
        "stack.start(); begun = time.monotonic_ns()\n"
        "stack.send(bytes(1000), send_timeout=5); print((time.monotonic_ns() - begun) // 1_000_000)\n"
        "print(len(stack.recv(block=True, timeout=1.0))); stack.stop(); bus.shutdown()\n"
    )
    server = UDS_SERVER[: UDS_SERVER.index("while True:")] + "stack.send(stack.recv(block=True, timeout=5.0))\nstack.recv(block=True)\n"
    plays = [play(client, server) for _ in range(2)]
    assert plays[0][1] == plays[1][1]
    took, received = map(int, plays[0][1].split())
    # 142 consecutive frames, 1 ms and some microseconds apart.
    assert 142 <= took <= 150 and received == 1000


def test_waits_without_a_bus_end_when_it_is_shut_down(play):
    _, said = play(
        "import canrig.virtual\nimport can, queue, time\nbus = can.Bus(interface='canrig')\nbus.shutdown()\n"
        "begun = time.monotonic_ns(); time.sleep(0.25)\n"
        "try: queue.Queue().get(timeout=0.5)\n"
        "except queue.Empty: print(time.monotonic_ns() - begun)\n"
    )
    assert said == "750000000\n"


def test_waits_of_every_kind_are_exact(play):
    waits = (
        "sleep, lock, condition, semaphore = lambda: time.sleep(0.3), threading.Lock(), threading.Condition(), threading.Semaphore(0)\n"
        "fifo, simple, reader = queue.Queue(), queue.SimpleQueue(), can.BufferedReader()\n"
        "lock.acquire(); condition.acquire()\n"
        "def quietly(wait):\n"
        "    def waits():\n"
        "        try: wait()\n"
        "        except queue.Empty: pass\n"
        "    return waits\n"
        "took = set()\n"
        "for number in range(200):\n"
        "    for wait in (sleep, lambda: lock.acquire(timeout=0.3), lambda: condition.wait(0.3), lambda: condition.wait_for(bool, 0.3),\n"
        "                 lambda: semaphore.acquire(timeout=0.3), lambda: fifo.get(timeout=0.3), lambda: simple.get(timeout=0.3),\n"
        "                 lambda: reader.get_message(0.3), lambda: threading.Event().wait(0.3)):\n"
        "        begun = time.monotonic_ns(); quietly(wait)(); took.add(time.monotonic_ns() - begun)\n"
        "    time.sleep(0.000123457)\n"
        "print(took)\n"
    )
    # Behind the bus, so that 540 s of time cost nothing.
    opened = "can.Bus(interface='canrig').shutdown()\n"
    _, said = play("import canrig.virtual\nimport can, queue, threading, time\n" + opened + waits)
    assert said == "{300000000}\n"


def test_in_real_time_nothing_changes(monkeypatch):
    monkeypatch.setenv("CANRIG_BUS", "vcan0")
    program = "import time, threading, queue; before = time.sleep, threading.Lock, queue.SimpleQueue; import canrig.virtual; "
    program += "assert before == (time.sleep, threading.Lock, queue.SimpleQueue); threading.Thread(target=print, args=('heard',)).start()"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, check=True).stdout == b"heard\n"


@pytest.mark.parametrize("program", [WITH_CAN + LEAD, WITH_CANOPEN + "lead()\n"], ids=["python-can", "canopen"])
def test_the_same_source_plays_in_real_time(tmp_path, output, program):
    (tmp_path / "controller.py").write_text(program)
    scenario = tmp_path / "node.toml"
    scenario.write_text(SCENARIO.format(rig="dc_motor", seconds=0.5) + ONE_PROGRAM)
    run = canrig.run(scenario, bus="embedded", output=output)
    # A busy machine misses cycles; the program is told of the end all the same.
    assert "the end at " in (run.folder / "controller.log").read_text(), run.explain()
    assert " 210#0F00C800" in (run.folder / "bus.log").read_text()


def blocks(info):
    """Blocks of code on the page of the book."""
    book = os.environ.get("CANRIG_TEST_BOOK")
    page = Path(book) if book else Path(__file__).resolve().parents[2] / "docs"
    found = re.findall(rf"^```{info}\n(.*?)^```$", (page / "python-can.md").read_text(), re.MULTILINE | re.DOTALL)
    assert found
    return found


def test_the_controller_of_the_book_passes(tmp_path, output):
    (program,) = blocks("python")
    (tmp_path / "controller.py").write_text(program)
    command = [canrig.program(), "simulate", "--twice", "--quiet", f"--output={output}", "motor_step", "--", "python3", "controller.py"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_the_loop_and_the_diagnostics_of_the_book_play(play):
    loop, _, client = blocks("python,fragment")
    run, said = play(WITH_CAN + "without_current = message(0x210, bytes(4))\n" + loop)
    assert run.outcome == "pass", run.explain() + said
    assert " 210#00000000\n" in (run.folder / "bus.log").read_text()
    assert play(client, UDS_SERVER)[1] == "WVWZZZ1JZ3W386752\n"
