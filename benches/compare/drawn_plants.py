"""The plants that `unknown_plants` and `identified_plants` draw: their ranges, and seeds that nobody chose."""

import pathlib
import re
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[2]
PLANTS = ROOT / "scenarios" / "sweeps" / "plants.toml"
# What stands before the lower end, the key, the lower end, what stands between the ends, the upper end.
RANGE = re.compile(r'(\[\[sweep\.uniform\]\]\nkey = "(plant\.[a-z_.]+)"\nfrom = )([\d.e]+)(\nto = )([\d.e]+)')


def hash_of(commit, paths):
    """The hash of a commit; without one, of the last that changed these paths."""
    log = ["git", "rev-parse", commit] if commit else ["git", "log", "-1", "--format=%H", "--", *paths]
    return subprocess.run(log, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


def seeds_of(hash, count):
    """Numbers from a hash, six digits of it each."""
    return [int(hash[6 * place : 6 * place + 6], 16) for place in range(count)]


def quantile(values, share):
    return sorted(values)[min(int(share * len(values)), len(values) - 1)] if values else float("nan")
