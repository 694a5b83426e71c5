"""Writes cantools_vectors.csv: what cantools decodes and encodes with the DBC files here.

    pip install cantools==45.1.0
    python dbc/tests/data/cantools_vectors.py
"""

import csv
import math
import pathlib
import random

import cantools

HERE = pathlib.Path(__file__).parent
FILES = [HERE.parent.parent / "sma_actuator.dbc", HERE / "byte_orders.dbc"]
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


def main():
    generator = random.Random(1)
    with open(HERE / "cantools_vectors.csv", "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["file", "direction", "frame", "message", "signal", "value"])
        for path in FILES:
            database = cantools.database.load_file(path, strict=True)
            for message in database.messages:
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
