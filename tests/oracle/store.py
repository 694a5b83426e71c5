"""python-canopen moves long values to and from canrig's SDO server, in segments and in blocks."""

import random
import subprocess

import canopen

from bench import Heard, ROOT, arguments, check, done, eventually, network

NODE = 0x20
EDS = str(ROOT / "tests" / "oracle" / "store.eds")
# One segment, one block of 127 segments, one byte more, many blocks. (python-canopen's time grows with the square.)
LENGTHS = (7, 889, 890, 8_000)


def main():
    given = arguments(__doc__)
    values = random.Random(1)
    with network(given.interface) as bus:
        node = bus.add_node(canopen.RemoteNode(NODE, EDS))
        boot_up = Heard(bus, 0x700 + NODE)
        command = [given.program, given.interface, str(NODE), EDS]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as device:
            eventually(lambda: boot_up.frames, "the device boots", 20)
            for length in LENGTHS:
                for block in (False, True):
                    value = values.randbytes(length)
                    with node.sdo.open(0x2000, 0, "wb", size=length, block_transfer=block) as stream:
                        stream.write(value)
                    for block_back in (False, True):
                        with node.sdo.open(0x2000, 0, "rb", block_transfer=block_back) as stream:
                            found = stream.read()
                        check(found == value, f"{length} bytes, blocks {block} and back {block_back}", len(found))
                done(f"{length} bytes there and back, in segments and in blocks with CRC")
            device.stdin.close()
            check(device.wait(10) == 0, "orderly end", device.returncode)
    print("python-canopen with long values: all passed", flush=True)


if __name__ == "__main__":
    main()
