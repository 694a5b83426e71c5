"""Writes cantools_vectors.csv: what cantools decodes and encodes with the DBC files here.

Of the files that Database::to_dbc wrote only what differs from the shipped file is in the table; the rest must be equal.

    pip install cantools==45.1.0
    python dbc/tests/data/cantools_vectors.py
"""

import csv
import math
import pathlib
import random

import cantools

HERE = pathlib.Path(__file__).parent
SHIPPED = HERE.parent.parent / "sma_actuator.dbc"
# Those that Database::to_dbc wrote, with the number of messages that frames carry and that the shipped file has not.
FILES = {SHIPPED: None, HERE / "byte_orders.dbc": None}
WRITTEN = {"shipped.dbc": 0, "dc_motor.dbc": 3, "own_law.dbc": 4, "rig.dbc": 3}
FILES |= {HERE / "written" / name: changed for name, changed in WRITTEN.items()}
PAYLOADS_PER_MESSAGE = 6


def payloads(message, generator):
    """The extremes, then payloads by chance."""
    yield bytes(message.length)
    yield bytes([0xFF] * message.length)
    for _ in range(PAYLOADS_PER_MESSAGE):
        yield generator.randbytes(message.length)


def in_range(message, values):
    """The values, each moved into the range of its signal."""
    clamped = {}
    for signal in message.signals:
        value = values[signal.name]
        low = value if signal.minimum is None else signal.minimum
        high = value if signal.maximum is None else signal.maximum
        clamped[signal.name] = min(max(value, low), high)
    return clamped


def is_exact(values):
    """True when every value survives as a double."""
    return all(math.isfinite(value) and int(float(value)) == int(value) for value in values)


def meaning(message):
    """All that a message's definition says, in a form that can be compared."""
    signals = {
        signal.name: (
            signal.start, signal.length, signal.byte_order, signal.is_signed, signal.is_float, signal.scale, signal.offset,
            signal.minimum, signal.maximum, signal.unit, signal.choices, signal.comment, signal.receivers,
            str(signal.dbc.attributes.get("CanopenObject")),
        )
        for signal in message.signals
    }
    return (message.name, message.frame_id, message.is_extended_frame, message.length, message.cycle_time, message.comment,
            message.senders[:1], signals)


def main():
    generator = random.Random(1)
    shipped = [meaning(message) for message in cantools.database.load_file(SHIPPED, strict=True).messages]
    with open(HERE / "cantools_vectors.csv", "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["file", "direction", "frame", "message", "signal", "value"])
        for path, changed in FILES.items():
            messages = cantools.database.load_file(path, strict=True, encoding="utf-8").messages
            if changed is not None:
                messages = [message for message in messages if meaning(message) not in shipped]
                names = [message.name for message in messages]
                assert len(names) == changed, f"{path.name}: {names}"
            for message in messages:
                identifier = f"{message.frame_id:0{8 if message.is_extended_frame else 3}X}"

                def write(direction, payload, values, written=set()):
                    frame = f"{identifier}#{payload.hex().upper()}"
                    if (direction, frame) in written:
                        return
                    written.add((direction, frame))
                    for signal, value in values.items():
                        rows.writerow([path.name, direction, frame, message.name, signal, repr(float(value))])

                for payload in payloads(message, generator):
                    values = message.decode(payload, decode_choices=False)
                    write("decode", payload, values)
                    values = in_range(message, values)
                    if is_exact(values.values()):
                        write("encode", message.encode(values, strict=True), values)


if __name__ == "__main__":
    main()
