"""The recordings of tests/data/attribution: each case is a folder of files, all of them one text, compressed."""

import json
import pathlib
import re
import subprocess

FOLDER = pathlib.Path(__file__).resolve().parent.parent / "data" / "attribution"
ARCHIVE = FOLDER / "cases.zst"
# `==> CASE/FILE <==` begins a file.
BEGIN, END = "==> ", " <==\n"

# Signals that a case does not need: terms of the law, truth of the plant, the fan's heartbeat; and SDO before the scenario begins.
CUT = "181|281|381|481|290|291|711"
SDO = re.compile(r" (5|6)[0-9A-F]{2}#")
FILES = ["scenario.toml", "frames.dbc", "rig.toml", "servo.eds"]
OF_VERDICT = ["schema", "scenario", "version", "seed", "external", "outcome", "reason", "frames_lost", "ended_early", "timing"]


def read_archive():
    """Files by name, of cases by name."""
    if not ARCHIVE.exists():
        return {}
    text = subprocess.run(["zstd", "-dc", "--long=27", ARCHIVE], capture_output=True, check=True).stdout.decode()
    cases = {}
    for part in ("\n" + text).split("\n" + BEGIN)[1:]:
        name, file = part.split(END, 1)
        case, _, name = name.rpartition("/")
        cases.setdefault(case, {})[name] = file.rstrip("\n") + "\n"
    return cases


def write_archive(cases):
    files = [(f"{case}/{name}", text) for case, files in sorted(cases.items()) for name, text in sorted(files.items())]
    text = "".join(f"{BEGIN}{name}{END}{text.rstrip()}\n" for name, text in files)
    FOLDER.mkdir(parents=True, exist_ok=True)
    command = ["zstd", "-q", "--ultra", "-22", "--long=27", "-f", "-o", ARCHIVE]
    subprocess.run(command, input=text.encode(), check=True)


def read_cases():
    """Expected outcome, node and duty of cases by name."""
    path = FOLDER / "cases.txt"
    lines = path.read_text().splitlines() if path.exists() else []
    rows = [line.split() for line in lines if line and not line.startswith("#")]
    return {name: tuple(rest) for name, *rest in rows}


def is_enabled(line):
    """Whether a frame is a position of a drive in Operation enabled."""
    match = re.search(r" (190|1A0)#(..)", line)
    return match is not None and int(match[2], 16) & 0x6F == 0x27


def cut(run, ids=CUT):
    """The files of a case: what `canrig replay` needs of a run folder, without some of its frames. Its clock begins at 1 s, and its
    frames have their times to 10 µs."""
    files = {name: (run / name).read_text() for name in FILES if (run / name).exists()}
    lines = (run / "bus.log").read_text().splitlines()
    begin = int(lines[0][1:].split(".")[0]) - 1
    zero = next((at for at, line in enumerate(lines) if is_enabled(line)), 0)
    is_needless = re.compile(f" ({ids})#").search
    kept = [line for at, line in enumerate(lines) if not (is_needless(line) or at < zero and SDO.search(line))]
    files["bus.log"] = "".join(f"({since(begin, line[1:line.index(')') - 1])}0{line[line.index(')'):]}\n" for line in kept)
    if (run / "stalls.csv").exists():
        header, *rows = (run / "stalls.csv").read_text().splitlines()
        rows = [row.split(",") for row in rows]
        rows = [",".join([since(begin, row[0]), since(begin, row[1]), *row[2:]]) for row in rows]
        files["stalls.csv"] = "\n".join([header, *rows]) + "\n"
    if (run / "sent.csv").exists():
        cut_away = [int(line.split(" ")[2].split("#")[0], 16) for line in set(lines) - set(kept)]
        files["sent.csv"] = without((run / "sent.csv").read_text(), cut_away)
    verdict = json.loads((run / "verdict.json").read_text())
    verdict = {"metrics": []} | {key: verdict[key] for key in OF_VERDICT if key in verdict}
    files["verdict.json"] = json.dumps(verdict) + "\n"
    return files


def without(text, identifiers):
    """The frames that canrig's nodes sent, without those that were cut away."""
    header, *rows = text.splitlines()
    rest = list(identifiers)
    for at, row in enumerate(rows):
        node, identifier, frames = row.split(",")
        count = min(int(frames), rest.count(int(identifier, 16)))
        for _ in range(count):
            rest.remove(int(identifier, 16))
        rows[at] = f"{node},{identifier},{int(frames) - count}"
    return "\n".join([header, *rows]) + "\n"


def since(begin, text):
    """A time of another clock."""
    seconds, micros = text.split(".")
    return f"{int(seconds) - begin}.{micros}"
