"""An io node: it notes what the bench sets."""

import canrig_node as node

PART = node.part()
NODE = PART.node_id


class Io(node.Node):
    filters = [0x000, 0x200 + NODE, 0x600 + NODE]

    def on_start(self):
        self.send(0x700 + NODE, b"\0")
        self.every(0.05, "heartbeat")

    def on_time(self, name):
        self.send(0x700 + NODE, b"\5")

    def on_frame(self, frame):
        if frame.id == 0x600 + NODE:
            kind = 0x60 if frame.data[0] >> 5 == 1 else 0x43
            self.send(0x580 + NODE, bytes([kind]) + frame.data[1:4] + bytes(4))
        elif frame.id == 0x200 + NODE:
            print(f"{self.now:.6f} {frame.data.hex()}", flush=True)


Io.run()
