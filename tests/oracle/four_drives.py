"""python-canopen as the manager of four of canrig's drives on one bus, each by the EDS that canrig writes for it."""

import contextlib
import logging
import pathlib
import subprocess
import tempfile

from bench import CONTROLLER, Heard, arguments, check, done, eventually, network, node_process
from manager import Drive, emergency, read_all

SCENARIO = pathlib.Path(__file__).with_suffix(".toml")
# Node-IDs and the cycles between two truths, as in four_drives_rig.toml.
DRIVES = {"a": (0x10, 1), "b": (0x12, 2), "c": (0x14, 5), "d": (0x1F, 10)}
# Of SYNC and commands, in seconds: as often as Python can on a busy machine, with four drives that answer.
PERIOD = 0.05
PERMILLE = {"a": 100, "b": 200, "c": 300, "d": 400}


def written_sheets(program, folder):
    """`canrig eds` writes one file for each node."""
    subprocess.run([program, "eds", str(SCENARIO), "--to", folder], check=True, stdout=subprocess.DEVNULL)
    found = {path.stem: path for path in pathlib.Path(folder).iterdir()}
    check(set(found) == {*DRIVES, "controller"}, "one EDS for each node", found)
    return found


def currents(drives):
    return {name: drive.sdo[0x6078].raw for name, drive in drives.items()}


def paces(bus, drives):
    """Each drive publishes the truth in as many cycles as its EDS says."""
    heard = {name: [Heard(bus, base + drive.id) for base in (0x180, 0x280)] for name, drive in drives.items()}
    eventually(lambda: all(len(position.frames) > 100 for position, _ in heard.values()), "100 cycles", 60)
    for name, (position, truth) in heard.items():
        _, every = DRIVES[name]
        positions, truths = len(position.frames), len(truth.frames)
        # A busy machine may delay some.
        wanted = positions / every
        check(abs(wanted - truths) <= 2 + wanted / 10, f"{name} publishes the truth in each {every}. cycle",
              f"{positions} positions, {truths} truths")


def lead(bus, drives):
    """BaseNode402 leads all four, each with a current of its own; one stops alone, and all when their manager dies."""
    for drive in drives.values():
        drive.nmt.wait_for_heartbeat(5)
        drive.setup_402_state_machine()
        drive.sdo[0x1016][1].raw = CONTROLLER << 16 | 2000
        drive.sdo[0x1006].raw = 1_000_000  # patience for a busy machine; the SYNCs come faster
    pulse = bus.send_periodic(0x700 + CONTROLLER, [0x05], 0.05)
    for drive in drives.values():
        drive.nmt.state = "OPERATIONAL"
    bus.sync.start(PERIOD)
    for name, drive in drives.items():
        drive.check_statusword(2.0)
        drive.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
        drive.rpdo[1][0x6071].raw = 0
        drive.rpdo[1].start(PERIOD)
        for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
            drive.state = state
            check(drive.state == state, f"{name}: the state ordered", drive.state)
    for name, drive in drives.items():
        drive.rpdo[1][0x6071].raw = PERMILLE[name]
    eventually(lambda: currents(drives) == PERMILLE, lambda: f"each drive has its own current: {currents(drives)}")
    paces(bus, drives)

    drives["b"].controlword = 0x0002  # quick stop
    eventually(lambda: currents(drives) == {**PERMILLE, "b": 0}, lambda: f"only b has stopped: {currents(drives)}")

    for drive in drives.values():
        drive.emcy.reset()
    pulse.stop()
    for name, drive in drives.items():
        emergency(drive, 0x8130)
        done(f"{name} misses its manager")
    nothing = dict.fromkeys(drives, 0)
    eventually(lambda: currents(drives) == nothing, lambda: f"no current is left: {currents(drives)}")
    bus.sync.stop()
    for drive in drives.values():
        drive.rpdo[1].stop()


def main():
    given = arguments(__doc__)
    logging.disable(logging.WARNING)
    with contextlib.ExitStack() as stack:
        sheets = written_sheets(given.program, stack.enter_context(tempfile.TemporaryDirectory()))
        bus = stack.enter_context(network(given.interface))
        drives = {name: bus.add_node(Drive(None, str(sheets[name]))) for name in DRIVES}
        for name, (node_id, every) in DRIVES.items():
            check(drives[name].id == node_id, f"the EDS of {name} has its node-ID", drives[name].id)
            pace = drives[name].object_dictionary[0x1801][2].default
            check(pace == every, f"the EDS of {name} has its pace", pace)
        boot_ups = {name: Heard(bus, 0x700 + drive.id) for name, drive in drives.items()}
        for name in DRIVES:
            plant = ["--plant", f"wire_{name}"]
            stack.enter_context(node_process(given.program, "plant-emulator", given.interface, SCENARIO, plant))
        for name, heard in boot_ups.items():
            eventually(lambda: heard.frames, f"{name} boots", 20)
        done("boot-up of four drives")
        for name, drive in drives.items():
            done(f"{name}: {read_all(drive)} objects read, each as in its EDS")
        lead(bus, drives)
        done(f"lead: {lead.__doc__.splitlines()[0]}")
    print("python-canopen as manager of four drives: all passed", flush=True)


if __name__ == "__main__":
    main()
