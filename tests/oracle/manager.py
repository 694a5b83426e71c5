"""python-canopen as the manager of canrig's drive and disturbance module, on a real CAN interface."""

import logging
import statistics
import struct
import time

import canopen
from canopen.objectdictionary import ODVariable
from canopen.profiles.p402 import BaseNode402

from bench import (CONTROLLER, DISTURBANCE, DISTURBANCE_EDS, DRIVE, DRIVE_EDS, Heard, aborts_with, arguments, check,
                   done, eventually, network, node_process, restart)

# Abort codes (CiA 301, table 22).
READ_ONLY, NO_OBJECT, NO_SUB_INDEX = 0x06010002, 0x06020000, 0x06090011
TOO_LONG, TOO_SHORT, TOO_HIGH, TOO_LOW = 0x06070012, 0x06070013, 0x06090031, 0x06090032
NOT_MAPPABLE, PDO_TOO_LONG, INVALID_VALUE = 0x06040041, 0x06040042, 0x06090030
UNSUPPORTED_ACCESS, DEVICE_STATE, NO_DATA = 0x06010000, 0x08000022, 0x08000024

# Measured or state: their values are not the defaults.
LIVE = {0x2101, 0x2102, 0x2103, 0x6041, 0x6064, 0x6077, 0x6078}
# Written with another value than the default; everything else is written with its default.
WRITTEN = {
    (0x1006, 0): 10000, (0x1007, 0): 5000, (0x1015, 0): 10, (0x1017, 0): 25, (0x1019, 0): 10, (0x1029, 1): 1,
    (0x6007, 0): 2, (0x605E, 0): 0, (0x6071, 0): 500, (0x6072, 0): 700, (0x6073, 0): 800, (0x60C2, 1): 2,
    (0x6060, 0): 10, (0x6411, 1): 2500, (0x6411, 2): -300, (0x6443, 1): 0, (0x6444, 1): 1200, (0x6444, 2): -5,
}
RPDO_PARAMETERS, TPDO_PARAMETERS = range(0x1400, 0x1600), range(0x1800, 0x1A00)
MAPPINGS = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))


def variables(node):
    """Every value of the EDS."""
    for entry in node.object_dictionary.values():
        if isinstance(entry, ODVariable):
            yield entry
        else:
            yield from entry.values()


def is_pdo(index):
    return index in RPDO_PARAMETERS or index in TPDO_PARAMETERS or any(index in mapping for mapping in MAPPINGS)


def read_all(node):
    """Every object has the value that the EDS promises after power-on."""
    count = 0
    for variable in variables(node):
        place = f"0x{variable.index:04X}:{variable.subindex:02X} {variable.name}"
        upload = lambda: node.sdo.upload(variable.index, variable.subindex)  # noqa: E731
        if variable.index == 0x1003 and variable.subindex > 0:
            aborts_with(NO_DATA, upload, place)
        else:
            found = upload()
            if variable.index not in LIVE:
                check(found == variable.encode_raw(variable.default), f"{place} holds its default", found.hex())
            elif variable.data_type in canopen.objectdictionary.NUMBER_TYPES:
                check(8 * len(found) == len(variable), f"{place} has its length", found.hex())
        count += 1
    return count


def write_all(node):
    """Every object that may be written takes a value and gives it back; every other one refuses."""
    taken = refused = 0
    for variable in variables(node):
        index, sub_index = variable.index, variable.subindex
        place = f"0x{index:04X}:{sub_index:02X} {variable.name}"
        value = WRITTEN.get((index, sub_index), variable.default)
        if not variable.writable:
            data = variable.encode_raw(variable.default)
            aborts_with(READ_ONLY, lambda: node.sdo.download(index, sub_index, data), place)
            refused += 1
            continue
        if is_pdo(index):
            continue  # in write_pdos, by the standard's procedure
        if index == 0x1019:  # writable only without a SYNC period
            node.sdo.download(0x1006, 0, bytes(4))
        data = variable.encode_raw(value)
        if index == 0x6040:  # the statusword says "not remote" in Pre-operational
            aborts_with(DEVICE_STATE, lambda: node.sdo.download(index, sub_index, data), place)
            refused += 1
            continue
        node.sdo.download(index, sub_index, data)
        check(node.sdo.upload(index, sub_index) == data, f"{place} took {value}")
        taken += 1
    taken += write_pdos(node)
    return taken, refused


