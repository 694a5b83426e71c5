"""The SBOM of a release names what is in the program, and nothing that only tests or builds it."""

import json
import subprocess
import tomllib

from conftest import ROOT


def test_the_sbom_names_the_packages_of_the_program():
    made = [
        subprocess.run(
            [ROOT / ".ci" / "sbom", "x86_64-unknown-linux-gnu"],
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for _ in range(2)
    ]
    assert made[0] == made[1]
    document = json.loads(made[0])
    packages = {one["SPDXID"]: one for one in document["packages"]}
    locked = {
        (one["name"], one["version"]): one.get("checksum")
        for one in tomllib.loads((ROOT / "Cargo.lock").read_text())["package"]
    }
    assert len(packages) == len(document["packages"]) > 100
    for one in packages.values():
        checksum = locked[one["name"], one["versionInfo"]]
        assert [each["checksumValue"] for each in one.get("checksums", [])] == (
            [checksum] if checksum else []
        )
        assert one["licenseDeclared"] != "NOASSERTION", one["name"]
    names = {one["name"] for one in packages.values()}
    assert {"canrig", "judge", "clap", "toml"} <= names
    assert not names & {"proptest", "boon", "benches", "xtask"}
    edges = {(one["spdxElementId"], one["relatedSpdxElement"]) for one in document["relationships"]}
    (program,) = (place for place, one in packages.items() if one["name"] == "canrig")
    assert ("SPDXRef-DOCUMENT", program) in edges
    assert all(other in packages for _, other in edges)
    # Each package is one of the program, or of one of its packages.
    assert {other for _, other in edges} == set(packages)
