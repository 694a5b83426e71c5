"""canrig's embedded bus for python-can, and the time of a scenario on it."""

import importlib.machinery
import importlib.util
import pathlib
import socket
import struct
import sys
import time

import can

FRAME = struct.Struct("=IB3x8s")
EMULATED, ENABLED, NMT_STOP = 0x10, 0x27, 2


class EmbeddedBus(can.BusABC):
    """A client of the socket that `canrig run --bus embedded` prints as `embedded:PATH`."""

    def __init__(self, address, **arguments):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.connect(address.removeprefix("embedded:"))
        self.socket.send(struct.pack("=II", 0, 0))
        self.channel_info = address
        super().__init__(channel=address, **arguments)

    def _recv_internal(self, timeout):
        self.socket.settimeout(timeout)
        try:
            packet = self.socket.recv(FRAME.size)
        except (TimeoutError, BlockingIOError):
            return None, False
        if not packet:
            raise can.CanOperationError("the run is over")
        if len(packet) != FRAME.size:  # a number of dropped frames
            return None, False
        identifier, length, data = FRAME.unpack(packet)
        message = can.Message(
            timestamp=time.time(), arbitration_id=identifier & 0x7FF, is_extended_id=False, dlc=length, data=data[:length]
        )
        return message, False

    def send(self, msg, timeout=None):
        self.socket.sendall(FRAME.pack(msg.arbitration_id, msg.dlc, bytes(msg.data)))

    def send_text(self, frame):
        """Sends `210#0F008403`."""
        identifier, data = frame.split("#")
        self.send(can.Message(arbitration_id=int(identifier, 16), is_extended_id=False, data=bytes.fromhex(data)))

    def shutdown(self):
        super().shutdown()
        self.socket.close()


def wait_for_zero(bus, drive):
    """The monotonic time of scenario time 0: the first SYNC after a drive reported Operation enabled. The pre-flight of a drive that is
    not the emulated one does so, too, and ends with NMT stop."""
    is_begun, is_enabled = drive == EMULATED, False
    while True:
        message = bus.recv()
        if message.arbitration_id == 0x000 and message.data[0] == NMT_STOP:
            is_begun = True
        elif message.arbitration_id == 0x180 + drive:
            is_enabled = is_begun and message.data[0] & 0x6F == ENABLED
        elif message.arbitration_id == 0x080 and is_enabled:
            return time.monotonic()


def wait_until(moment):
    """Sleeps to a monotonic time."""
    time.sleep(max(0.0, moment - time.monotonic()))


def foreign(name):
    """A program of tests/foreign as a module; the words of the command line are not for it."""
    path = pathlib.Path(__file__).resolve().parent.parent / "foreign" / name
    loader = importlib.machinery.SourceFileLoader(f"foreign_{name}", str(path))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(loader.name, loader))
    words, sys.argv = sys.argv, sys.argv[:1]
    loader.exec_module(module)
    sys.argv = words
    return module