def write_pdos(node):
    count = 0
    for index in node.object_dictionary:
        if index not in RPDO_PARAMETERS and index not in TPDO_PARAMETERS:
            continue
        parameters, mapping = node.object_dictionary[index], node.object_dictionary[index + 0x200]
        cob_id = parameters[1].default
        node.sdo.download(index, 1, struct.pack("<L", cob_id | 1 << 31))
        for sub_index in [sub_index for sub_index in parameters if sub_index > 1]:
            data = parameters[sub_index].encode_raw({2: 255, 3: 20, 5: 0}.get(sub_index, 7))
            node.sdo.download(index, sub_index, data)
            check(node.sdo.upload(index, sub_index) == data, f"0x{index:04X}:{sub_index:02X}")
            count += 1
        node.sdo.download(index + 0x200, 0, b"\0")
        objects = [mapping[sub_index] for sub_index in mapping if sub_index > 0]
        for variable in objects:
            data = variable.encode_raw(objects[0].default)
            node.sdo.download(variable.index, variable.subindex, data)
            check(node.sdo.upload(variable.index, variable.subindex) == data, f"0x{variable.index:04X}")
            count += 1
        node.sdo.download(index + 0x200, 0, b"\1")
        node.sdo.download(index, 1, struct.pack("<L", cob_id))
        count += 2
    return count


def refusals(bus, drive):
    """Each rule of the dictionary has its abort code."""
    download, upload = drive.sdo.download, drive.sdo.upload
    aborts_with(NO_OBJECT, lambda: upload(0x2FFF, 0), "an object that does not exist")
    aborts_with(NO_SUB_INDEX, lambda: upload(0x1018, 9), "a sub-index that does not exist")
    aborts_with(TOO_LONG, lambda: download(0x1017, 0, bytes(4)), "four bytes for two")
    aborts_with(TOO_SHORT, lambda: download(0x1017, 0, bytes(1)), "one byte for two")
    aborts_with(TOO_HIGH, lambda: download(0x1029, 1, b"\3"), "above the EDS's high limit")
    aborts_with(TOO_LOW, lambda: download(0x60C2, 1, b"\0"), "below the EDS's low limit")
    aborts_with(INVALID_VALUE, lambda: download(0x1019, 0, b"\1"), "SYNC counter overflow 1")
    for mode in (1, 8):  # profile position, cyclic synchronous position
        aborts_with(INVALID_VALUE, lambda: download(0x6060, 0, bytes([mode])), f"mode {mode}, which is not supported")
    download(0x1006, 0, struct.pack("<L", 10000))
    aborts_with(DEVICE_STATE, lambda: download(0x1019, 0, b"\x0A"), "0x1019 while 0x1006 is not 0")
    download(0x1006, 0, bytes(4))
    aborts_with(UNSUPPORTED_ACCESS, lambda: download(0x1A00, 1, struct.pack("<L", 0x60410010)), "mapping of a valid PDO")
    download(0x1800, 1, struct.pack("<L", 0xC0000190))
    aborts_with(UNSUPPORTED_ACCESS, lambda: download(0x1A00, 1, struct.pack("<L", 0x60410010)), "mapping with sub 0 > 0")
    download(0x1A00, 0, b"\0")
    aborts_with(NOT_MAPPABLE, lambda: download(0x1A00, 1, struct.pack("<L", 0x10080020)), "an object not mappable")
    aborts_with(PDO_TOO_LONG, lambda: download(0x1A00, 0, b"\x09"), "nine objects")
    for sub_index in (1, 2, 3):
        download(0x1A00, sub_index, struct.pack("<L", 0x60640020))
    aborts_with(PDO_TOO_LONG, lambda: download(0x1A00, 0, b"\3"), "96 bits")
    aborts_with(INVALID_VALUE, lambda: download(0x1800, 2, b"\xF5"), "transmission type 245")
    restart(bus, drive, "RESET COMMUNICATION")


def block_transfers(drive):
    """Block and segmented transfers both ways give the same as expedited ones."""
    name = b"SMA wire drive"
    check(drive.sdo.upload(0x1008, 0) == name, "segmented upload")
    with drive.sdo.open(0x1008, 0, "rb", block_transfer=True) as stream:
        found = stream.read()
    check(found == name, "block upload", found)
    data = struct.pack("<L", 0x00020123)
    with drive.sdo.open(0x1016, 2, "wb", size=4, block_transfer=True) as stream:
        stream.write(data)
    check(drive.sdo.upload(0x1016, 2) == data, "block download")
    with drive.sdo.open(0x1016, 2, "wb", size=4, force_segment=True) as stream:
        stream.write(bytes(4))
    check(drive.sdo.upload(0x1016, 2) == bytes(4), "segmented download")


def second_channel(bus, drive):
    """The second server channel answers while the first one is in the middle of a transfer."""
    tools = canopen.sdo.SdoClient(0x690, 0x6D0, drive.object_dictionary)
    tools.network = bus
    bus.subscribe(0x6D0, tools.on_response)
    with drive.sdo.open(0x1008, 0, "rb", buffering=0) as stream:
        first = stream.read(7)
        check(tools.upload(0x1000, 0) == struct.pack("<L", 0x00020192), "upload on the second channel")
        check(first + stream.read(7) == b"SMA wire drive", "the transfer on the first channel goes on")
    bus.unsubscribe(0x6D0)


def remap(bus, drive):
    """TPDO1 gets other objects by the standard's procedure; its frames follow."""
    drive.tpdo.read()
    drive.rpdo.read()
    tpdo = drive.tpdo[1]
    check([variable.index for variable in tpdo] == [0x6041, 0x6064, 0x6078], "default mapping of TPDO1")
    tpdo.clear()
    tpdo.add_variable(0x6061)
    tpdo.add_variable(0x2102)
    tpdo.trans_type = 2
    tpdo.save()
    drive.sdo[0x6060].raw = 10
    frames = Heard(bus, 0x190)
    drive.nmt.state = "OPERATIONAL"
    for _ in range(4):
        bus.sync.transmit()
        time.sleep(0.02)
    eventually(lambda: len(frames.frames) == 2, "type 2 sends on every second SYNC")
    check(all(len(data) == 3 for _, data in frames.frames), "the length is the mapping's", frames.frames)
    check(tpdo[0x6061].raw == 10, "mode of operation in TPDO1")
    check(tpdo[0x2102].raw > 40000, "a cold wire is martensite", tpdo[0x2102].raw)
    restart(bus, drive, "RESET COMMUNICATION")
    drive.tpdo.read()
    check([variable.index for variable in drive.tpdo[1]] == [0x6041, 0x6064, 0x6078], "reset restores the mapping")


def heartbeat(bus, drive):
    """The producer time is re-armed by the write."""
    heard = Heard(bus, 0x710)
    for milliseconds, frames in ((200, 8), (10, 60)):
        drive.sdo[0x1017].raw = milliseconds
        # A busy machine may delay any of them, but not each.
        median = statistics.median(heard.intervals(frames))
        check(0.7 * milliseconds < 1e3 * median < 1.5 * milliseconds, f"period {milliseconds} ms", f"{median} s")
    check(drive.nmt.wait_for_heartbeat(2) == "PRE-OPERATIONAL", "NMT state in the heartbeat")
    drive.sdo[0x1017].raw = 20


def emergency(drive, code, register_bit=None):
    """Waits for an emergency that came since the log was last reset."""
    eventually(lambda: any(entry.code == code for entry in drive.emcy.log),
               lambda: f"EMCY 0x{code:04X} among {[hex(entry.code) for entry in drive.emcy.log]}")
    entry = next(entry for entry in drive.emcy.log if entry.code == code)
    if register_bit is not None:
        check(entry.register >> register_bit & 1, f"error register of EMCY 0x{code:04X}", entry.register)


def emergencies(bus, drive):
    """Loss of the manager's heartbeat, a short PDO and a PDO that stays away: EMCY, 0x1001, 0x1003, and recovery."""
    drive.emcy.reset()
    drive.sdo[0x1016][1].raw = CONTROLLER << 16 | 100
    pulse = bus.send_periodic(0x700 + CONTROLLER, [0x05], 0.02)
    drive.nmt.state = "OPERATIONAL"
    time.sleep(0.4)
    check(not drive.emcy.log, "no emergency while the heartbeat comes", drive.emcy.log)
    pulse.stop()
    emergency(drive, 0x8130, register_bit=4)
    eventually(lambda: drive.nmt.state == "PRE-OPERATIONAL", "error behaviour 0x1029: pre-operational")
    check(drive.sdo[0x1003][1].raw & 0xFFFF == 0x8130, "0x1003 remembers")
    check(drive.sdo[0x603F].raw == 0x8130, "0x603F follows")
    check(drive.sdo[0x1001].raw & 0x11 == 0x11, "0x1001 shows communication")
    pulse = bus.send_periodic(0x700 + CONTROLLER, [0x05], 0.02)
    emergency(drive, 0x0000)
    check(drive.sdo[0x1001].raw == 0, "0x1001 is clear again")
    drive.sdo[0x1003][0].raw = 0
    aborts_with(NO_DATA, lambda: drive.sdo.upload(0x1003, 1), "0x1003 was cleared")
    pulse.stop()
    drive.sdo[0x1016][1].raw = 0

    drive.nmt.state = "OPERATIONAL"
    drive.emcy.reset()
    bus.send_message(0x210, [0, 0, 0])
    emergency(drive, 0x8210)
    bus.send_message(0x210, [0, 0, 0, 0])
    emergency(drive, 0x0000)

    drive.emcy.reset()
    drive.sdo[0x1400][5].raw = 100
    bus.send_message(0x210, [0, 0, 0, 0])
    emergency(drive, 0x8250)
    bus.send_message(0x210, [0, 0, 0, 0])
    emergency(drive, 0x0000)
    drive.sdo[0x1400][5].raw = 0

    drive.emcy.reset()
    bus.send_message(0x080, [1, 2, 3])
    emergency(drive, 0x8240)
    bus.sync.transmit()
    emergency(drive, 0x0000)
    restart(bus, drive, "RESET COMMUNICATION")


class Drive(BaseNode402):
    """As python-canopen's, with patience for a busy machine."""

    TIMEOUT_SWITCH_OP_MODE = TIMEOUT_SWITCH_STATE_FINAL = TIMEOUT_SWITCH_STATE_SINGLE = TIMEOUT_CHECK_TPDO = 5.0


def power_states(bus, drive):
    """BaseNode402 leads the drive through the power state machine of CiA 402."""
    drive.nmt.wait_for_heartbeat(2)
    drive.setup_402_state_machine()
    drive.sdo[0x1016][1].raw = CONTROLLER << 16 | 2000
    drive.sdo[0x1006].raw = 1_000_000  # patience for a busy machine; the SYNCs come faster
    pulse = bus.send_periodic(0x700 + CONTROLLER, [0x05], 0.05)
    drive.nmt.state = "OPERATIONAL"
    bus.sync.start(0.02)
    drive.check_statusword(1.0)
    check(drive.state == "SWITCH ON DISABLED", "the state after start", drive.state)
    drive.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    check(drive.op_mode == "CYCLIC SYNCHRONOUS TORQUE", "mode of operation", drive.op_mode)
    try:
        drive.op_mode = "CYCLIC SYNCHRONOUS POSITION"
        check(False, "a mode not in 0x6502 is refused by BaseNode402 itself")
    except TypeError:
        pass
    drive.rpdo[1][0x6071].raw = 0
    drive.rpdo[1].start(0.02)
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        drive.state = state
        check(drive.state == state, "the state ordered", drive.state)

    drive.rpdo[1][0x6071].raw = 400
    current = lambda: drive.tpdo_values[0x6078]  # noqa: E731
    eventually(lambda: current() == 400, "target torque 400 permille gives 400 mA")
    check(drive.statusword >> 12 & 1, "bit 12: the drive follows the command", hex(drive.statusword))

    drive.state = "SWITCHED ON"
    eventually(lambda: current() == 0, "disable operation takes the current away")
    drive.state = "OPERATION ENABLED"
    eventually(lambda: current() == 400, "enabled again")
    drive.controlword = 0x0002  # quick stop
    eventually(lambda: current() == 0, "quick stop takes the current away")
    eventually(lambda: drive.state == "SWITCH ON DISABLED", "option code 2: quick stop ends in switch on disabled")

    # The manager dies while the wire is heated: fault, no current.
    drive.state = "OPERATION ENABLED"
    eventually(lambda: current() == 400, "enabled again")
    drive.emcy.reset()
    pulse.stop()
    emergency(drive, 0x8130)
    eventually(lambda: drive.sdo[0x6078].raw == 0, "the heartbeat's loss takes the current away")
    check(drive.sdo[0x6041].raw & 0x4F == 0x08, "fault", hex(drive.sdo[0x6041].raw))
    pulse = bus.send_periodic(0x700 + CONTROLLER, [0x05], 0.05)
    emergency(drive, 0x0000)
    drive.nmt.state = "OPERATIONAL"
    eventually(lambda: drive.state == "FAULT", "the fault is reported in TPDO1")
    drive.reset_from_fault()
    check(drive.state == "OPERATION ENABLED", "out of the fault", drive.state)
    eventually(lambda: current() == 400, "heated again")

    # SYNC and RPDO stay away: the drive's own timer ends it.
    drive.emcy.reset()
    drive.sdo[0x1006].raw = 20_000
    bus.sync.stop()
    eventually(lambda: drive.sdo[0x6078].raw == 0, "SYNC's loss takes the current away")
    check(any(entry.code & 0xFF00 == 0x8100 for entry in drive.emcy.log), "EMCY for the loss of SYNC", drive.emcy.log)
    drive.rpdo[1].stop()
    pulse.stop()
    restart(bus, drive, "RESET")


def disturbance_outputs(bus, module):
    """RPDO1 of the CiA 401 module is event-driven: it acts on arrival; NMT stop puts the error values out."""
    module.nmt.state = "OPERATIONAL"
    bus.send_message(0x211, struct.pack("<hh", 2500, -300))
    eventually(lambda: module.sdo[0x6411][1].raw == 2500, "convection factor through RPDO1")
    check(module.sdo[0x6411][2].raw == -300, "added load through RPDO1")
    module.nmt.state = "STOPPED"
    time.sleep(0.1)
    module.nmt.state = "PRE-OPERATIONAL"
    eventually(lambda: module.sdo[0x6411][1].raw == 1000, "still air after NMT stop")


def main():
    given = arguments(__doc__)
    logging.disable(logging.WARNING)
    with network(given.interface) as bus:
        drive = bus.add_node(Drive(DRIVE, DRIVE_EDS))
        module = bus.add_node(canopen.RemoteNode(DISTURBANCE, DISTURBANCE_EDS))
        boot_ups = {node: Heard(bus, 0x700 + node) for node in (DRIVE, DISTURBANCE)}
        with node_process(given.program, "plant-emulator", given.interface):
            for node, heard in boot_ups.items():
                eventually(lambda: heard.frames, f"node {node} boots", 20)
                check(heard.frames[0][1] == b"\0", "the first frame is the boot-up", heard.frames[0])
            done("boot-up of both nodes")
            for name, node in (("drive", drive), ("disturbance module", module)):
                done(f"{name}: {read_all(node)} objects read, each as in its EDS")
                taken, refused = write_all(node)
                done(f"{name}: {taken} objects written and read back, {refused} refused the writing")
                restart(bus, node, "RESET")
                read_all(node)
                done(f"{name}: reset node restores every object")
            tests = [(refusals, (bus, drive)), (block_transfers, (drive,)), (second_channel, (bus, drive)),
                     (remap, (bus, drive)), (heartbeat, (bus, drive)), (emergencies, (bus, drive)),
                     (power_states, (bus, drive)), (disturbance_outputs, (bus, module))]
            for test, parameters in tests:
                test(*parameters)
                done(f"{test.__name__}: {test.__doc__.splitlines()[0]}")
    print("python-canopen as manager: all passed", flush=True)


if __name__ == "__main__":
    main()
